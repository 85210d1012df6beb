//! Gemma 3n (Google, 2025): a convolutional vision tower (`MobileNet` V5), and a decoder of several
//! streams of hidden states. It hears too, which this program does not read.

mod blocks;
mod config;
mod cost;
mod embedder;
mod gguf;
mod language;
mod model;
mod tower;

#[cfg(test)]
mod reference_tests;

use super::MllmError;
use super::checkpoint::{ConfigObject, ModelFiles, Weights};
use super::family::{About, Family, OpenedModel};
use super::text_only::{self, gemma3n_name};
use super::vision::{ClipImageProcessor, read_processor};
use config::Gemma3nConfig;
use model::Gemma3n;
use serde_json::json;

const NAME: &str = "gemma3n";

/// Gemma 3n.
pub(crate) const FAMILY: Family = Family {
    name: NAME,
    config_names: &["gemma3n", "Gemma3nForConditionalGeneration"],
    canonical_name,
    gguf: Ok(&gguf::Gemma3nGguf),
    missing_tokenizer: "tokenizer.json",
    decoder_config: |files| Ok(Gemma3nConfig::open(files)?.text),
    open,
    about: About {
        models: "Gemma 3n E2B and E4B, pictures and text",
        gguf: &[("gemma3n", Some("gemma3nv"))],
        tested: "transformers and timm, llama.cpp's converter: tests/fixtures/tiny_gemma3n_vision",
        example: "gemma-3n-e2b",
    },
};

/// A folder without a vision tower opens as a language model.
fn open(files: &ModelFiles, weights: &mut Weights) -> OpenedModel {
    let config = Gemma3nConfig::open(files)?;
    let Some(seen) = &config.seen else {
        return text_only::take_streams(weights, NAME, &config.text);
    };
    let processor = processor(files)?;
    Ok(Box::new(Gemma3n::take(
        weights,
        &config.text,
        seen,
        processor,
    )?))
}

/// `SiglipImageProcessor`, or one that a file names.
fn processor(files: &ModelFiles) -> Result<ClipImageProcessor, MllmError> {
    read_processor(files, |path, object: &ConfigObject<'_>| {
        let object = object
            .clone()
            .with_defaults(json!({"image_processor_type": "SiglipImageProcessor"}));
        ClipImageProcessor::read(path, &object)
    })
}

/// The canonical name of a tensor; none for those of sounds, but for the table of their tokens.
fn canonical_name(stored: &str) -> Option<String> {
    let name = stored.strip_prefix("model.").unwrap_or(stored);
    if name.starts_with("audio_tower.") || name == "embed_audio.soft_embedding_norm.weight" {
        return None;
    }
    let renamed = [
        ("vision_tower.timm_model.", "vision_tower."),
        ("embed_vision.", "multi_modal_projector."),
        ("embed_audio.", "multi_modal_projector.sound."),
    ];
    for (layout, canonical) in renamed {
        if let Some(rest) = name.strip_prefix(layout) {
            return Some(format!("{canonical}{rest}"));
        }
    }
    gemma3n_name(name)
}

/// What is read of the small files, for tests of their keys.
#[cfg(test)]
pub(crate) fn read_files(files: &ModelFiles) -> Result<String, MllmError> {
    let config = Gemma3nConfig::open(files)?;
    let processor = config.seen.as_ref().map(|_| processor(files));
    Ok(format!("{config:?} {:?}", processor.transpose()?))
}

#[cfg(test)]
mod tests {
    use super::canonical_name;

    #[test]
    fn every_part_has_its_canonical_names() {
        for (name, canonical) in [
            (
                "model.vision_tower.timm_model.blocks.2.9.attn.query.proj.weight",
                Some("vision_tower.blocks.2.9.attn.query.proj.weight"),
            ),
            (
                "model.embed_vision.embedding_projection.weight",
                Some("multi_modal_projector.embedding_projection.weight"),
            ),
            (
                "model.embed_audio.embedding.weight",
                Some("multi_modal_projector.sound.embedding.weight"),
            ),
            ("model.embed_audio.soft_embedding_norm.weight", None),
            ("model.audio_tower.conformer.0.norm.weight", None),
            (
                "model.language_model.layers.1.altup.correct_output_scale",
                Some("language_model.layers.1.altup.correct_output_scale.weight"),
            ),
            ("lm_head.weight", Some("lm_head.weight")),
        ] {
            assert_eq!(canonical_name(name).as_deref(), canonical, "{name}");
        }
    }
}
