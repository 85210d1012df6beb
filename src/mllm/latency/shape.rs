//! The shapes of known models, for random weights in their place.

use std::path::Path;

use serde_json::Value;

use crate::mllm::checkpoint::Weights;
use crate::mllm::cogvlm::CogVlm;
use crate::mllm::llava::Llava;
use crate::mllm::llava_next::LlavaNext;
use crate::mllm::local::VisionLanguageModel;
use crate::mllm::{Architecture, MllmError, Storage};

/// A published model's configuration without its weights. What it computes is meaningless; what it costs is not.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ModelShape {
    /// The name that it is asked for by: that of its description in `models/`, where it has one.
    pub name: &'static str,
    /// Its family.
    pub architecture: Architecture,
    /// Where the configuration is from.
    pub origin: &'static str,
    /// The keys of its `config.json` that differ from its family's defaults.
    config: &'static str,
}

impl ModelShape {
    /// All of them.
    pub const ALL: [Self; 8] = [
        Self {
            name: "nano",
            architecture: Architecture::Llava,
            origin: "models/nano/config.json",
            config: include_str!("../../../models/nano/config.json"),
        },
        Self {
            name: "llava-1.1b",
            architecture: Architecture::Llava,
            origin: "the decoder of TinyLlama/TinyLlama-1.1B-Chat-v1.0 behind the vision tower of LLaVA 1.5; the context \
                     is widened from 2048 to 4096, which costs no weights",
            config: r#"{"image_token_index": 32000, "text_config": {"hidden_size": 2048, "intermediate_size": 5632,
                "num_hidden_layers": 22, "num_attention_heads": 32, "num_key_value_heads": 4, "vocab_size": 32064,
                "max_position_embeddings": 4096, "rms_norm_eps": 1e-5}}"#,
        },
        Self {
            name: "llava-1.5-7b",
            architecture: Architecture::Llava,
            origin: "llava-hf/llava-1.5-7b-hf",
            config: r#"{"image_token_index": 32000, "text_config": {"vocab_size": 32064,
                "max_position_embeddings": 4096, "rms_norm_eps": 1e-5}}"#,
        },
        Self {
            name: "llava-1.5-13b",
            architecture: Architecture::Llava,
            origin: "llava-hf/llava-1.5-13b-hf",
            config: r#"{"image_token_index": 32000, "text_config": {"hidden_size": 5120, "intermediate_size": 13824,
                "num_hidden_layers": 40, "num_attention_heads": 40, "num_key_value_heads": 40, "vocab_size": 32064,
                "max_position_embeddings": 4096, "rms_norm_eps": 1e-5}}"#,
        },
        Self {
            name: "llava-v1.6-vicuna-7b",
            architecture: Architecture::LlavaNext,
            origin: "llava-hf/llava-v1.6-vicuna-7b-hf",
            config: r#"{"image_token_index": 32000, "text_config": {"vocab_size": 32064,
                "max_position_embeddings": 4096, "rms_norm_eps": 1e-5}}"#,
        },
        Self {
            name: "llava-v1.6-mistral-7b",
            architecture: Architecture::LlavaNext,
            origin: "llava-hf/llava-v1.6-mistral-7b-hf",
            config: r#"{"image_token_index": 32000, "text_config": {"model_type": "mistral", "vocab_size": 32064,
                "intermediate_size": 14336, "num_key_value_heads": 8, "max_position_embeddings": 32768,
                "rms_norm_eps": 1e-5, "rope_theta": 1000000.0, "sliding_window": null}}"#,
        },
        Self {
            name: "llava-v1.6-vicuna-13b",
            architecture: Architecture::LlavaNext,
            origin: "llava-hf/llava-v1.6-vicuna-13b-hf",
            config: r#"{"image_token_index": 32000, "text_config": {"hidden_size": 5120, "intermediate_size": 13824,
                "num_hidden_layers": 40, "num_attention_heads": 40, "num_key_value_heads": 40, "vocab_size": 32064,
                "max_position_embeddings": 4096, "rms_norm_eps": 1e-5}}"#,
        },
        Self {
            name: "cogvlm-chat-17b",
            architecture: Architecture::CogVlm,
            origin: "THUDM/cogvlm-chat-hf, whose configuration is the family's default",
            config: "{}",
        },
    ];

    /// The shape of this name.
    ///
    /// # Errors
    /// When there is none; the error lists all.
    pub fn find(name: &str) -> Result<&'static Self, MllmError> {
        Self::ALL.iter().find(|shape| shape.name == name).ok_or_else(|| MllmError::UnknownShape {
            name: name.to_string(),
            known: Self::ALL.map(|shape| shape.name).join(", "),
        })
    }

    /// A model of this shape with random weights.
    ///
    /// # Errors
    /// When a matrix cannot be made.
    pub(super) fn random(&self, storage: Storage, seed: u64) -> Result<Box<dyn VisionLanguageModel>, MllmError> {
        let path = Path::new(self.name);
        let config: Value =
            serde_json::from_str(self.config).map_err(|source| MllmError::Json { path: path.to_path_buf(), source })?;
        let weights = &mut Weights::random(storage, seed);
        Ok(match self.architecture {
            Architecture::Llava => Box::new(Llava::with_weights(path, &config, weights)?),
            Architecture::LlavaNext => Box::new(LlavaNext::with_weights(path, &config, weights)?),
            Architecture::CogVlm => Box::new(CogVlm::with_weights(path, &config, weights)?),
        })
    }
}
