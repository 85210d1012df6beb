//! The configuration of a decoder of Llama's kind: Llama, Mistral, Qwen 2 and Qwen 3.

use serde::Deserialize;
use serde_json::{Value, json};

use super::config::{ConfigObject, count, optional_count, positive};
use super::weights::Weights;
use crate::MllmError;
use planagent_kernels::Activation;
use planagent_kernels::attention::{Rope, RopeScaling, RotarySections};

/// A Llama decoder (`LlamaConfig`), or one of its relatives with other defaults: Mistral has a window, Qwen 2 (`Qwen2Config`)
/// biases of queries, keys and values, Qwen 3 (`Qwen3Config`) norms of queries and keys.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default)]
#[expect(clippy::struct_excessive_bools, reason = "these are the keys of configuration files")]
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
    /// Whether the projections to queries, keys and values have biases.
    pub attention_bias: bool,
    /// Whether the attention's output projection has a bias.
    #[serde(skip)]
    pub(crate) output_bias: bool,
    /// Whether queries and keys are normalized in each head.
    #[serde(skip)]
    pub(crate) head_norms: bool,
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
            output_bias: false,
            head_norms: false,
            mlp_bias: false,
            window: None,
            tie_word_embeddings: false,
        }
    }
}

/// Longest context, positions: beyond it a configuration is taken for broken.
const MAX_CONTEXT: usize = 1 << 20;

/// Which decoder a `text_config` describes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum DecoderType {
    Llama,
    Mistral,
    #[serde(alias = "qwen2_5_vl_text")]
    Qwen2,
    #[serde(alias = "qwen3_vl_text")]
    Qwen3,
}

#[derive(Deserialize)]
#[serde(rename_all = "snake_case")]
enum RopeType {
    Default,
    Linear,
    Llama3,
    /// Longer contexts than in training change the base; within it, this is the default.
    Dynamic,
    /// The default with sections.
    Mrope,
}

impl LlamaConfig {
    /// Reads a `text_config`.
    pub(crate) fn read(text: ConfigObject<'_>) -> Result<Self, MllmError> {
        let kind = text.value("model_type")?.unwrap_or(DecoderType::Llama);
        Self::read_as(text, kind)
    }

    /// Reads the keys of a decoder of this kind.
    pub(crate) fn read_as(text: ConfigObject<'_>, kind: DecoderType) -> Result<Self, MllmError> {
        match kind {
            // Only Mistral's layers have a window.
            DecoderType::Llama => Ok(Self { window: None, ..Self::read_with(text, Value::Null)? }),
            DecoderType::Mistral => Self::read_with(
                text,
                json!({
                    "intermediate_size": 14_336, "num_key_value_heads": 8, "max_position_embeddings": 131_072,
                    "sliding_window": 4096,
                }),
            ),
            DecoderType::Qwen2 | DecoderType::Qwen3 => {
                if text.value("use_sliding_window")?.unwrap_or(false) {
                    return Err(text.error("use_sliding_window", "a window in some of the layers is not supported"));
                }
                let qwen2 = kind == DecoderType::Qwen2;
                let mut defaults =
                    json!({"vocab_size": 151_936, "intermediate_size": 22_016, "max_position_embeddings": 32_768});
                if !qwen2 {
                    defaults["head_dim"] = json!(128);
                }
                let config = Self::read_with(text, defaults)?;
                let bias = config.attention_bias;
                Ok(Self {
                    window: None,
                    attention_bias: qwen2 || bias,
                    output_bias: !qwen2 && bias,
                    head_norms: !qwen2,
                    ..config
                })
            }
        }
    }

    /// Reads the keys of a decoder without a `model_type` of its own. Absent keys take `defaults`, then those of Llama.
    pub(crate) fn read_with(text: ConfigObject<'_>, defaults: Value) -> Result<Self, MllmError> {
        let text = text.with_defaults(defaults);
        if text.value("hidden_act")?.is_some_and(|act: Activation| act != Activation::Silu) {
            return Err(text.error("hidden_act", "only silu is supported"));
        }
        let mut config: Self = text.read()?;
        config.rope = read_rope(&text)?;
        config.output_bias = config.attention_bias;
        if config.kv_heads == 0 {
            config.kv_heads = config.heads;
        }
        if config.head_dim == 0 {
            if !config.hidden.is_multiple_of(config.heads) {
                let problem = format!("{} is no multiple of {} attention heads", config.hidden, config.heads);
                return Err(text.error("hidden_size", problem));
            }
            config.head_dim = config.hidden / config.heads;
        }
        config.validate().map_err(|(key, problem)| text.error(key, problem))?;
        Ok(config)
    }

    /// Whether the embedding is the output layer: the configuration says so, or the files have no other.
    pub(crate) fn is_tied(&self, weights: &Weights) -> bool {
        self.tie_word_embeddings || weights.lacks("lm_head.weight")
    }

    /// The first key that contradicts another, and why.
    fn validate(&self) -> Result<(), (&'static str, String)> {
        let Self { heads, kv_heads, head_dim, context, .. } = self;
        if !heads.is_multiple_of(*kv_heads) {
            return Err(("num_key_value_heads", format!("{kv_heads} does not divide {heads} attention heads")));
        }
        if !head_dim.is_multiple_of(2) {
            return Err(("head_dim", format!("{head_dim} is odd; rotary embeddings need pairs")));
        }
        if let Some(RotarySections { lengths, .. }) = self.rope.sections
            && lengths.iter().try_fold(0, |sum: usize, length| sum.checked_add(*length)) != Some(head_dim / 2)
        {
            let problem = format!("{lengths:?} do not add up to the {} pairs of a head", head_dim / 2);
            return Err(("mrope_section", problem));
        }
        if *context > MAX_CONTEXT {
            return Err(("max_position_embeddings", format!("at most {MAX_CONTEXT} positions are supported")));
        }
        Ok(())
    }
}

/// Reads `rope_parameters` (transformers 5), or `rope_theta` with `rope_scaling` (before).
fn read_rope(text: &ConfigObject<'_>) -> Result<Rope, MllmError> {
    let section = match text.child("rope_parameters")? {
        Some(section) => section,
        None => text.child_or_empty("rope_scaling")?,
    };
    let required =
        |key: &str| section.positive(key)?.ok_or_else(|| section.error(key, "is missing for this rope_type"));
    let kind = if section.contains("rope_type") { "rope_type" } else { "type" };
    let scaling = match section.value(kind)?.unwrap_or(RopeType::Default) {
        RopeType::Default | RopeType::Dynamic | RopeType::Mrope => RopeScaling::None,
        RopeType::Linear => RopeScaling::Linear { factor: required("factor")? },
        RopeType::Llama3 => RopeScaling::Llama3 {
            factor: required("factor")?,
            low_freq_factor: required("low_freq_factor")?,
            high_freq_factor: required("high_freq_factor")?,
            original_context: required("original_max_position_embeddings")?,
        },
    };
    let theta = text.positive("rope_theta")?.unwrap_or(Rope::default().theta);
    let sections = section.value("mrope_section")?.map(|lengths: [usize; 3]| -> Result<_, MllmError> {
        Ok(RotarySections { lengths, interleaved: section.value("mrope_interleaved")?.unwrap_or(false) })
    });
    let theta = section.positive("rope_theta")?.unwrap_or(theta);
    Ok(Rope { theta, scaling, sections: sections.transpose()? })
}
