//! `config.json` of a `Qwen2VLForConditionalGeneration` checkpoint: with the decoder's keys at the
//! root, as all published files, or under `text_config`.

use crate::MllmError;
use crate::checkpoint::{
    ConfigObject, DecoderType, LlamaConfig, ModelFiles, VisionConfig, check_width,
};
use crate::qwen3_vl::{check_tower_rope, image_token, text_config};
use serde_json::{Value, json};
use std::path::Path;

/// A Qwen2-VL: its vision tower, its decoder, and how they are joined.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Qwen2VlConfig {
    pub vision: VisionConfig,
    /// Side of the blocks of patches that become one token (`spatial_merge_size`).
    pub merge: usize,
    /// Frames that a patch holds (`temporal_patch_size`).
    pub frames: usize,
    pub text: LlamaConfig,
    /// Token id that stands for a token of the image in the prompt.
    pub image_token: u32,
}

/// Width of the tower and, as a multiple of it, of its feed-forward layers.
const WIDTH: &str = "embed_dim";
const RATIO: &str = "mlp_ratio";
/// Widest row of a layer; a wider one means a broken configuration.
const MAX_WIDTH: usize = 1 << 18;

impl Qwen2VlConfig {
    pub(super) fn open(files: &ModelFiles) -> Result<Self, MllmError> {
        Self::from_json(
            &files.path("config.json"),
            &files.required_json("config.json")?,
        )
    }

    /// Reads a configuration; `path` is for messages.
    pub(super) fn from_json(path: &Path, value: &Value) -> Result<Self, MllmError> {
        let root = ConfigObject::root(path, value)?;
        // The defaults of `Qwen2VLVisionConfig`. The norms' epsilon is no key.
        let vision = root.child_or_empty("vision_config")?.with_defaults(json!({
            "depth": 32, "embed_dim": 1280, "hidden_size": 3584, "mlp_ratio": 4, "num_heads": 16, "patch_size": 14,
            "hidden_act": "quick_gelu", "spatial_merge_size": 2, "temporal_patch_size": 2,
        }));
        check_tower_rope(&vision)?;
        let tower = tower(&vision)?;
        if !(tower.hidden / tower.heads).is_multiple_of(4) {
            return Err(vision.error("num_heads", "the width of a head must be a multiple of 4"));
        }
        let merge = count(&vision, "spatial_merge_size", 16)?;
        check_width(&vision, "spatial_merge_size", merge * merge, tower.hidden)?;
        let text = text_config(&root, DecoderType::Qwen25Vl)?;
        if count(&vision, "hidden_size", MAX_WIDTH)? != text.hidden {
            return Err(vision.error("hidden_size", format!("the decoder takes {}", text.hidden)));
        }
        Ok(Self {
            merge,
            frames: count(&vision, "temporal_patch_size", 16)?,
            image_token: image_token(&root, text.vocabulary)?,
            vision: tower,
            text,
        })
    }
}

fn count(vision: &ConfigObject<'_>, key: &str, most: usize) -> Result<usize, MllmError> {
    let count = vision.value(key)?.unwrap_or(0);
    if (1..=most).contains(&count) {
        return Ok(count);
    }
    Err(vision.error(
        key,
        format!("expected a whole number from 1 to {most}, found {count}"),
    ))
}

/// The tower, whose `hidden_size` is that of the decoder: its own width has another key.
fn tower(vision: &ConfigObject<'_>) -> Result<VisionConfig, MllmError> {
    let hidden = count(vision, WIDTH, MAX_WIDTH)?;
    let ratio = vision.positive(RATIO)?.unwrap_or(0.0);
    let intermediate = hidden as f64 * ratio;
    if !(1.0..=MAX_WIDTH as f64).contains(&intermediate) {
        let problem = format!(
            "{ratio} times the width {hidden} is no width of a layer from 1 to {MAX_WIDTH}"
        );
        return Err(vision.error(RATIO, problem));
    }
    let mut sized = vision.clone();
    for key in ["hidden_size", "intermediate_size", "layer_norm_eps"] {
        sized.remove(key);
    }
    VisionConfig::read(&sized.with_defaults(json!({
        "hidden_size": hidden, "intermediate_size": intermediate as usize, "layer_norm_eps": 1e-6,
    })))
}

#[cfg(test)]
mod tests {
    use super::*;
    use planagent_kernels::Activation;

    #[test]
    fn both_forms_are_read() {
        let text = json!({"hidden_size": 1536, "num_attention_heads": 12, "num_key_value_heads": 2, "vocab_size": 151_936,
            "num_hidden_layers": 28, "intermediate_size": 8960, "rope_theta": 1e6, "sliding_window": 32_768,
            "use_sliding_window": false, "rope_scaling": {"type": "mrope", "mrope_section": [16, 24, 24]}});
        let vision = json!({"hidden_size": 1536, "embed_dim": 1280, "mlp_ratio": 4, "in_chans": 3,
            "in_channels": 3, "spatial_patch_size": 14});
        let mut flat = text.clone();
        flat["vision_config"] = vision.clone();
        let nested = json!({"text_config": text, "vision_config": vision});
        let read = |config: &Value| Qwen2VlConfig::from_json(Path::new("config.json"), config);
        let config = read(&flat).unwrap();
        assert_eq!(config, read(&nested).unwrap());
        let tower = &config.vision;
        assert_eq!((tower.hidden, tower.intermediate), (1280, 5120));
        assert_eq!((tower.act, tower.layers), (Activation::QuickGelu, 32));
        assert_eq!((config.text.head_dim, config.text.window), (128, None));
        assert!(config.text.attention_bias && !config.text.output_bias && !config.text.head_norms);
        for (key, pointer, value) in [
            (
                "mrope_section",
                "/rope_scaling/mrope_section",
                json!([16, 24, 20]),
            ),
            ("hidden_size", "/vision_config/hidden_size", json!(1280)),
            ("embed_dim", "/vision_config/embed_dim", json!(0)),
            ("mlp_ratio", "/vision_config/mlp_ratio", json!(1e300)),
            ("mlp_ratio", "/vision_config/mlp_ratio", json!(-4)),
            ("in_channels", "/vision_config/in_channels", json!(4)),
        ] {
            let mut changed = flat.clone();
            *changed.pointer_mut(pointer).unwrap() = value;
            let error = read(&changed).unwrap_err().to_string();
            assert!(error.contains(key), "{error}");
        }
    }
}
