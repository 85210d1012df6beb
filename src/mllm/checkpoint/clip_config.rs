//! The `vision_config` part of a configuration: a CLIP vision tower.

use super::activation::Activation;
use super::section::Section;
use crate::mllm::MllmError;

/// A CLIP vision tower (`CLIPVisionConfig`).
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ClipVisionConfig {
    /// Width of the hidden states.
    pub hidden: usize,
    /// Width of the feed-forward layers.
    pub intermediate: usize,
    /// Number of layers.
    pub layers: usize,
    /// Number of attention heads.
    pub heads: usize,
    /// Side of the image, pixels.
    pub image_size: usize,
    /// Side of a patch, pixels.
    pub patch_size: usize,
    /// Activation of the feed-forward layers.
    pub act: Activation,
    /// Epsilon of the layer norms.
    pub layer_norm_eps: f64,
}

/// Defaults of `CLIPVisionConfig`.
pub(crate) const CLIP_BASE: ClipVisionConfig = ClipVisionConfig {
    hidden: 768,
    intermediate: 3072,
    layers: 12,
    heads: 12,
    image_size: 224,
    patch_size: 32,
    act: Activation::QuickGelu,
    layer_norm_eps: 1e-5,
};

/// What `LlavaConfig` and `LlavaNextConfig` take when they have no `vision_config` at all: CLIP ViT-L/14 at 336 pixels.
pub(crate) const LLAVA_TOWER: ClipVisionConfig = ClipVisionConfig {
    hidden: 1024,
    intermediate: 4096,
    layers: 24,
    heads: 16,
    image_size: 336,
    patch_size: 14,
    act: Activation::QuickGelu,
    layer_norm_eps: 1e-5,
};

impl ClipVisionConfig {
    /// Reads the section.
    ///
    /// # Errors
    /// When a key has the wrong type or range, or is unsupported.
    pub(crate) fn from_section(section: &Section<'_>, default: &Self) -> Result<Self, MllmError> {
        match section.text("model_type")? {
            None | Some("clip_vision_model") => {}
            Some(other) => {
                return Err(section
                    .error("model_type", format!("vision tower {other:?} is not supported; clip_vision_model is")));
            }
        }
        let config = Self {
            hidden: section.count("hidden_size", default.hidden)?,
            intermediate: section.count("intermediate_size", default.intermediate)?,
            layers: section.count("num_hidden_layers", default.layers)?,
            heads: section.count("num_attention_heads", default.heads)?,
            image_size: section.count("image_size", default.image_size)?,
            patch_size: section.count("patch_size", default.patch_size)?,
            act: Activation::from_section(section, "hidden_act", default.act)?,
            layer_norm_eps: section.positive("layer_norm_eps", default.layer_norm_eps)?,
        };
        if section.count("num_channels", 3)? != 3 {
            return Err(section.error("num_channels", "only 3 (RGB) is supported".into()));
        }
        if !config.hidden.is_multiple_of(config.heads) {
            return Err(
                section.error("hidden_size", format!("{} is no multiple of {} heads", config.hidden, config.heads))
            );
        }
        if config.patch_size > config.image_size {
            return Err(section
                .error("patch_size", format!("{} exceeds the image size {}", config.patch_size, config.image_size)));
        }
        if config.image_size > MAX_IMAGE_SIZE {
            return Err(section.error("image_size", format!("at most {MAX_IMAGE_SIZE}")));
        }
        Ok(config)
    }

    /// Patches of an image.
    pub(crate) fn patches(&self) -> usize {
        let side = self.image_size / self.patch_size;
        side * side
    }
}

/// Largest image side, pixels: beyond it a configuration is taken for broken.
const MAX_IMAGE_SIZE: usize = 8192;
