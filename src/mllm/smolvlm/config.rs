//! `config.json` of a `SmolVLMForConditionalGeneration` or `Idefics3ForConditionalGeneration`
//! checkpoint.

use crate::MllmError;
use crate::checkpoint::{
    ConfigObject, DecoderType, LlamaConfig, ModelFiles, VisionConfig, check_width,
};
use serde_json::{Value, json};
use std::path::Path;

/// A `SmolVLM`: its vision tower, its decoder, and how they are joined.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct SmolVlmConfig {
    pub vision: VisionConfig,
    pub text: LlamaConfig,
    /// Token id that stands for a token of the image in the prompt.
    pub image_token: u32,
    /// Side of the blocks of patches that become one token (`scale_factor`).
    pub scale: usize,
}

/// The default `scale_factor` of `SmolVLMConfig`.
const DEFAULT_SCALE: usize = 2;
/// Its default `image_token_id`, which only a vocabulary of Llama 3's size has.
const DEFAULT_IMAGE_TOKEN: u32 = 128_257;

impl SmolVlmConfig {
    pub(super) fn open(files: &ModelFiles) -> Result<Self, MllmError> {
        Self::from_json(
            &files.path("config.json"),
            &files.required_json("config.json")?,
        )
    }

    /// Reads a configuration; `path` is for messages.
    pub(super) fn from_json(path: &Path, value: &Value) -> Result<Self, MllmError> {
        let root = ConfigObject::root(path, value)?;
        // The defaults of `SmolVLMVisionConfig` and `Idefics3VisionConfig`, which published files
        // leave out.
        let vision = root.child_or_empty("vision_config")?.with_defaults(json!({
            "hidden_size": 1152, "intermediate_size": 3072, "num_hidden_layers": 12, "num_attention_heads": 16,
            "image_size": 224, "patch_size": 32, "hidden_act": "gelu_pytorch_tanh", "layer_norm_eps": 1e-6,
        }));
        let vision = VisionConfig::read(&vision)?;
        let text = match root.child("text_config")? {
            Some(text) => text,
            // `SmolVLMConfig` and `Idefics3Config` have this one where a file has no decoder's keys
            // at all.
            None => root
                .child_or_empty("text_config")?
                .with_defaults(json!({"rms_norm_eps": 1e-5})),
        };
        let mut text = LlamaConfig::read(text, DecoderType::Llama)?;
        text.tie_word_embeddings |= root.value("tie_word_embeddings")?.unwrap_or(false);
        let scale = root.value("scale_factor")?.unwrap_or(DEFAULT_SCALE);
        let side = vision.image_size / vision.patch_size;
        if scale == 0 || !side.is_multiple_of(scale) {
            return Err(root.error(
                "scale_factor",
                format!("{scale} does not divide the {side} patches of a side"),
            ));
        }
        check_width(&root, "scale_factor", scale * scale, vision.hidden)?;
        let image_token = root
            .first_id("image_token_id")?
            .unwrap_or(DEFAULT_IMAGE_TOKEN);
        if image_token as usize >= text.vocabulary {
            let problem = format!(
                "{image_token} lies outside the vocabulary of {}",
                text.vocabulary
            );
            return Err(root.error("image_token_id", problem));
        }
        Ok(Self {
            vision,
            text,
            image_token,
            scale,
        })
    }

    /// Tokens of a tile.
    pub(super) fn tile_tokens(&self) -> usize {
        let side = self.vision.image_size / self.vision.patch_size / self.scale;
        side * side
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_published_configuration_is_read() {
        // What SmolVLM2-2.2B's file says, defaults left out.
        let config = json!({
            "model_type": "smolvlm", "image_token_id": 49190, "scale_factor": 3, "tie_word_embeddings": false,
            "text_config": {"model_type": "llama", "architectures": ["VLlama3ForCausalLM"], "hidden_size": 2048,
                "intermediate_size": 8192, "num_hidden_layers": 24, "num_attention_heads": 32, "head_dim": 64,
                "num_key_value_heads": 32, "vocab_size": 49280, "max_position_embeddings": 8192,
                "rms_norm_eps": 1e-5, "rope_theta": 273_768.0, "rope_interleaved": false, "pixel_shuffle_factor": 3},
            "vision_config": {"model_type": "smolvlm_vision", "hidden_size": 1152, "intermediate_size": 4304,
                "num_hidden_layers": 27, "num_attention_heads": 16, "image_size": 384, "patch_size": 14},
        });
        let config = SmolVlmConfig::from_json(Path::new("config.json"), &config).unwrap();
        assert_eq!((config.tile_tokens(), config.vision.patches()), (81, 729));
        assert_eq!(
            (config.text.head_dim, config.text.rope.theta as u32),
            (64, 273_768)
        );
    }

    #[test]
    fn broken_configurations_are_named() {
        let valid = json!({"image_token_id": 4, "scale_factor": 7});
        let read = |config: &Value| SmolVlmConfig::from_json(Path::new("config.json"), config);
        assert!(read(&valid).is_ok());
        for (key, value) in [
            ("scale_factor", json!(2)),
            ("scale_factor", json!(0)),
            ("image_token_id", json!(40_000)),
            ("image_token_id", Value::Null),
        ] {
            let mut changed = valid.clone();
            changed[key] = value;
            assert!(
                matches!(read(&changed), Err(MllmError::Config { key: named, .. }) if named == key),
                "{changed}"
            );
        }
    }
}
