//! LFM2-VL and LFM2.5-VL (Liquid AI, 2025 and 2026): a `SigLIP2` tower for views of any size,
//! blocks of patches merged by two layers, and an LFM2 decoder. A large picture is cut into tiles.

mod chat;
mod config;
mod gguf;
mod model;
mod processor;
mod tower;

#[cfg(test)]
pub(crate) mod reference_tests;

use super::MllmError;
use super::checkpoint::{ModelFiles, Weights};
use super::family::{About, Family};
use super::text_only::lfm2;
use config::Lfm2VlConfig;
use model::Lfm2Vl;
use processor::ViewProcessor;

const NAME: &str = "lfm2-vl";

/// LFM2-VL and LFM2.5-VL.
pub(crate) const FAMILY: Family = Family {
    name: NAME,
    // The first files have a hyphen.
    config_names: &["lfm2_vl", "lfm2-vl", "Lfm2VlForConditionalGeneration"],
    canonical_name,
    gguf: Ok(&gguf::LAYOUT),
    missing_tokenizer: "tokenizer.json",
    decoder_config: |files| Ok(Lfm2VlConfig::open(files)?.text),
    open: |files, weights| Ok(Box::new(open(files, weights)?)),
    about: About {
        models: "LFM2-VL, LFM2.5-VL",
        gguf: &[("lfm2", Some("lfm2"))],
        tested: "transformers, llama.cpp: tests/fixtures/tiny_lfm2_vl",
        example: "lfm2.5-vl-450m",
    },
};

/// The canonical name of a tensor; none for the tower's pooling, which nothing reads.
fn canonical_name(stored: &str) -> Option<String> {
    let name = stored.strip_prefix("model.").unwrap_or(stored);
    let name = match name.strip_prefix("vision_tower.") {
        // Published files have the name of an inner class too.
        Some(rest) => {
            let rest = rest.strip_prefix("vision_model.").unwrap_or(rest);
            if rest.starts_with("head.") {
                return None;
            }
            format!("vision_tower.{rest}")
        }
        None => name.to_owned(),
    };
    let name = match name.strip_prefix("language_model.model.") {
        Some(rest) => format!("language_model.{rest}"),
        None => name,
    };
    Some(lfm2::canonical_name(&name))
}

fn open(files: &ModelFiles, weights: &mut Weights) -> Result<Lfm2Vl, MllmError> {
    let config = Lfm2VlConfig::open(files)?;
    let processor = ViewProcessor::open(files, config.vision.patch_size, config.downsample)?;
    Lfm2Vl::take(weights, &config, processor)
}

/// What is read of the small files, for tests of their keys.
#[cfg(test)]
pub(crate) fn read_files(files: &ModelFiles) -> Result<String, MllmError> {
    let config = Lfm2VlConfig::open(files)?;
    let processor = ViewProcessor::open(files, config.vision.patch_size, config.downsample)?;
    Ok(format!("{config:?} {processor:?}"))
}

#[cfg(test)]
mod tests {
    use super::canonical_name;

    #[test]
    fn every_layout_has_one_canonical_name() {
        let tower = "vision_tower.encoder.layers.0.mlp.fc1.weight";
        let norm = "language_model.layers.1.input_layernorm.weight";
        for (name, canonical) in [
            ("model.vision_tower.encoder.layers.0.mlp.fc1.weight", tower),
            (
                "model.vision_tower.vision_model.encoder.layers.0.mlp.fc1.weight",
                tower,
            ),
            (
                "vision_tower.vision_model.encoder.layers.0.mlp.fc1.weight",
                tower,
            ),
            ("model.language_model.layers.1.operator_norm.weight", norm),
            ("language_model.layers.1.operator_norm.weight", norm),
            ("language_model.model.layers.1.operator_norm.weight", norm),
            (
                "multi_modal_projector.linear_1.bias",
                "multi_modal_projector.linear_1.bias",
            ),
            ("lm_head.weight", "lm_head.weight"),
        ] {
            assert_eq!(canonical_name(name).as_deref(), Some(canonical), "{name}");
        }
        assert_eq!(
            canonical_name("model.vision_tower.vision_model.head.probe"),
            None
        );
    }
}
