//! The classes of decoders, and what their keys mean where a file leaves them out.

use super::neutral::Neutral;
use serde::Deserialize;
use serde_json::{Value, json};

/// Which decoder a `text_config` describes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum DecoderType {
    /// `LlamaConfig`.
    Llama,
    /// `MistralConfig`: all layers have a window.
    Mistral,
    /// `Qwen2Config`: queries, keys and values have biases.
    Qwen2,
    /// `Qwen2_5_VLTextConfig` and `Qwen2VLTextConfig`, which have the same keys and defaults: a Qwen
    /// 2 with positions on three axes.
    #[serde(rename = "qwen2_5_vl_text", alias = "qwen2_vl_text")]
    Qwen25Vl,
    /// `Qwen3Config`: queries and keys have norms.
    Qwen3,
    /// `Qwen3VLTextConfig`: a Qwen 3 with positions on three axes that take turns.
    #[serde(rename = "qwen3_vl_text")]
    Qwen3Vl,
    /// `Gemma3TextConfig`: most layers have a window, and all more norms.
    #[serde(rename = "gemma3_text")]
    Gemma3,
    /// `Gemma3nTextConfig`: layers work on one of several streams of hidden states.
    #[serde(rename = "gemma3n_text")]
    Gemma3n,
    /// `Gemma4TextConfig`: layers also differ in shape, and the last ones share keys and values.
    #[serde(rename = "gemma4_text")]
    Gemma4,
    /// `Lfm2Config`: most layers convolve the last positions in the place of attention.
    Lfm2,
    /// `Qwen3_5TextConfig`: most layers have a gated delta rule in the place of attention.
    #[serde(rename = "qwen3_5_text")]
    Qwen35,
}

impl DecoderType {
    /// The type of an entry of `architectures`, for files whose text part has no `model_type`.
    pub(crate) fn of_architecture(name: &str) -> Option<Self> {
        match name {
            "LlamaForCausalLM" => Some(Self::Llama),
            "MistralForCausalLM" => Some(Self::Mistral),
            "Qwen2ForCausalLM" => Some(Self::Qwen2),
            "Qwen3ForCausalLM" => Some(Self::Qwen3),
            "Gemma3ForCausalLM" => Some(Self::Gemma3),
            "Gemma3nForCausalLM" => Some(Self::Gemma3n),
            "Gemma4ForCausalLM" => Some(Self::Gemma4),
            "Lfm2ForCausalLM" => Some(Self::Lfm2),
            "Qwen3_5ForCausalLM" => Some(Self::Qwen35),
            _ => None,
        }
    }

    /// Where the class differs from `LlamaConfig` in a key that is left out (transformers 5.24.0).
    pub(super) fn defaults(self) -> Value {
        // One match: an arm is a class of transformers, with the values of its configuration class.
        match self {
            Self::Llama => json!({}),
            Self::Mistral => json!({
                "intermediate_size": 14_336, "num_key_value_heads": 8, "max_position_embeddings": 131_072,
                "sliding_window": 4096,
            }),
            Self::Qwen2 => json!({
                "vocab_size": 151_936, "intermediate_size": 22_016, "num_key_value_heads": 32,
                "max_position_embeddings": 32_768, "max_window_layers": 28,
            }),
            Self::Qwen25Vl => json!({
                "vocab_size": 152_064, "hidden_size": 8192, "intermediate_size": 29_568, "num_hidden_layers": 80,
                "num_attention_heads": 64, "num_key_value_heads": 8, "max_position_embeddings": 32_768,
                "rms_norm_eps": 1e-5, "max_window_layers": 80,
            }),
            Self::Qwen3 => json!({
                "vocab_size": 151_936, "intermediate_size": 22_016, "num_key_value_heads": 32, "head_dim": 128,
                "max_position_embeddings": 32_768, "max_window_layers": 28,
            }),
            Self::Qwen3Vl => json!({
                "vocab_size": 151_936, "intermediate_size": 22_016, "num_key_value_heads": 32, "head_dim": 128,
                "max_position_embeddings": 128_000,
            }),
            Self::Gemma3 => json!({
                "vocab_size": 262_208, "hidden_size": 2304, "intermediate_size": 9216, "num_hidden_layers": 26,
                "num_attention_heads": 8, "num_key_value_heads": 4, "head_dim": 256, "max_position_embeddings": 131_072,
                "sliding_window": 4096, "tie_word_embeddings": true, "query_pre_attn_scalar": 256,
            }),
            Self::Gemma3n => json!({
                "vocab_size": 262_400, "hidden_size": 2048, "intermediate_size": 16_384, "num_hidden_layers": 35,
                "num_attention_heads": 8, "num_key_value_heads": 2, "head_dim": 256, "max_position_embeddings": 32_768,
                "sliding_window": 512, "tie_word_embeddings": true, "final_logit_softcapping": 30.0,
            }),
            Self::Gemma4 => json!({
                "vocab_size": 262_144, "hidden_size": 2304, "intermediate_size": 9216, "num_hidden_layers": 30,
                "num_attention_heads": 8, "num_key_value_heads": 4, "head_dim": 256, "max_position_embeddings": 131_072,
                "sliding_window": 512, "tie_word_embeddings": true,
            }),
            Self::Lfm2 => json!({
                "vocab_size": 65_536, "hidden_size": 2560, "intermediate_size": 12_288, "num_key_value_heads": 8,
                "max_position_embeddings": 128_000, "norm_eps": 1e-5, "tie_word_embeddings": true,
            }),
            Self::Qwen35 => json!({
                "vocab_size": 248_320, "intermediate_size": 12_288, "num_attention_heads": 16, "num_key_value_heads": 4,
                "head_dim": 256, "max_position_embeddings": 32_768,
            }),
        }
    }

