//! The `text_config` part of a configuration: a Llama or Mistral decoder.

use super::activation::Activation;
use super::section::Section;
use crate::mllm::MllmError;

/// A Llama decoder (`LlamaConfig`), or a Mistral one (`MistralConfig`), which differs in its defaults and its window.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LlamaConfig {
    /// Number of token ids.
    pub vocabulary: usize,
    /// Width of the hidden states.
    pub hidden: usize,
    /// Width of the feed-forward layers.
    pub intermediate: usize,
    /// Number of layers.
    pub layers: usize,
    /// Number of query heads.
    pub heads: usize,
    /// Number of key and value heads, which divides the query heads.
    pub kv_heads: usize,
    /// Width of a head.
    pub head_dim: usize,
    /// Most positions (`max_position_embeddings`).
    pub context: usize,
    /// Epsilon of the RMS norms.
    pub rms_norm_eps: f64,
    /// Rotary position embedding.
    pub rope: Rope,
    /// Whether the attention's projections have biases.
    pub attention_bias: bool,
    /// Whether the feed-forward layers have biases.
    pub mlp_bias: bool,
    /// Positions that a token sees, its own among them (`sliding_window`); none for all.
    pub window: Option<usize>,
}

/// Rotary position embedding: base and scaling of its frequencies.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Rope {
    /// Base of the frequencies.
    pub theta: f64,
    /// How they are stretched for contexts longer than trained.
    pub scaling: RopeScaling,
}

/// Frequency scaling of rotary embeddings (`rope_type`).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum RopeScaling {
    /// `default`: none.
    None,
    /// `linear`: all frequencies divided by the factor.
    Linear {
        /// The factor.
        factor: f64,
    },
    /// `llama3`: low frequencies divided by the factor, high ones kept, smooth between.
    Llama3 {
        /// The factor.
        factor: f64,
        /// Wavelengths above `original_context / low_freq_factor` are scaled fully.
        low_freq_factor: f64,
        /// Wavelengths below `original_context / high_freq_factor` are kept.
        high_freq_factor: f64,
        /// Context that the model was trained with first.
        original_context: f64,
    },
}

/// Longest context, positions: bounds the table of rotary angles.
const MAX_CONTEXT: usize = 1 << 20;

/// What a decoder's kind takes for absent keys.
struct Defaults {
    intermediate: usize,
    /// None for as many as query heads.
    kv_heads: Option<usize>,
    context: usize,
    /// None if the kind has no window at all.
    window: Option<usize>,
    rms_norm_eps: f64,
}

/// Defaults of `LlamaConfig`.
const LLAMA: Defaults =
    Defaults { intermediate: 11_008, kv_heads: None, context: 2048, window: None, rms_norm_eps: 1e-6 };

/// Defaults of `CogVLMConfig`.
const COGVLM: Defaults = Defaults { rms_norm_eps: 1e-5, ..LLAMA };

/// Defaults of `MistralConfig`.
const MISTRAL: Defaults =
    Defaults { intermediate: 14_336, kv_heads: Some(8), context: 131_072, window: Some(4096), rms_norm_eps: 1e-6 };

impl Defaults {
    /// Reads `sliding_window`, whose null says that there is no window.
    fn window(&self, section: &Section<'_>) -> Result<Option<usize>, MllmError> {
        const KEY: &str = "sliding_window";
        match self.window {
            Some(default) if !section.is_null(KEY) => section.count(KEY, default).map(Some),
            _ => Ok(None),
        }
    }
}

impl LlamaConfig {
    /// Reads the section.
    ///
    /// # Errors
    /// When a key has the wrong type or range, is unsupported, or contradicts another.
    pub(crate) fn from_section(section: &Section<'_>) -> Result<Self, MllmError> {
        let default = match section.text("model_type")? {
            None | Some("llama") => &LLAMA,
            Some("mistral") => &MISTRAL,
            Some(other) => {
                return Err(
                    section.error("model_type", format!("decoder {other:?} is not supported; llama and mistral are"))
                );
            }
        };
        Self::read(section, default)
    }

