//! `config.json` of a `Gemma4ForConditionalGeneration` checkpoint.

use crate::MllmError;
use crate::checkpoint::{ConfigObject, DecoderType, LlamaConfig, ModelFiles, Neutral, check_width};
use serde_json::Value;
use std::path::Path;

/// A Gemma 4: its tower, if it has one, and its decoder.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Gemma4Config {
    pub tower: Option<TowerConfig>,
    pub text: LlamaConfig,
    /// Token id that stands for a token of the image in the prompt.
    pub image_token: u32,
}

/// The vision tower (`Gemma4VisionConfig`).
#[derive(Debug, Clone, PartialEq)]
pub(super) struct TowerConfig {
    /// Width of the hidden states.
    pub hidden: usize,
    /// Width of the feed-forward layers.
    pub intermediate: usize,
    pub layers: usize,
    /// Heads of queries, and of keys and values.
    pub heads: [usize; 2],
    /// Width of a head.
    pub head_dim: usize,
    /// Side of a patch, pixels.
    pub patch: usize,
    /// Side of the blocks of patches that become one token.
    pub pool: usize,
    /// Learned positions along each axis.
    pub positions: usize,
    /// Base of the rotary embedding.
    pub theta: f64,
    pub eps: f64,
    /// Whether layers clamp what goes into them and comes out.
    pub clamped: bool,
    /// Whether the averages of blocks are shifted and scaled.
    pub standardized: bool,
}

/// Largest id of an image's token. A larger one means a broken configuration.
const MAX_ID: u32 = 1 << 24;
/// Most layers and heads, and largest side of a patch. Published towers have up to 27 of each.
const MAX_LAYERS: usize = 1 << 10;
/// Widest row of a layer.
const MAX_WIDTH: usize = 1 << 18;
/// Widest head.
const MAX_HEAD: usize = 1 << 12;
/// Largest side of a block, patches.
const MAX_POOL: usize = 16;
/// Most learned positions along an axis. Published towers have 10,240.
const MAX_POSITIONS: usize = 1 << 16;

impl Gemma4Config {
    pub(super) fn open(files: &ModelFiles) -> Result<Self, MllmError> {
        Self::from_json(
            &files.path("config.json"),
            &files.required_json("config.json")?,
        )
    }

    /// Reads a configuration; `path` is for messages.
    pub(super) fn from_json(path: &Path, value: &Value) -> Result<Self, MllmError> {
        const ID: &str = "image_token_id";
        let root = ConfigObject::root(path, value)?;
        let mut text =
            LlamaConfig::read_as(root.child_or_empty("text_config")?, DecoderType::Gemma4)?;
        text.tie_word_embeddings = root.value("tie_word_embeddings")?.unwrap_or(true);
        let image_token = root.first_id(ID)?.unwrap_or(258_880);
        if image_token > MAX_ID {
            let problem = format!("{image_token} is no token of any vocabulary");
            return Err(root.error(ID, problem));
        }
        let tower = root.child("vision_config")?;
        Ok(Self {
            tower: tower.map(|tower| TowerConfig::read(&tower)).transpose()?,
            text,
            image_token,
        })
    }
}

