//! The configuration of a Llama or Mistral decoder.

use serde::Deserialize;
use serde_json::{Value, json};

use super::activation::Activation;
use super::config::{ConfigObject, count, optional_count, positive};
use crate::mllm::MllmError;

/// A Llama decoder (`LlamaConfig`), or a Mistral one (`MistralConfig`), which has other defaults and a window.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default)]
pub struct LlamaConfig {
    /// Number of token ids.
    #[serde(rename = "vocab_size", deserialize_with = "count")]
    pub vocabulary: usize,
    /// Width of the hidden states.
    #[serde(rename = "hidden_size", deserialize_with = "count")]
    pub hidden: usize,
    /// Width of the feed-forward layers.
    #[serde(rename = "intermediate_size", deserialize_with = "count")]
    pub intermediate: usize,
    #[serde(rename = "num_hidden_layers", deserialize_with = "count")]
    pub layers: usize,
    /// Number of query heads.
    #[serde(rename = "num_attention_heads", deserialize_with = "count")]
    pub heads: usize,
    /// Number of key and value heads, a divisor of the query heads. The default is as many as query heads.
    #[serde(rename = "num_key_value_heads", deserialize_with = "count")]
    pub kv_heads: usize,
    /// Width of a head. The default is the hidden width divided by the heads.
    #[serde(deserialize_with = "count")]
    pub head_dim: usize,
    /// Positions that the decoder was trained for.
    #[serde(rename = "max_position_embeddings", deserialize_with = "count")]
    pub context: usize,
    #[serde(deserialize_with = "positive")]
    pub rms_norm_eps: f64,
    #[serde(skip)]
    pub(crate) rope: Rope,
    /// Whether the attention's projections have biases.
    pub attention_bias: bool,
    /// Whether the feed-forward layers have biases.
    pub mlp_bias: bool,
    /// Positions that a token sees, its own among them; none for all.
    #[serde(rename = "sliding_window", deserialize_with = "optional_count")]
    pub window: Option<usize>,
    /// Whether the output layer may share the embedding's weights.
    pub tie_word_embeddings: bool,
}

/// The defaults of `LlamaConfig`. Zero heads and widths are set once the others are known.
impl Default for LlamaConfig {
    fn default() -> Self {
        Self {
            vocabulary: 32_000,
            hidden: 4096,
            intermediate: 11_008,
            layers: 32,
            heads: 32,
            kv_heads: 0,
            head_dim: 0,
            context: 2048,
            rms_norm_eps: 1e-6,
            rope: Rope::default(),
            attention_bias: false,
            mlp_bias: false,
            window: None,
            tie_word_embeddings: false,
        }
    }
}

/// Rotary position embedding: base and scaling of its frequencies.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Rope {
    /// Base of the frequencies.
    pub theta: f64,
    pub scaling: RopeScaling,
}

impl Default for Rope {
    fn default() -> Self {
        Self { theta: 10_000.0, scaling: RopeScaling::None }
    }
}

/// How the frequencies are scaled for contexts longer than in training (`rope_type`).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum RopeScaling {
    None,
    /// All frequencies are divided by the factor.
    Linear {
        factor: f64,
    },
    /// Low frequencies are divided by the factor, high ones kept, those between interpolated.
    Llama3 {
        factor: f64,
        /// Wavelengths above `original_context / low_freq_factor` are scaled fully.
        low_freq_factor: f64,
        /// Wavelengths below `original_context / high_freq_factor` are kept.
        high_freq_factor: f64,
        /// Context of the first training.
        original_context: f64,
    },
}

/// Longest context, positions: bounds the table of rotary angles.
const MAX_CONTEXT: usize = 1 << 20;

/// Which decoder a `text_config` describes.
#[derive(Deserialize)]
#[serde(rename_all = "snake_case")]
enum ModelType {
    Llama,
    Mistral,
}

#[derive(Deserialize)]
#[serde(rename_all = "snake_case")]
enum RopeType {
    Default,
    Linear,
    Llama3,
}

impl LlamaConfig {
    /// Reads a `text_config`.
    pub(crate) fn read(text: ConfigObject<'_>) -> Result<Self, MllmError> {
        match text.value("model_type")?.unwrap_or(ModelType::Llama) {
            // Only Mistral's layers have a window.
            ModelType::Llama => Ok(Self { window: None, ..Self::read_with(text, Value::Null)? }),
            ModelType::Mistral => Self::read_with(
                text,
                json!({
                    "intermediate_size": 14_336, "num_key_value_heads": 8, "max_position_embeddings": 131_072,
                    "sliding_window": 4096,
                }),
            ),
        }
    }

    /// Reads the keys of a decoder without a `model_type` of its own. Absent keys take `defaults`, then those of Llama.
    pub(crate) fn read_with(text: ConfigObject<'_>, defaults: Value) -> Result<Self, MllmError> {
        let text = text.with_defaults(defaults);
        if text.value("hidden_act")?.is_some_and(|act: Activation| act != Activation::Silu) {
            return Err(text.error("hidden_act", "only silu is supported"));
        }
        let mut config: Self = text.read()?;
        config.rope = Rope::read(&text)?;
        if config.kv_heads == 0 {
            config.kv_heads = config.heads;
        }
        if config.head_dim == 0 {
            config.head_dim = config.hidden / config.heads;
        }
        config.validate().map_err(|(key, problem)| text.error(key, problem))?;
        Ok(config)
    }

    /// The first key that contradicts another, and why.
    fn validate(&self) -> Result<(), (&'static str, String)> {
        let Self { hidden, heads, kv_heads, head_dim, context, .. } = self;
        if !hidden.is_multiple_of(*heads) {
            return Err(("hidden_size", format!("{hidden} is no multiple of {heads} attention heads")));
        }
        if !heads.is_multiple_of(*kv_heads) {
            return Err(("num_key_value_heads", format!("{kv_heads} does not divide {heads} attention heads")));
        }
        if !head_dim.is_multiple_of(2) {
            return Err(("head_dim", format!("{head_dim} is odd; rotary embeddings need pairs")));
        }
        if *context > MAX_CONTEXT {
            return Err(("max_position_embeddings", format!("at most {MAX_CONTEXT} positions are supported")));
        }
        Ok(())
    }
}

impl Rope {
    /// Reads `rope_parameters` (transformers 5), or `rope_theta` with `rope_scaling` (before).
    fn read(text: &ConfigObject<'_>) -> Result<Self, MllmError> {
        let section = match text.child("rope_parameters")? {
            Some(section) => section,
            None => text.child_or_empty("rope_scaling")?,
        };
        let required =
            |key: &str| section.positive(key)?.ok_or_else(|| section.error(key, "is missing for this rope_type"));
        let kind = if section.contains("rope_type") { "rope_type" } else { "type" };
        let scaling = match section.value(kind)?.unwrap_or(RopeType::Default) {
            RopeType::Default => RopeScaling::None,
            RopeType::Linear => RopeScaling::Linear { factor: required("factor")? },
            RopeType::Llama3 => RopeScaling::Llama3 {
                factor: required("factor")?,
                low_freq_factor: required("low_freq_factor")?,
                high_freq_factor: required("high_freq_factor")?,
                original_context: required("original_max_position_embeddings")?,
            },
        };
        let theta = text.positive("rope_theta")?.unwrap_or(Self::default().theta);
        Ok(Self { theta: section.positive("rope_theta")?.unwrap_or(theta), scaling })
    }
}