    /// Reads the decoder's keys of a `CogVLMConfig`, which stand beside all others.
    ///
    /// # Errors
    /// As [`Self::from_section`].
    pub(crate) fn from_cogvlm_section(section: &Section<'_>) -> Result<Self, MllmError> {
        Self::read(section, &COGVLM)
    }

    fn read(section: &Section<'_>, default: &Defaults) -> Result<Self, MllmError> {
        if Activation::from_section(section, "hidden_act", Activation::Silu)? != Activation::Silu {
            return Err(section.error("hidden_act", "only silu is supported".into()));
        }
        let hidden = section.count("hidden_size", 4096)?;
        let heads = section.count("num_attention_heads", 32)?;
        let kv_heads = section.count("num_key_value_heads", default.kv_heads.unwrap_or(heads))?;
        if !hidden.is_multiple_of(heads) {
            return Err(section.error("hidden_size", format!("{hidden} is no multiple of {heads} attention heads")));
        }
        if !heads.is_multiple_of(kv_heads) {
            return Err(
                section.error("num_key_value_heads", format!("{kv_heads} does not divide {heads} attention heads"))
            );
        }
        let head_dim = section.count("head_dim", hidden / heads)?;
        if !head_dim.is_multiple_of(2) {
            return Err(section.error("head_dim", format!("{head_dim} is odd, rotary embeddings need pairs")));
        }
        let context = section.count("max_position_embeddings", default.context)?;
        if context > MAX_CONTEXT {
            return Err(section.error("max_position_embeddings", format!("at most {MAX_CONTEXT}")));
        }
        Ok(Self {
            vocabulary: section.count("vocab_size", 32_000)?,
            hidden,
            intermediate: section.count("intermediate_size", default.intermediate)?,
            layers: section.count("num_hidden_layers", 32)?,
            heads,
            kv_heads,
            head_dim,
            context,
            rms_norm_eps: section.positive("rms_norm_eps", default.rms_norm_eps)?,
            rope: Rope::from_section(section)?,
            attention_bias: section.flag("attention_bias", false)?,
            mlp_bias: section.flag("mlp_bias", false)?,
            window: default.window(section)?,
        })
    }
}

impl Rope {
    /// Reads `rope_parameters` (transformers 5), or `rope_theta` with `rope_scaling` (before).
    fn from_section(text: &Section<'_>) -> Result<Self, MllmError> {
        let theta = text.positive("rope_theta", 10_000.0)?;
        let section = match text.section("rope_parameters", "text_config.rope_parameters.")? {
            Some(section) => Some(section),
            None => text.section("rope_scaling", "text_config.rope_scaling.")?,
        };
        let Some(section) = section else {
            return Ok(Self { theta, scaling: RopeScaling::None });
        };
        let theta = section.positive("rope_theta", theta)?;
        let kind = match section.text("rope_type")? {
            Some(kind) => Some(kind),
            None => section.text("type")?,
        };
        let required = |key: &str| match section.get(key) {
            Some(_) => section.positive(key, 1.0),
            None => Err(section.error(key, "is missing for this rope_type".into())),
        };
        let scaling = match kind {
            None | Some("default") => RopeScaling::None,
            Some("linear") => RopeScaling::Linear { factor: required("factor")? },
            Some("llama3") => RopeScaling::Llama3 {
                factor: required("factor")?,
                low_freq_factor: required("low_freq_factor")?,
                high_freq_factor: required("high_freq_factor")?,
                original_context: required("original_max_position_embeddings")?,
            },
            Some(other) => {
                return Err(
                    section.error("rope_type", format!("{other:?} is not supported; default, linear and llama3 are"))
                );
            }
        };
        Ok(Self { theta, scaling })
    }
}