    /// The base of the rotary embedding (`default_theta` of the class).
    pub(super) fn theta(self) -> f64 {
        match self {
            Self::Llama | Self::Mistral | Self::Qwen2 | Self::Qwen3 | Self::Qwen35 => 10_000.0,
            Self::Qwen25Vl | Self::Gemma3 | Self::Gemma3n | Self::Gemma4 | Self::Lfm2 => {
                1_000_000.0
            }
            Self::Qwen3Vl => 500_000.0,
        }
    }

    /// Pairs of a head for time, height and width (`mrope_section` in the class of the rotary
    /// embedding).
    pub(super) fn sections(self) -> Option<[usize; 3]> {
        match self {
            Self::Llama
            | Self::Mistral
            | Self::Qwen2
            | Self::Qwen3
            | Self::Gemma3
            | Self::Gemma3n
            | Self::Gemma4
            | Self::Lfm2 => None,
            Self::Qwen25Vl => Some([16, 24, 24]),
            Self::Qwen3Vl => Some([24, 20, 20]),
            Self::Qwen35 => Some([11, 11, 10]),
        }
    }

    /// Whether pairs of the three axes take turns.
    pub(super) fn interleaved(self) -> bool {
        matches!(self, Self::Qwen3Vl | Self::Qwen35)
    }

    /// The part of a head that is rotated, where the class rotates a part
    /// (`partial_rotary_factor`).
    pub(super) fn rotated_part(self) -> Option<f64> {
        (self == Self::Qwen35).then_some(0.25)
    }

    pub(super) fn is_qwen2(self) -> bool {
        matches!(self, Self::Qwen2 | Self::Qwen25Vl)
    }

    pub(super) fn is_qwen(self) -> bool {
        self.is_qwen2() || matches!(self, Self::Qwen3 | Self::Qwen3Vl | Self::Qwen35)
    }

    /// Keys of the class that no code reads.
    pub(super) fn neutral(self) -> &'static [(&'static str, Neutral)] {
        const ACT: (&str, Neutral) = ("hidden_act", Neutral::Text(&["silu", "swish"]));
        // Where the class does not rotate a part of a head, others of Llama's kind do.
        const WHOLE: (&str, Neutral) = ("partial_rotary_factor", Neutral::Number(1.0));
        const FULL: (&str, Neutral) = ("layer_types", Neutral::Each("full_attention"));
        const GEMMA: &[(&str, Neutral)] = &[
            ("hidden_activation", Neutral::Text(&["gelu_pytorch_tanh"])),
            WHOLE,
            // No number is neutral: a cap of any size bends what lies below it.
            ("attn_logit_softcapping", Neutral::Text(&[])),
            ("final_logit_softcapping", Neutral::Text(&[])),
            ("use_bidirectional_attention", Neutral::Flag(false)),
        ];
        const GEMMA4: &[(&str, Neutral)] = &[
            ("hidden_activation", Neutral::Text(&["gelu_pytorch_tanh"])),
            WHOLE,
            ("enable_moe_block", Neutral::Flag(false)),
        ];
        const GEMMA3N: &[(&str, Neutral)] = &[
            ("hidden_activation", Neutral::Text(&["gelu_pytorch_tanh"])),
            WHOLE,
        ];
        if self == Self::Gemma3 {
            GEMMA
        } else if self == Self::Gemma3n {
            GEMMA3N
        } else if self == Self::Gemma4 {
            GEMMA4
        } else if self == Self::Lfm2 {
            // The activation is no key of the class.
            &[WHOLE]
        } else if self == Self::Qwen35 {
            &[ACT]
        } else if self.is_qwen() {
            &[ACT, WHOLE, FULL]
        } else {
            &[ACT, WHOLE]
        }
    }
}