impl TowerConfig {
    fn read(vision: &ConfigObject<'_>) -> Result<Self, MllmError> {
        vision.only_neutral(&[("hidden_activation", Neutral::Text(&["gelu_pytorch_tanh"]))])?;
        let rope = vision.child_or_empty("rope_parameters")?;
        rope.only_neutral(&[("rope_type", Neutral::Text(&["axial", "default"]))])?;
        // Each number has a bound, and then each product of two.
        let count = |key: &str, default: usize, most: usize| -> Result<usize, MllmError> {
            let count = vision.value(key)?.unwrap_or(default);
            if (1..=most).contains(&count) {
                return Ok(count);
            }
            let problem = format!("expected a whole number from 1 to {most}, found {count}");
            Err(vision.error(key, problem))
        };
        let config = Self {
            hidden: count("hidden_size", 768, MAX_WIDTH)?,
            intermediate: count("intermediate_size", 3072, MAX_WIDTH)?,
            layers: count("num_hidden_layers", 16, MAX_LAYERS)?,
            heads: [
                count("num_attention_heads", 12, MAX_LAYERS)?,
                count("num_key_value_heads", 12, MAX_LAYERS)?,
            ],
            head_dim: count("head_dim", 64, MAX_HEAD)?,
            patch: count("patch_size", 16, MAX_LAYERS)?,
            pool: count("pooling_kernel_size", 3, MAX_POOL)?,
            positions: count("position_embedding_size", 10_240, MAX_POSITIONS)?,
            theta: rope.positive("rope_theta")?.unwrap_or(100.0),
            eps: vision.positive("rms_norm_eps")?.unwrap_or(1e-6),
            clamped: vision.value("use_clipped_linears")?.unwrap_or(false),
            standardized: vision.value("standardize")?.unwrap_or(false),
        };
        let [heads, kv_heads] = config.heads;
        check_width(vision, "num_attention_heads", heads, config.head_dim)?;
        check_width(vision, "position_embedding_size", config.positions, 2)?;
        if !heads.is_multiple_of(kv_heads) {
            let problem = format!("{kv_heads} does not divide {heads} attention heads");
            return Err(vision.error("num_key_value_heads", problem));
        }
        if !config.head_dim.is_multiple_of(4) {
            let problem = format!("{} is no multiple of 4, two pairs", config.head_dim);
            return Err(vision.error("head_dim", problem));
        }
        Ok(config)
    }

