//! `config.json` of an `InternVLForConditionalGeneration` (`-hf`) or `InternVLChatModel` checkpoint.

use std::path::Path;

use serde_json::{Value, json};

use crate::MllmError;
use crate::checkpoint::{ConfigObject, LlamaConfig, ModelFiles, VisionConfig};
use planagent_kernels::Activation;

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
        Self::from_json(&files.path("config.json"), &files.required_json("config.json")?, named)
    }

    /// Reads a configuration; `path` is for messages. `named` gives the id of the tokenizer's placeholder.
    pub(super) fn from_json(
        path: &Path,
        value: &Value,
        named: impl FnOnce() -> Result<Option<u64>, MllmError>,
    ) -> Result<Self, MllmError> {
        let mut value = value.clone();
        for key in ["/vision_config/image_size", "/vision_config/patch_size"] {
            if let Some(sides) = value.pointer_mut(key) {
                square(sides);
            }
        }
        let root = ConfigObject::root(path, &value)?;
        let vision = vision(&root)?;
        let text = if root.contains("llm_config") { "llm_config" } else { "text_config" };
        let mut text = LlamaConfig::read(root.child_or_empty(text)?)?;
        text.tie_word_embeddings |= root.value("tie_word_embeddings")?.unwrap_or(false);
        let ratio = root.positive("downsample_ratio")?.unwrap_or(DOWNSAMPLE);
        let scale = (1.0 / ratio).round().clamp(1.0, 64.0) as usize;
        let side = vision.image_size / vision.patch_size;
        if (ratio * scale as f64 - 1.0).abs() > 1e-9 || !side.is_multiple_of(scale) {
            let problem = format!("{ratio} does not merge the {side} patches of a side into whole tokens");
            return Err(root.error("downsample_ratio", problem));
        }
        if root.value("ps_version")?.is_some_and(|version: String| version != "v2") {
            return Err(root.error("ps_version", "only v2 is supported"));
        }
        if root.value("projector_hidden_act")?.is_some_and(|act: Activation| act != Activation::Gelu) {
            return Err(root.error("projector_hidden_act", "only gelu is supported"));
        }
        for key in ["vision_feature_layer", "select_layer"] {
            if root.value(key)?.is_some_and(|layer: i64| layer != -1) {
                return Err(root.error(key, "only the last layer, -1, is supported"));
            }
        }
        let image_token = match root.first_id("image_token_id")? {
            Some(id) => id,
            None => named()?.and_then(|id| u32::try_from(id).ok()).unwrap_or(IMAGE_TOKEN),
        };
        if image_token as usize >= text.vocabulary {
            let problem = format!("{image_token} lies outside the vocabulary of {}", text.vocabulary);
            return Err(root.error("image_token_id", problem));
        }
        Ok(Self { vision, text, image_token, scale })
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

/// Reads the tower. Absent keys take the values of `InternViT-300M`, which both layouts' defaults are.
fn vision(root: &ConfigObject<'_>) -> Result<VisionConfig, MllmError> {
    let vision = root.child_or_empty("vision_config")?.with_defaults(json!({
        "hidden_size": 1024, "intermediate_size": 4096, "num_hidden_layers": 24, "num_attention_heads": 16,
        "image_size": 448, "patch_size": 14, "hidden_act": "gelu", "layer_norm_eps": 1e-6,
    }));
    for key in ["use_qk_norm", "qk_normalization"] {
        if vision.value(key)?.unwrap_or(false) {
            return Err(vision.error(key, "the tower of 6 billion weights is not supported; that of 300 million is"));
        }
    }
    for key in ["attention_bias", "qkv_bias"] {
        if vision.value(key)? == Some(false) {
            return Err(vision.error(key, "a tower without biases is not supported"));
        }
    }
    if vision.value("norm_type")?.is_some_and(|kind: String| kind != "layer_norm") {
        return Err(vision.error("norm_type", "only layer_norm is supported"));
    }
    VisionConfig::read(&vision)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(config: &Value) -> Result<InternVlConfig, MllmError> {
        InternVlConfig::from_json(Path::new("config.json"), config, || Ok(Some(7)))
    }

    #[test]
    fn both_layouts_are_read() {
        let text = json!({"model_type": "qwen2", "hidden_size": 896, "num_attention_heads": 14, "num_key_value_heads": 2,
            "vocab_size": 151_674, "rope_scaling": {"type": "dynamic", "rope_type": "dynamic", "factor": 2.0}});
        let original = json!({"model_type": "internvl_chat", "llm_config": text, "force_image_size": 448});
        let hf = json!({"model_type": "internvl", "text_config": text, "image_token_id": 7,
            "vision_config": {"image_size": [448, 448], "patch_size": [14, 14]}});
        assert_eq!(read(&original).unwrap(), read(&hf).unwrap());
        let config = read(&hf).unwrap();
        assert_eq!((config.tile_tokens(), config.scale, config.image_token), (256, 2, 7));
        assert!(config.text.attention_bias && !config.text.output_bias);
    }

    #[test]
    fn unsupported_configurations_are_named() {
        for (key, config) in [
            ("downsample_ratio", json!({"downsample_ratio": 0.3})),
            ("ps_version", json!({"ps_version": "v1"})),
            ("select_layer", json!({"select_layer": -4})),
            ("vision_config.qk_normalization", json!({"vision_config": {"qk_normalization": true}})),
            ("vision_config.norm_type", json!({"vision_config": {"norm_type": "rms_norm"}})),
            ("text_config.model_type", json!({"text_config": {"model_type": "internlm2"}})),
            ("image_token_id", json!({"image_token_id": 40_000})),
        ] {
            assert!(matches!(read(&config), Err(MllmError::Config { key: named, .. }) if named == key), "{config}");
        }
    }
}
