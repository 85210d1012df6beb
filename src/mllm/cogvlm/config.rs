//! `config.json` of a `CogVLMForCausalLM` checkpoint, first version (such as
//! `THUDM/cogvlm-chat-hf`).

use crate::MllmError;
use crate::checkpoint::{ConfigObject, DecoderType, LlamaConfig, ModelFiles, VisionConfig};
use serde::Deserialize;
use serde_json::{Value, json};
use std::path::Path;

#[derive(Debug, Clone, PartialEq)]
pub(crate) struct CogVlmConfig {
    /// The EVA2-CLIP vision tower.
    pub vision: VisionConfig,
    /// The decoder, as wide and deep as each of its two experts.
    pub text: LlamaConfig,
    pub bos: u32,
    pub style: AnswerStyle,
}

/// What a question ends with (`template_version`).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
pub(crate) enum AnswerStyle {
    /// `Answer:`.
    #[default]
    #[serde(rename = "chat")]
    Chat,
    /// `Short answer:`.
    #[serde(rename = "vqa")]
    Short,
}

impl CogVlmConfig {
    pub(crate) fn open(files: &ModelFiles) -> Result<Self, MllmError> {
        Self::from_json(
            &files.path("config.json"),
            &files.required_json("config.json")?,
        )
    }

    /// Reads a configuration; `path` is for messages. Absent keys take the defaults of
    /// `CogVLMConfig` in the repository of `cogvlm-chat-hf`, which are Llama's: `rms_norm_eps` is
    /// 1e-6 there, though the configuration of that model says 1e-5. Its towers say all keys.
    pub(crate) fn from_json(path: &Path, value: &Value) -> Result<Self, MllmError> {
        let root = ConfigObject::root(path, value)?;
        if root.contains("num_multi_query_heads") {
            return Err(root.error(
                "num_multi_query_heads",
                "this is CogVLM2, another architecture; the first version is supported",
            ));
        }
        // The decoder's keys stand beside all others.
        let text = LlamaConfig::read_as(root.clone(), DecoderType::Llama)?;
        let bos = root.first_id("bos_token_id")?.unwrap_or(1);
        if bos as usize >= text.vocabulary {
            return Err(root.error(
                "bos_token_id",
                format!("{bos} lies outside the vocabulary of {}", text.vocabulary),
            ));
        }
        Ok(Self {
            vision: tower(&root)?,
            text,
            bos,
            style: root.value("template_version")?.unwrap_or_default(),
        })
    }

    /// Tokens that an image becomes: its patches between a beginning and an end.
    pub(crate) fn image_tokens(&self) -> usize {
        self.vision.patches() + 2
    }
}

/// Reads the `vision_config`, an EVA2-CLIP tower.
fn tower(root: &ConfigObject<'_>) -> Result<VisionConfig, MllmError> {
    let vision = root.child_or_empty("vision_config")?.with_defaults(json!({
        "hidden_size": 1792, "intermediate_size": 15_360, "num_hidden_layers": 63, "num_heads": 16, "image_size": 490,
        "patch_size": 14, "hidden_act": "gelu", "layer_norm_eps": 1e-6,
    }));
    let config = VisionConfig::read(&vision)?;
    let (patches, positions) = (config.patches(), config.patches() + 1);
    match vision.value::<usize>("num_positions")? {
        Some(named) if named != positions => Err(vision.error(
            "num_positions",
            format!("{named}, but {patches} patches and a class token make {positions}"),
        )),
        _ => Ok(config),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(value: &Value) -> Result<CogVlmConfig, MllmError> {
        CogVlmConfig::from_json(Path::new("config.json"), value)
    }

    #[test]
    fn the_configuration_of_cogvlm_chat_is_read() {
        let config = parse(&json!({
            "architectures": ["CogVLMForCausalLM"], "bos_token_id": 1, "eos_token_id": 2, "hidden_act": "silu",
            "hidden_size": 4096, "intermediate_size": 11008, "max_position_embeddings": 2048,
            "num_attention_heads": 32, "num_hidden_layers": 32, "pad_token_id": 0, "rms_norm_eps": 1e-05,
            "template_version": "chat", "tie_word_embeddings": false, "vocab_size": 32000,
            "vision_config": {"dropout_prob": 0.0, "hidden_act": "gelu", "in_channels": 3, "num_hidden_layers": 63,
                "hidden_size": 1792, "patch_size": 14, "num_heads": 16, "intermediate_size": 15360,
                "layer_norm_eps": 1e-06, "num_positions": 1226, "image_size": 490},
        }))
        .unwrap();
        assert_eq!(
            (
                config.image_tokens(),
                config.text.context,
                config.text.head_dim
            ),
            (1227, 2048, 128)
        );
        assert_eq!((config.bos, config.style), (1, AnswerStyle::Chat));
        // The defaults are this model's, but for one.
        assert_eq!(parse(&json!({"rms_norm_eps": 1e-5})).unwrap(), config);
        assert!((parse(&json!({})).unwrap().text.rms_norm_eps - 1e-6).abs() < f64::EPSILON);
    }

    #[test]
    fn other_kinds_are_refused_by_name() {
        for (key, value) in [
            ("num_multi_query_heads", json!({"num_multi_query_heads": 8})),
            ("template_version", json!({"template_version": "base"})),
            ("bos_token_id", json!({"bos_token_id": 32_000})),
            (
                "vision_config.num_positions",
                json!({"vision_config": {"image_size": 224}, "num_positions": 3}),
            ),
            (
                "vision_config.hidden_size",
                json!({"vision_config": {"num_heads": 15}}),
            ),
        ] {
            let mut value = value;
            if key.ends_with("num_positions") {
                value["vision_config"]["num_positions"] = json!(1226);
            }
            match parse(&value) {
                Err(MllmError::Config { key: found, .. }) => assert_eq!(found, key),
                other => panic!("{key}: {other:?}"),
            }
        }
    }
}
