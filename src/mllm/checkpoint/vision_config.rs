//! The `vision_config` part of a configuration: a vision transformer.

use super::activation::Activation;
use super::section::Section;
use crate::mllm::MllmError;

/// A vision transformer over the patches of a square image and a class token.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct VisionConfig {
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
pub(crate) const CLIP_BASE: VisionConfig = VisionConfig {
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
pub(crate) const LLAVA_TOWER: VisionConfig = VisionConfig {
    hidden: 1024,
    intermediate: 4096,
    layers: 24,
    heads: 16,
    image_size: 336,
    patch_size: 14,
    act: Activation::QuickGelu,
    layer_norm_eps: 1e-5,
};

/// The tower of `cogvlm-chat-hf`.
const EVA_TOWER: VisionConfig = VisionConfig {
    hidden: 1792,
    intermediate: 15_360,
    layers: 63,
    heads: 16,
    image_size: 490,
    patch_size: 14,
    act: Activation::Gelu,
    layer_norm_eps: 1e-6,
};

/// Keys that not all configurations call alike.
struct Keys {
    heads: &'static str,
    channels: &'static str,
}

/// Largest image side, pixels: beyond it a configuration is taken for broken.
const MAX_IMAGE_SIZE: usize = 8192;

impl VisionConfig {
    /// Reads a `CLIPVisionConfig`.
    ///
    /// # Errors
    /// When a key has the wrong type or range, is unsupported, or contradicts another.
    pub(crate) fn from_clip_section(section: &Section<'_>, default: &Self) -> Result<Self, MllmError> {
        match section.text("model_type")? {
            None | Some("clip_vision_model") => {}
            Some(other) => {
                return Err(section
                    .error("model_type", format!("vision tower {other:?} is not supported; clip_vision_model is")));
            }
        }
        Self::read(section, default, &Keys { heads: "num_attention_heads", channels: "num_channels" })
    }

    /// Reads the `vision_config` of a `CogVLMConfig`, an EVA2-CLIP tower.
    ///
    /// # Errors
    /// As [`Self::from_clip_section`].
    pub(crate) fn from_cogvlm_section(section: &Section<'_>) -> Result<Self, MllmError> {
        let config = Self::read(section, &EVA_TOWER, &Keys { heads: "num_heads", channels: "in_channels" })?;
        let positions = config.patches() + 1;
        let named = section.count("num_positions", positions)?;
        if named != positions {
            return Err(section.error(
                "num_positions",
                format!("{named}, but {} patches and a class token make {positions}", config.patches()),
            ));
        }
        Ok(config)
    }

    fn read(section: &Section<'_>, default: &Self, keys: &Keys) -> Result<Self, MllmError> {
        let config = Self {
            hidden: section.count("hidden_size", default.hidden)?,
            intermediate: section.count("intermediate_size", default.intermediate)?,
            layers: section.count("num_hidden_layers", default.layers)?,
            heads: section.count(keys.heads, default.heads)?,
            image_size: section.count("image_size", default.image_size)?,
            patch_size: section.count("patch_size", default.patch_size)?,
            act: Activation::from_section(section, "hidden_act", default.act)?,
            layer_norm_eps: section.positive("layer_norm_eps", default.layer_norm_eps)?,
        };
        if section.count(keys.channels, 3)? != 3 {
            return Err(section.error(keys.channels, "only 3 (RGB) is supported".into()));
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
