//! The configuration of a vision transformer.

use super::config::{ConfigObject, check_ranges, count, positive};
use super::neutral::Neutral;
use crate::MllmError;
use planagent_kernels::Activation;
use serde::Deserialize;
use serde_json::json;

/// A vision transformer over the patches of a square image. `CogVLM` and Qwen have other names for
/// some keys.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default)]
pub(crate) struct VisionConfig {
    /// Width of the hidden states.
    #[serde(rename = "hidden_size", deserialize_with = "count")]
    pub hidden: usize,
    /// Width of the feed-forward layers.
    #[serde(rename = "intermediate_size", deserialize_with = "count")]
    pub intermediate: usize,
    #[serde(
        rename = "num_hidden_layers",
        alias = "depth",
        deserialize_with = "count"
    )]
    pub layers: usize,
    #[serde(
        rename = "num_attention_heads",
        alias = "num_heads",
        deserialize_with = "count"
    )]
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
/// Largest side of a patch, pixels, and most layers and heads. Published towers have up to 64 of
/// each.
const MAX_LAYERS: usize = 1 << 10;
/// Widest row of a layer. Those of 6 billion weights are 12,800 wide.
const MAX_WIDTH: usize = 1 << 18;
/// Most patches of an image, each of which attends to all. Published towers for one size have up to
/// 4096.
const MAX_PATCHES: usize = 1 << 16;

/// Keys of any vision transformer that no code reads.
const NEUTRAL: [(&str, Neutral); 2] = [
    ("num_channels", Neutral::Number(3.0)),
    ("in_channels", Neutral::Number(3.0)),
];

/// The class of a LLaVA's tower.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
pub(crate) enum TowerType {
    #[serde(rename = "clip_vision_model")]
    Clip,
    /// Without a class token.
    #[serde(rename = "siglip_vision_model")]
    Siglip,
}

impl VisionConfig {
    /// Reads the `vision_config` of a LLaVA, a `CLIPVisionConfig` or `SiglipVisionConfig`. Without
    /// one, `LlavaConfig` and `LlavaNextConfig` take CLIP ViT-L/14 at 336 pixels.
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
                "patch_size": 16, "hidden_act": "gelu_pytorch_tanh", "layer_norm_eps": 1e-6,
            })),
        };
        Ok((Self::read(&vision)?, tower))
    }

    /// Reads the keys of a vision transformer of any kind.
    pub(crate) fn read(vision: &ConfigObject<'_>) -> Result<Self, MllmError> {
        vision.only_neutral(&NEUTRAL)?;
        let config: Self = vision.read()?;
        let layers = if vision.contains("depth") {
            "depth"
        } else {
            "num_hidden_layers"
        };
        let heads = if vision.contains("num_heads") {
            "num_heads"
        } else {
            "num_attention_heads"
        };
        check_ranges(
            vision,
            &[
                ("hidden_size", config.hidden, MAX_WIDTH),
                ("intermediate_size", config.intermediate, MAX_WIDTH),
                (layers, config.layers, MAX_LAYERS),
                (heads, config.heads, MAX_LAYERS),
                ("image_size", config.image_size, MAX_IMAGE_SIZE),
                ("patch_size", config.patch_size, MAX_LAYERS),
            ],
        )?;
        config
            .validate()
            .map_err(|(key, problem)| vision.error(key, problem))?;
        Ok(config)
    }

    /// The first key that contradicts another, and why.
    fn validate(&self) -> Result<(), (&'static str, String)> {
        let Self {
            hidden,
            heads,
            image_size,
            patch_size,
            ..
        } = self;
        if !hidden.is_multiple_of(*heads) {
            return Err((
                "hidden_size",
                format!("{hidden} is no multiple of {heads} heads"),
            ));
        }
        if patch_size > image_size {
            return Err((
                "patch_size",
                format!("{patch_size} exceeds the image size {image_size}"),
            ));
        }
        if self.patches() > MAX_PATCHES {
            let problem = format!(
                "an image has {} patches of {patch_size} pixels a side, {MAX_PATCHES} are supported",
                self.patches()
            );
            return Err(("patch_size", problem));
        }
        Ok(())
    }

    pub(crate) fn patches(&self) -> usize {
        let side = self.image_size / self.patch_size;
        side * side
    }
}
