//! `config.json` of a `Qwen2_5_VLForConditionalGeneration` checkpoint: with the decoder's keys at
//! the root, as all published files, or under `text_config`.

use crate::MllmError;
use crate::checkpoint::{
    ConfigObject, DecoderType, LlamaConfig, ModelFiles, VisionConfig, check_width,
};
use crate::qwen3_vl::{check_tower_rope, image_token, text_config};
use planagent_kernels::Activation;
use serde_json::{Value, json};
use std::path::Path;

/// A Qwen2.5-VL: its vision tower, its decoder, and how they are joined.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Qwen25VlConfig {
    pub vision: VisionConfig,
    /// Side of a window, patches.
    pub window: usize,
    /// Layers of the tower, from 0, that attend to the whole image.
    pub whole: Vec<usize>,
    /// Side of the blocks of patches that become one token (`spatial_merge_size`).
    pub merge: usize,
    /// Frames that a patch holds (`temporal_patch_size`).
    pub frames: usize,
    pub text: LlamaConfig,
    /// Token id that stands for a token of the image in the prompt.
    pub image_token: u32,
}

impl Qwen25VlConfig {
    pub(super) fn open(files: &ModelFiles) -> Result<Self, MllmError> {
        Self::from_json(
            &files.path("config.json"),
            &files.required_json("config.json")?,
        )
    }

    /// Reads a configuration; `path` is for messages.
    pub(super) fn from_json(path: &Path, value: &Value) -> Result<Self, MllmError> {
        let root = ConfigObject::root(path, value)?;
        // The defaults of `Qwen2_5_VLVisionConfig`. The norms' epsilon is no key.
        let vision = root.child_or_empty("vision_config")?.with_defaults(json!({
            "depth": 32, "hidden_size": 3584, "intermediate_size": 3420, "num_heads": 16, "patch_size": 14,
            "hidden_act": "silu", "layer_norm_eps": 1e-6, "spatial_merge_size": 2, "temporal_patch_size": 2,
            "window_size": 112, "fullatt_block_indexes": [7, 15, 23, 31],
        }));
        check_tower_rope(&vision)?;
        let tower = VisionConfig::read(&vision)?;
        if tower.act != Activation::Silu {
            return Err(vision.error("hidden_act", "only silu is supported"));
        }
        if !(tower.hidden / tower.heads).is_multiple_of(4) {
            return Err(vision.error("num_heads", "the width of a head must be a multiple of 4"));
        }
        let count = |key: &str, most: usize| -> Result<usize, MllmError> {
            let count = vision.value(key)?.unwrap_or(0);
            if (1..=most).contains(&count) {
                return Ok(count);
            }
            Err(vision.error(
                key,
                format!("expected a whole number from 1 to {most}, found {count}"),
            ))
        };
        let merge = count("spatial_merge_size", 16)?;
        check_width(&vision, "spatial_merge_size", merge * merge, tower.hidden)?;
        let window = count("window_size", 1 << 16)? / tower.patch_size / merge * merge;
        if window == 0 {
            return Err(vision.error("window_size", "is smaller than a token"));
        }
        let text = text_config(&root, DecoderType::Qwen25Vl)?;
        if vision
            .value("out_hidden_size")?
            .is_some_and(|width: usize| width != text.hidden)
        {
            return Err(vision.error(
                "out_hidden_size",
                format!("the decoder takes {}", text.hidden),
            ));
        }
        Ok(Self {
            window,
            whole: vision.list("fullatt_block_indexes")?,
            merge,
            frames: count("temporal_patch_size", 16)?,
            image_token: image_token(&root, text.vocabulary)?,
            vision: tower,
            text,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_forms_are_read() {
        let text = json!({"hidden_size": 2048, "num_attention_heads": 16, "num_key_value_heads": 2, "vocab_size": 151_936,
            "num_hidden_layers": 36, "intermediate_size": 11_008, "rope_theta": 1e6, "sliding_window": 32_768,
            "use_sliding_window": false, "rope_scaling": {"type": "mrope", "mrope_section": [16, 24, 24]}});
        let vision = json!({"hidden_size": 1280, "out_hidden_size": 2048, "in_chans": 3, "spatial_patch_size": 14});
        let mut flat = text.clone();
        flat["vision_config"] = vision.clone();
        let nested = json!({"text_config": text, "vision_config": vision});
        let read = |config: &Value| Qwen25VlConfig::from_json(Path::new("config.json"), config);
        let config = read(&flat).unwrap();
        assert_eq!(config, read(&nested).unwrap());
        assert_eq!(
            (config.window, config.text.head_dim, config.text.window),
            (8, 128, None)
        );
        assert!(config.text.attention_bias && !config.text.output_bias && !config.text.head_norms);
        for (key, pointer, value) in [
            (
                "mrope_section",
                "/rope_scaling/mrope_section",
                json!([16, 24, 20]),
            ),
            ("window_size", "/vision_config/window_size", json!(20)),
            ("hidden_act", "/vision_config/hidden_act", json!("gelu")),
        ] {
            let mut changed = flat.clone();
            changed["vision_config"]["window_size"] = json!(112);
            changed["vision_config"]["hidden_act"] = json!("silu");
            *changed.pointer_mut(pointer).unwrap() = value;
            let error = read(&changed).unwrap_err().to_string();
            assert!(error.contains(key), "{error}");
        }
    }
}