    /// Side of a token, pixels.
    pub(super) fn token(&self) -> usize {
        self.patch * self.pool
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checkpoint::LayerKeys;
    use serde_json::json;

    fn parse(value: &Value) -> Result<Gemma4Config, MllmError> {
        Gemma4Config::from_json(Path::new("config.json"), value)
    }

    /// The shapes of the fact sheet.
    #[test]
    fn the_published_e2b_shares_keys_and_widens_its_last_layers() {
        let config = parse(&json!({
            "text_config": {"model_type": "gemma4_text", "hidden_size": 1536, "intermediate_size": 6144,
                "num_hidden_layers": 35, "num_key_value_heads": 1, "num_kv_shared_layers": 20,
                "use_double_wide_mlp": true, "final_logit_softcapping": 30.0,
                "layer_types": (1..=35).map(|layer| if layer % 5 == 0 { "full_attention" } else { "sliding_attention" })
                    .collect::<Vec<_>>()},
            "vision_config": {"model_type": "gemma4_vision", "use_clipped_linears": true},
        }))
        .unwrap();
        let text = &config.text;
        let shape = |layer| text.shape(layer);
        assert_eq!((shape(13).head_dim, shape(14).head_dim), (256, 512));
        assert_eq!(
            (shape(14).intermediate, shape(15).intermediate),
            (6144, 12_288)
        );
        assert_eq!(
            [14, 15, 19, 34].map(|layer| shape(layer).keys),
            [
                LayerKeys::Projected,
                LayerKeys::Of(13),
                LayerKeys::Of(14),
                LayerKeys::Of(14)
            ]
        );
        assert_eq!(text.softcap, Some(30.0));
        assert_eq!((text.rotated, text.head_dim), (512, 256));
        // Twelve local layers of 256 numbers, three global ones of 512.
        let kept: usize = (0..35).filter_map(|layer| text.kept_keys(layer)).sum();
        assert_eq!(kept, 12 * 256 + 3 * 512);
        let tower = config.tower.unwrap();
        assert!(tower.clamped && !tower.standardized);
        assert_eq!((tower.token(), config.image_token), (48, 258_880));
    }

    #[test]
    fn the_published_31b_takes_keys_as_values_in_global_layers() {
        let config = parse(&json!({
            "text_config": {"hidden_size": 5376, "intermediate_size": 21_504, "num_hidden_layers": 60,
                "num_attention_heads": 32, "num_key_value_heads": 16, "num_global_key_value_heads": 4,
                "attention_k_eq_v": true, "hidden_size_per_layer_input": 0, "sliding_window": 1024,
                "use_bidirectional_attention": "vision"},
        }))
        .unwrap();
        let text = &config.text;
        assert_eq!(
            (text.shape(5).kv_heads, text.shape(5).keys),
            (4, LayerKeys::AsValues)
        );
        assert_eq!(
            (text.shape(4).kv_heads, text.shape(4).keys),
            (16, LayerKeys::Projected)
        );
        assert!(text.layer_inputs.is_none() && config.tower.is_none());
        let gemma = text.gemma.as_ref().unwrap();
        assert!(gemma.sees_image(4) && !gemma.sees_image(5) && gemma.sees_image_at_once());
    }

    #[test]
    fn shapes_of_single_layers_are_those_of_their_kind() {
        let written = |layers: Value| {
            parse(
                &json!({"text_config": {"num_hidden_layers": 6, "head_dim": 32, "per_layer_config": layers}}),
            )
        };
        let config = written(json!({"05": {"head_dim": 64}})).unwrap();
        assert_eq!(config.text.shape(5).head_dim, 64);
        assert_eq!(written(json!({})).unwrap().text.shape(5).head_dim, 32);
        for (layers, key) in [
            (json!({"6": {"head_dim": 64}}), "6"),
            (json!({"x": {"head_dim": 64}}), "x"),
            (json!({"4": {"head_dim": 64}}), "4"),
            (
                json!({"5": {"intermediate_size": 64}}),
                "5.intermediate_size",
            ),
            (json!({"5": {"head_dim": -1}}), "5.head_dim"),
            (json!({"5": {"head_dim": 0}}), "global_head_dim"),
            (json!({"5": 3}), "per_layer_config"),
        ] {
            let error = written(layers).unwrap_err().to_string();
            assert!(error.contains(key), "{key}: {error}");
        }
    }

    #[test]
    fn what_changes_the_result_and_is_not_read_is_refused() {
        for (keys, key) in [
            (
                json!({"text_config": {"enable_moe_block": true}}),
                "enable_moe_block",
            ),
            (
                json!({"text_config": {"use_bidirectional_attention": "all"}}),
                "use_bidirectional_attention",
            ),
            (
                json!({"text_config": {"hidden_activation": "silu"}}),
                "hidden_activation",
            ),
            (
                json!({"text_config": {"num_kv_shared_layers": 30}}),
                "num_kv_shared_layers",
            ),
            // No global layer is left before them.
            (
                json!({"text_config": {"num_kv_shared_layers": 26}}),
                "num_kv_shared_layers",
            ),
            (
                json!({"text_config": {"final_logit_softcapping": 0}}),
                "final_logit_softcapping",
            ),
            (
                json!({"text_config": {"global_head_dim": 511}}),
                "partial_rotary_factor",
            ),
            (
                json!({"text_config": {"global_head_dim": 1 << 20}}),
                "global_head_dim",
            ),
            (
                json!({"text_config": {"num_hidden_layers": 1 << 20}}),
                "num_hidden_layers",
            ),
            (
                json!({"text_config": {"attention_k_eq_v": true, "num_global_key_value_heads": 3}}),
                "num_global_key_value_heads",
            ),
            (
                json!({"text_config": {"hidden_size_per_layer_input": 1 << 20}}),
                "hidden_size_per_layer_input",
            ),
            (
                json!({"text_config": {"vocab_size_per_layer_input": 5}}),
                "vocab_size_per_layer_input",
            ),
            (
                json!({"text_config": {"pad_token_id": 262_144}}),
                "pad_token_id",
            ),
            (
                json!({"text_config": {"rope_parameters": {"full_attention": {"rope_type": "yarn"}}}}),
                "rope_parameters.full_attention.rope_type",
            ),
            (
                json!({"text_config": {"rope_parameters":
                    {"full_attention": {"rope_type": "proportional", "partial_rotary_factor": 1.5}}}}),
                "partial_rotary_factor",
            ),
            (json!({"image_token_id": 1 << 30}), "image_token_id"),
            (json!({"vision_config": {"head_dim": 6}}), "head_dim"),
            (
                json!({"vision_config": {"num_key_value_heads": 5}}),
                "num_key_value_heads",
            ),
            (json!({"vision_config": {"patch_size": 0}}), "patch_size"),
            (
                json!({"vision_config": {"pooling_kernel_size": 99}}),
                "pooling_kernel_size",
            ),
            (
                json!({"vision_config": {"position_embedding_size": 1 << 30}}),
                "position_embedding_size",
            ),
            (
                json!({"vision_config": {"hidden_activation": "relu"}}),
                "hidden_activation",
            ),
            (
                json!({"vision_config": {"rope_parameters": {"rope_type": "yarn"}}}),
                "rope_type",
            ),
        ] {
            let error = parse(&keys).unwrap_err().to_string();
            assert!(error.contains(key), "{keys}: {error}");
        }
    }
}
