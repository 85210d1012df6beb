//! Gemma 4 with a dense decoder (Google, 2026): a tower for pictures of any shape within a number of
//! tokens, and a decoder whose layers differ in shape, share keys and read the token once more.

mod chat;
mod config;
mod gguf;
mod model;
mod processor;
mod tower;

#[cfg(test)]
mod gguf_tests;
#[cfg(test)]
mod reference_tests;

use super::checkpoint::{ModelFiles, Weights};
use super::family::{About, Family, OpenedModel};
use super::text_only;
use config::Gemma4Config;
use model::Gemma4;
use processor::PictureProcessor;

const NAME: &str = "gemma4";

/// Gemma 4.
pub(crate) const FAMILY: Family = Family {
    name: NAME,
    config_names: &["gemma4", "Gemma4ForConditionalGeneration"],
    canonical_name,
    gguf: Ok(&gguf::LAYOUT),
    missing_tokenizer: "tokenizer.json",
    decoder_config: |files| Ok(Gemma4Config::open(files)?.text),
    open,
    about: About {
        models: "Gemma 4 E2B, E4B and 31B, pictures and text",
        gguf: &[("gemma4", Some("gemma4v"))],
        tested: "transformers, llama.cpp: tests/fixtures/tiny_gemma4",
        example: "gemma-4-e2b",
    },
};

/// A folder without a tower opens as a language model.
fn open(files: &ModelFiles, weights: &mut Weights) -> OpenedModel {
    let config = Gemma4Config::open(files)?;
    let Some(tower) = &config.tower else {
        return text_only::take(weights, NAME, &config.text);
    };
    let processor = PictureProcessor::open(files, tower)?;
    Ok(Box::new(Gemma4::take(weights, &config, tower, processor)?))
}

/// The canonical name of a tensor; none for those of sounds, which nothing reads.
fn canonical_name(stored: &str) -> Option<String> {
    let name = stored.strip_prefix("model.").unwrap_or(stored);
    if name.starts_with("audio_tower.") || name.starts_with("embed_audio.") {
        return None;
    }
    if let Some(rest) = name.strip_prefix("vision_tower.") {
        // Each matrix of the tower lies in a layer that may clamp what goes through it.
        let rest = match rest.strip_suffix(".linear.weight") {
            Some(layer) => format!("{layer}.weight"),
            None => rest.to_owned(),
        };
        return Some(format!("vision_tower.{rest}"));
    }
    if let Some(rest) = name.strip_prefix("embed_vision.") {
        return Some(format!("multi_modal_projector.{rest}"));
    }
    if let Some(rest) = name.strip_prefix("language_model.lm_head.") {
        return Some(format!("lm_head.{rest}"));
    }
    let name = match name.strip_prefix("language_model.model.") {
        Some(rest) => format!("language_model.{rest}"),
        None => name.to_owned(),
    };
    Some(text_only::gemma4_name(name))
}

/// What is read of the small files, for tests of their keys.
#[cfg(test)]
pub(crate) fn read_files(files: &ModelFiles) -> Result<String, super::MllmError> {
    let config = Gemma4Config::open(files)?;
    let tower = config.tower.as_ref();
    let processor = tower.map(|tower| PictureProcessor::open(files, tower));
    Ok(format!("{config:?} {:?}", processor.transpose()?))
}

#[cfg(test)]
mod tests {
    use super::canonical_name;

    #[test]
    fn every_layout_has_one_canonical_name() {
        let tower = "vision_tower.encoder.layers.0.self_attn.q_proj.";
        let scale = "language_model.layers.1.layer_scalar.weight";
        for (name, canonical) in [
            (
                "model.vision_tower.encoder.layers.0.self_attn.q_proj.linear.weight",
                Some(format!("{tower}weight")),
            ),
            (
                "model.vision_tower.encoder.layers.0.self_attn.q_proj.input_min",
                Some(format!("{tower}input_min")),
            ),
            (
                "model.language_model.layers.1.layer_scalar",
                Some(scale.into()),
            ),
            (
                "language_model.model.layers.1.layer_scalar",
                Some(scale.into()),
            ),
            (
                "model.embed_vision.embedding_projection.weight",
                Some("multi_modal_projector.embedding_projection.weight".into()),
            ),
            ("lm_head.weight", Some("lm_head.weight".into())),
            ("model.audio_tower.layers.0.norm_out.weight", None),
            ("model.embed_audio.embedding_projection.weight", None),
        ] {
            assert_eq!(canonical_name(name), canonical, "{name}");
        }
    }
}
