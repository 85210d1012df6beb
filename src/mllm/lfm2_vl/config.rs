//! `config.json` of an `Lfm2VlForConditionalGeneration` checkpoint.

use crate::MllmError;
use crate::checkpoint::{
    ConfigObject, DecoderType, LlamaConfig, ModelFiles, Neutral, VisionConfig, check_width,
};
use planagent_kernels::Activation;
use serde_json::{Value, json};
use std::path::Path;

/// An LFM2-VL: its vision tower, its decoder, and how they are joined.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Lfm2VlConfig {
    /// The tower; its image size is that of the learned positions.
    pub vision: VisionConfig,
    /// Learned positions along a side.
    pub positions: usize,
    /// Side of the blocks of patches that become one token (`downsample_factor`).
    pub downsample: usize,
    /// Width between the projector's layers.
    pub projector: usize,
    pub projector_act: Activation,
    pub projector_bias: bool,
    /// Whether blocks are normalized before the projector.
    pub projector_norm: bool,
    pub text: LlamaConfig,
    /// Token id that stands for a token of the image in the prompt.
    pub image_token: u32,
}

/// The id of an image's token in the published tokenizers.
const IMAGE_TOKEN: u32 = 396;

impl Lfm2VlConfig {
    pub(super) fn open(files: &ModelFiles) -> Result<Self, MllmError> {
        Self::from_json(
            &files.path("config.json"),
            &files.required_json("config.json")?,
        )
    }

    /// Reads a configuration; `path` is for messages.
    pub(super) fn from_json(path: &Path, value: &Value) -> Result<Self, MllmError> {
        let root = ConfigObject::root(path, value)?;
        // All layers of the tower count.
        root.only_neutral(&[("vision_feature_layer", Neutral::Number(-1.0))])?;
        let (vision, positions) = tower(&root)?;
        let mut text =
            LlamaConfig::read_as(root.child_or_empty("text_config")?, DecoderType::Lfm2)?;
        // The name of older files comes first.
        let tied = match root.value("tie_embedding")? {
            Some(tied) => Some(tied),
            None => root.value("tie_word_embeddings")?,
        };
        text.tie_word_embeddings = tied.unwrap_or(true);
        let count = |key: &str, default: usize, most: usize| -> Result<usize, MllmError> {
            let count = root.value(key)?.unwrap_or(default);
            if (1..=most).contains(&count) {
                return Ok(count);
            }
            let problem = format!("expected a whole number from 1 to {most}, found {count}");
            Err(root.error(key, problem))
        };
        let downsample = count("downsample_factor", 2, 16)?;
        check_width(
            &root,
            "downsample_factor",
            downsample * downsample,
            vision.hidden,
        )?;
        Ok(Self {
            positions,
            downsample,
            projector: count("projector_hidden_size", 2560, 1 << 20)?,
            projector_act: root
                .value("projector_hidden_act")?
                .unwrap_or(Activation::Gelu),
            projector_bias: root.value("projector_bias")?.unwrap_or(true),
            projector_norm: root.value("projector_use_layernorm")?.unwrap_or(true),
            image_token: image_token(&root, text.vocabulary)?,
            vision,
            text,
        })
    }

    /// Width of a block of patches.
    pub(super) fn block(&self) -> usize {
        self.vision.hidden * self.downsample * self.downsample
    }
}

