//! The configuration of a vision transformer.

use serde::Deserialize;
use serde_json::json;

use super::config::{ConfigObject, count, positive};
use crate::MllmError;
use planagent_kernels::Activation;

/// A vision transformer over the patches of a square image. `CogVLM` and Qwen have other names for some keys.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default)]
pub(crate) struct VisionConfig {
    /// Width of the hidden states.
    #[serde(rename = "hidden_size", deserialize_with = "count")]
    pub hidden: usize,
    /// Width of the feed-forward layers.
    #[serde(rename = "intermediate_size", deserialize_with = "count")]
    pub intermediate: usize,
    #[serde(rename = "num_hidden_layers", alias = "depth", deserialize_with = "count")]
    pub layers: usize,
    #[serde(rename = "num_attention_heads", alias = "num_heads", deserialize_with = "count")]
    pub heads: usize,
    /// Side of the image, pixels.
    #[serde(deserialize_with = "count")]
    pub image_size: usize,
    /// Side of a patch, pixels.
    #[serde(deserialize_with = "count")]
    pub patch_size: usize,
    #[serde(rename = "hidden_act")]
    pub act: Activation,
    #[serde(deserialize_with = "positive")]
    pub layer_norm_eps: f64,
}

/// The defaults of `CLIPVisionConfig`.
impl Default for VisionConfig {
    fn default() -> Self {
        Self {
            hidden: 768,
            intermediate: 3072,
            layers: 12,
            heads: 12,
            image_size: 224,
            patch_size: 32,
            act: Activation::QuickGelu,
            layer_norm_eps: 1e-5,
        }
    }
}

/// Largest image side, pixels: beyond it a configuration is taken for broken.
const MAX_IMAGE_SIZE: usize = 8192;

/// The `model_type` of a LLaVA's tower.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
pub(crate) enum TowerType {
    #[serde(rename = "clip_vision_model")]
    Clip,
    /// Without a class token.
    #[serde(rename = "siglip_vision_model")]
    Siglip,
}

impl VisionConfig {
    /// Reads the `vision_config` of a LLaVA, a `CLIPVisionConfig` or `SiglipVisionConfig`. Without one, `LlavaConfig` and
    /// `LlavaNextConfig` take CLIP ViT-L/14 at 336 pixels.
    pub(crate) fn read_tower(root: &ConfigObject<'_>) -> Result<(Self, TowerType), MllmError> {
        let vision = match root.child("vision_config")? {
            Some(vision) => vision,
            None => root.child_or_empty("vision_config")?.with_defaults(json!({
                "hidden_size": 1024, "intermediate_size": 4096, "num_hidden_layers": 24, "num_attention_heads": 16,
                "image_size": 336, "patch_size": 14,
            })),
        };
        let tower = vision.value("model_type")?.unwrap_or(TowerType::Clip);
        let vision = match tower {
            TowerType::Clip => vision,
            TowerType::Siglip => vision.with_defaults(json!({
                "image_size": 224, "patch_size": 16, "hidden_act": "gelu_pytorch_tanh", "layer_norm_eps": 1e-6,
            })),
        };
        Ok((Self::read(&vision)?, tower))
    }

    /// Reads the keys of a vision transformer of any kind.
    pub(crate) fn read(vision: &ConfigObject<'_>) -> Result<Self, MllmError> {
        for key in ["num_channels", "in_channels"] {
            if vision.value(key)?.is_some_and(|channels: u64| channels != 3) {
                return Err(vision.error(key, "only 3 (RGB) is supported"));
            }
        }
        let config: Self = vision.read()?;
        config.validate().map_err(|(key, problem)| vision.error(key, problem))?;
        Ok(config)
    }

    /// The first key that contradicts another, and why.
    fn validate(&self) -> Result<(), (&'static str, String)> {
        let Self { hidden, heads, image_size, patch_size, .. } = self;
        if !hidden.is_multiple_of(*heads) {
            return Err(("hidden_size", format!("{hidden} is no multiple of {heads} heads")));
        }
        if patch_size > image_size {
            return Err(("patch_size", format!("{patch_size} exceeds the image size {image_size}")));
        }
        if *image_size > MAX_IMAGE_SIZE {
            return Err(("image_size", format!("at most {MAX_IMAGE_SIZE} pixels are supported")));
        }
        Ok(())
    }

    pub(crate) fn patches(&self) -> usize {
        let side = self.image_size / self.patch_size;
        side * side
    }
}
