//! `config.json` of an `InternVLForConditionalGeneration` (`-hf`) or `InternVLChatModel`
//! checkpoint.

use super::layout::Layout;
use crate::MllmError;
use crate::checkpoint::{ConfigObject, LlamaConfig, ModelFiles, VisionConfig, check_width};
use serde_json::Value;
use std::path::Path;

/// An `InternVL`: its vision tower, its decoder, and how they are joined.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct InternVlConfig {
    pub vision: VisionConfig,
    pub text: LlamaConfig,
    /// Token id that stands for a token of the image in the prompt.
    pub image_token: u32,
    /// Side of the blocks of patches that become one token.
    pub scale: usize,
}

/// The placeholder of an image.
pub(super) const IMAGE: &str = "<IMG_CONTEXT>";
/// Its id in the published tokenizers.
const IMAGE_TOKEN: u32 = 151_667;
/// The default `downsample_ratio`.
const DOWNSAMPLE: f64 = 0.5;

impl InternVlConfig {
    pub(super) fn open(files: &ModelFiles) -> Result<Self, MllmError> {
        let named = || -> Result<Option<u64>, MllmError> {
            let tokenizer = files.json("tokenizer.json")?;
            Ok(tokenizer.and_then(|tokenizer| crate::gguf::tokenizer::added_id(&tokenizer, IMAGE)))
        };
        Self::from_json(
            &files.path("config.json"),
            &files.required_json("config.json")?,
            named,
        )
    }

    /// Reads a configuration; `path` is for messages. `named` gives the id of the tokenizer's
    /// placeholder.
    pub(super) fn from_json(
        path: &Path,
        value: &Value,
        named: impl FnOnce() -> Result<Option<u64>, MllmError>,
    ) -> Result<Self, MllmError> {
        let mut value = value.clone();
        // The two kinds of checkpoints write a side as a number or as a pair of equal ones.
        for key in ["/vision_config/image_size", "/vision_config/patch_size"] {
            if let Some(sides) = value.pointer_mut(key) {
                square(sides);
            }
        }
        let root = ConfigObject::root(path, &value)?;
        let layout = Layout::from_config(&root);
        root.only_neutral(layout.neutral())?;
        let vision = layout.vision(&root)?;
        let mut text = layout.text(&root)?;
        text.tie_word_embeddings |= root
            .value("tie_word_embeddings")?
            .unwrap_or(layout == Layout::Hf);
        let ratio = root.positive("downsample_ratio")?.unwrap_or(DOWNSAMPLE);
        let scale = (1.0 / ratio).round().clamp(1.0, 64.0) as usize;
        let side = vision.image_size / vision.patch_size;
        check_width(&root, "downsample_ratio", scale * scale, vision.hidden)?;
        if (ratio * scale as f64 - 1.0).abs() > 1e-9 || !side.is_multiple_of(scale) {
            let problem =
                format!("{ratio} does not merge the {side} patches of a side into whole tokens");
            return Err(root.error("downsample_ratio", problem));
        }
        let image_token = match root.first_id("image_token_id")? {
            Some(id) => id,
            None => named()?
                .and_then(|id| u32::try_from(id).ok())
                .unwrap_or(IMAGE_TOKEN),
        };
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

/// Replaces a pair of equal sides by one number.
fn square(value: &mut Value) {
    if let Value::Array(sides) = value
        && let [height, width] = sides.as_slice()
        && height == width
    {
        *value = height.clone();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn read(config: &Value) -> Result<InternVlConfig, MllmError> {
        InternVlConfig::from_json(Path::new("config.json"), config, || Ok(Some(7)))
    }

    #[test]
    fn both_layouts_are_read() {
        let text = json!({"model_type": "qwen2", "hidden_size": 896, "num_attention_heads": 14, "num_key_value_heads": 2,
            "vocab_size": 151_674, "rope_scaling": {"type": "dynamic", "rope_type": "dynamic", "factor": 2.0}});
        let tower = json!({"hidden_size": 1024, "intermediate_size": 4096, "num_hidden_layers": 24, "image_size": 448,
            "num_attention_heads": 16, "qkv_bias": true, "qk_normalization": false, "norm_type": "layer_norm"});
        let original = json!({"model_type": "internvl_chat", "llm_config": text, "force_image_size": 448,
            "ps_version": "v2", "tie_word_embeddings": true, "vision_config": tower});
        let hf = json!({"model_type": "internvl", "text_config": text, "image_token_id": 7,
            "vision_config": {"image_size": [448, 448], "patch_size": [14, 14], "attention_bias": true}});
        assert_eq!(read(&original).unwrap(), read(&hf).unwrap());
        let config = read(&hf).unwrap();
        assert_eq!(
            (config.tile_tokens(), config.scale, config.image_token),
            (256, 2, 7)
        );
        assert!(config.text.attention_bias && !config.text.output_bias);
    }

    #[test]
    fn unsupported_configurations_are_named() {
        let hf = json!({"vision_config": {"attention_bias": true}});
        let original = json!({"ps_version": "v2", "llm_config": {"model_type": "qwen2"}, "vision_config": {
            "qkv_bias": true, "qk_normalization": false, "norm_type": "layer_norm", "hidden_size": 64,
            "num_attention_heads": 4, "image_size": 448}});
        read(&hf).unwrap();
        read(&original).unwrap();
        for (layout, pointer, value) in [
            (&hf, "/downsample_ratio", json!(0.3)),
            (&hf, "/vision_feature_layer", json!(-4)),
            (&hf, "/vision_feature_select_strategy", json!("full")),
            (&hf, "/projector_hidden_act", json!("relu")),
            (&hf, "/vision_config/use_qk_norm", json!(true)),
            (&hf, "/vision_config/norm_type", json!("rms_norm")),
            (&hf, "/vision_config/use_mean_pooling", json!(false)),
            (&hf, "/vision_config/attention_bias", Value::Null),
            (&hf, "/text_config/model_type", json!("internlm2")),
            (&hf, "/image_token_id", json!(400_000)),
            (&original, "/ps_version", json!("v1")),
            (&original, "/ps_version", Value::Null),
            (&original, "/select_layer", json!(-4)),
            (&original, "/force_image_size", json!(224)),
            (&original, "/llm_config/model_type", json!("internlm2")),
            (&original, "/llm_config/model_type", Value::Null),
            (&original, "/vision_config/qk_normalization", Value::Null),
            (&original, "/vision_config/qkv_bias", Value::Null),
            (&original, "/vision_config/norm_type", Value::Null),
        ] {
            let mut config = layout.clone();
            let (object, key) = pointer.rsplit_once('/').unwrap();
            let object = object.trim_start_matches('/');
            if object.is_empty() {
                config[key] = value;
            } else {
                config[object][key] = value;
            }
            let named = pointer.trim_start_matches('/').replace('/', ".");
            let error = read(&config).unwrap_err();
            assert!(
                matches!(&error, MllmError::Config { key, .. } if *key == named),
                "{pointer}: {error}"
            );
        }
    }
}