/// The tower, and its learned positions along a side.
fn tower(root: &ConfigObject<'_>) -> Result<(VisionConfig, usize), MllmError> {
    const POSITIONS: &str = "num_patches";
    // The defaults of `Siglip2VisionConfig`.
    let vision = root.child_or_empty("vision_config")?.with_defaults(json!({
        "hidden_size": 768, "intermediate_size": 3072, "num_hidden_layers": 12, "num_attention_heads": 12,
        "patch_size": 16, "hidden_act": "gelu_pytorch_tanh", "layer_norm_eps": 1e-6, POSITIONS: 256,
    }));
    let learned: usize = vision.value(POSITIONS)?.unwrap_or(0);
    let side = learned.isqrt();
    if side * side != learned || !(1..=1 << 16).contains(&learned) {
        let problem = format!(
            "expected a square number from 1 to {}, found {learned}",
            1 << 16
        );
        return Err(vision.error(POSITIONS, problem));
    }
    let patch: usize = vision.value("patch_size")?.unwrap_or(0);
    if !(1..=256).contains(&patch) {
        let problem = format!("expected a whole number from 1 to 256, found {patch}");
        return Err(vision.error("patch_size", problem));
    }
    let mut sized = vision;
    // It says nothing here: views have any size.
    sized.remove("image_size");
    let sized = sized.with_defaults(json!({"image_size": side * patch}));
    Ok((VisionConfig::read(&sized)?, side))
}

/// The id of an image's token, under the name of today or of the first files.
fn image_token(root: &ConfigObject<'_>, vocabulary: usize) -> Result<u32, MllmError> {
    let key = if root.contains("image_token_id") {
        "image_token_id"
    } else {
        "image_token_index"
    };
    let id = root.first_id(key)?.unwrap_or(IMAGE_TOKEN);
    if (id as usize) < vocabulary {
        return Ok(id);
    }
    let problem = format!("{id} lies outside the vocabulary of {vocabulary}");
    Err(root.error(key, problem))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(config: &Value) -> Result<Lfm2VlConfig, MllmError> {
        Lfm2VlConfig::from_json(Path::new("config.json"), config)
    }

    #[test]
    fn published_configurations_of_both_years_are_read() {
        let text = json!({"hidden_size": 1024, "block_ff_dim": 6656, "num_hidden_layers": 16, "num_attention_heads": 16,
            "full_attn_idxs": [2, 5, 8, 10, 12, 14], "num_key_value_heads": 8, "model_type": "lfm2"});
        let first = read(
            &json!({"model_type": "lfm2-vl", "image_token_index": 396, "vision_feature_layer": -1,
            "text_config": text, "vision_config": {"model_type": "siglip2_vision_model", "vision_use_head": false}}),
        );
        let later = read(
            &json!({"model_type": "lfm2_vl", "image_token_id": 396, "projector_use_layernorm": false,
            "projector_hidden_size": 2048, "text_config": text, "vision_config": {}}),
        );
        let [first, later] = [first, later].map(Result::unwrap);
        assert_eq!(
            (first.projector, first.projector_norm, first.positions),
            (2560, true, 16)
        );
        assert_eq!((later.projector, later.projector_norm), (2048, false));
        assert_eq!((first.text.intermediate, first.text.head_dim), (4608, 64));
        assert_eq!(
            (first.text.attention_layers(), first.vision.layers),
            (6, 12)
        );
        assert!(first.text.tie_word_embeddings);
    }

    #[test]
    fn broken_configurations_are_named() {
        assert!(read(&json!({})).is_ok());
        for (config, key) in [
            (json!({"downsample_factor": 0}), "downsample_factor"),
            (json!({"image_token_index": 70_000}), "image_token_index"),
            (json!({"vision_feature_layer": -2}), "vision_feature_layer"),
            (
                json!({"projector_hidden_act": "odd"}),
                "projector_hidden_act",
            ),
            (json!({"projector_hidden_size": 0}), "projector_hidden_size"),
            (
                json!({"vision_config": {"num_patches": 250}}),
                "vision_config.num_patches",
            ),
            (
                json!({"vision_config": {"num_patches": 1_u64 << 40}}),
                "vision_config.num_patches",
            ),
            (
                json!({"vision_config": {"patch_size": 0}}),
                "vision_config.patch_size",
            ),
            (
                json!({"vision_config": {"num_channels": 4}}),
                "vision_config.num_channels",
            ),
            (
                json!({"text_config": {"conv_L_cache": 0}}),
                "text_config.conv_L_cache",
            ),
        ] {
            let error = read(&config).unwrap_err().to_string();
            assert!(
                error.starts_with(&format!("config.json: {key}: ")),
                "{error}"
            );
        }
    }
}
