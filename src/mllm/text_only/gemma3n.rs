//! The configuration and the tensors of a Gemma 3n.

use super::canonical_name as of_decoder;
use crate::MllmError;
use crate::checkpoint::{ConfigObject, DecoderType, LlamaConfig, ModelFiles};

/// What of a model with towers is no decoder.
const TOWERS: [&str; 4] = [
    "vision_tower.",
    "audio_tower.",
    "embed_vision.",
    "embed_audio.",
];

/// The configuration of the decoder, at the root or in the `text_config` of a model with towers.
///
/// # Errors
/// When the model has a vision tower: it would see nothing, which nobody asked for.
pub(super) fn config(files: &ModelFiles) -> Result<LlamaConfig, MllmError> {
    const TEXT: &str = "text_config";
    const TOWER: &str = "vision_config";
    let (path, json) = (
        files.path("config.json"),
        files.required_json("config.json")?,
    );
    let root = ConfigObject::root(&path, &json)?;
    let Some(text) = root.child(TEXT)? else {
        return LlamaConfig::read_as(root, DecoderType::Gemma3n);
    };
    if root.child(TOWER)?.is_some() {
        let problem = "the vision tower of Gemma 3n, a convolutional network (MobileNet V5), is not supported; to open \
                       the decoder as a language model, which reads text and sees no picture, write null here, or take \
                       the decoder's GGUF file";
        return Err(root.error(TOWER, problem));
    }
    let mut config = LlamaConfig::read_as(text, DecoderType::Gemma3n)?;
    config.tie_word_embeddings = root.value("tie_word_embeddings")?.unwrap_or(true);
    Ok(config)
}

/// The canonical name of a tensor; none for those of the towers.
pub(super) fn canonical_name(stored: &str) -> Option<String> {
    let name = stored.strip_prefix("model.").unwrap_or(stored);
    if TOWERS.iter().any(|tower| name.starts_with(tower)) {
        return None;
    }
    let name = match name.strip_prefix("language_model.model.") {
        Some(rest) => format!("language_model.{rest}"),
        None => match name.strip_prefix("language_model.lm_head.") {
            Some(rest) => format!("lm_head.{rest}"),
            None => of_decoder(name)?,
        },
    };
    // No weight of a layer in folders, and one in llama.cpp's files.
    if name.ends_with(".correct_output_scale") {
        return Some(name + ".weight");
    }
    Some(name)
}

#[cfg(test)]
mod tests {
    use super::canonical_name;

    #[test]
    fn every_layout_has_one_canonical_name() {
        let scale = "language_model.layers.1.altup.correct_output_scale.weight";
        let split = "language_model.altup_projections.2.weight";
        for (name, canonical) in [
            ("model.layers.1.altup.correct_output_scale", Some(scale)),
            (
                "model.language_model.layers.1.altup.correct_output_scale",
                Some(scale),
            ),
            (
                "language_model.model.layers.1.altup.correct_output_scale",
                Some(scale),
            ),
            ("model.altup_projections.2.weight", Some(split)),
            (
                "model.language_model.altup_projections.2.weight",
                Some(split),
            ),
            ("language_model.lm_head.weight", Some("lm_head.weight")),
            ("lm_head.weight", Some("lm_head.weight")),
            ("model.vision_tower.timm_model.conv_stem.conv.weight", None),
            ("model.embed_vision.embedding.weight", None),
            ("model.audio_tower.conformer.0.norm.weight", None),
        ] {
            assert_eq!(canonical_name(name).as_deref(), canonical, "{name}");
        }
    }
}
