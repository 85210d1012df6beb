//! The shapes of known models, for random weights in their place.

use std::collections::BTreeMap;
use std::path::Path;

use serde_json::{Map, Value, json};

use crate::mllm::checkpoint::ModelFiles;
use crate::mllm::{Architecture, MllmError};

/// A published model's configuration without its weights. What it computes is meaningless; what it costs is not.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ModelShape {
    /// The name that it is asked for by: that of its description in `models/`, where it has one.
    pub name: &'static str,
    /// Where the configuration is from.
    pub origin: &'static str,
    /// The keys of its `config.json` that differ from its family's defaults.
    config: &'static str,
    /// Its `preprocessor_config.json`.
    preprocessor: &'static str,
}

/// CLIP's preprocessor at 336 pixels.
const CLIP_336: &str = r#"{"image_processor_type": "CLIPImageProcessor", "size": {"shortest_edge": 336},
    "crop_size": {"height": 336, "width": 336}}"#;
/// LLaVA-NeXT's with tiles of 336 pixels.
const TILES_336: &str = r#"{"image_processor_type": "LlavaNextImageProcessor", "size": {"shortest_edge": 336},
    "crop_size": {"height": 336, "width": 336}}"#;

impl ModelShape {
    /// All of them.
    pub const ALL: [Self; 8] = [
        Self {
            name: "nano",
            origin: "models/nano/config.json",
            config: include_str!("../../../models/nano/config.json"),
            preprocessor: include_str!("../../../models/nano/preprocessor_config.json"),
        },
        Self {
            name: "llava-1.1b",
            origin: "the decoder of TinyLlama/TinyLlama-1.1B-Chat-v1.0 behind the vision tower of LLaVA 1.5; the context \
                     is widened from 2048 to 4096, which costs no weights",
            config: r#"{"model_type": "llava", "image_token_index": 32000, "text_config": {"hidden_size": 2048, "intermediate_size": 5632,
                "num_hidden_layers": 22, "num_attention_heads": 32, "num_key_value_heads": 4, "vocab_size": 32064,
                "max_position_embeddings": 4096, "rms_norm_eps": 1e-5}}"#,
            preprocessor: CLIP_336,
        },
        Self {
            name: "llava-1.5-7b",
            origin: "llava-hf/llava-1.5-7b-hf",
            config: r#"{"model_type": "llava", "image_token_index": 32000, "text_config": {"vocab_size": 32064,
                "max_position_embeddings": 4096, "rms_norm_eps": 1e-5}}"#,
            preprocessor: CLIP_336,
        },
        Self {
            name: "llava-1.5-13b",
            origin: "llava-hf/llava-1.5-13b-hf",
            config: r#"{"model_type": "llava", "image_token_index": 32000, "text_config": {"hidden_size": 5120, "intermediate_size": 13824,
                "num_hidden_layers": 40, "num_attention_heads": 40, "num_key_value_heads": 40, "vocab_size": 32064,
                "max_position_embeddings": 4096, "rms_norm_eps": 1e-5}}"#,
            preprocessor: CLIP_336,
        },
        Self {
            name: "llava-v1.6-vicuna-7b",
            origin: "llava-hf/llava-v1.6-vicuna-7b-hf",
            config: r#"{"model_type": "llava_next", "image_token_index": 32000, "text_config": {"vocab_size": 32064,
                "max_position_embeddings": 4096, "rms_norm_eps": 1e-5}}"#,
            preprocessor: TILES_336,
        },
        Self {
            name: "llava-v1.6-mistral-7b",
            origin: "llava-hf/llava-v1.6-mistral-7b-hf",
            config: r#"{"model_type": "llava_next", "image_token_index": 32000, "text_config": {"model_type": "mistral", "vocab_size": 32064,
                "intermediate_size": 14336, "num_key_value_heads": 8, "max_position_embeddings": 32768,
                "rms_norm_eps": 1e-5, "rope_theta": 1000000.0, "sliding_window": null}}"#,
            preprocessor: TILES_336,
        },
        Self {
            name: "llava-v1.6-vicuna-13b",
            origin: "llava-hf/llava-v1.6-vicuna-13b-hf",
            config: r#"{"model_type": "llava_next", "image_token_index": 32000, "text_config": {"hidden_size": 5120, "intermediate_size": 13824,
                "num_hidden_layers": 40, "num_attention_heads": 40, "num_key_value_heads": 40, "vocab_size": 32064,
                "max_position_embeddings": 4096, "rms_norm_eps": 1e-5}}"#,
            preprocessor: TILES_336,
        },
        Self {
            name: "cogvlm-chat-17b",
            origin: "THUDM/cogvlm-chat-hf, whose configuration is the family's default",
            config: r#"{"model_type": "cogvlm"}"#,
            // CogVLM's preprocessing is fixed.
            preprocessor: "{}",
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

    /// What stands for the small files of a model of this shape. Its tokenizer knows the bytes, and words of no meaning.
    ///
    /// # Errors
    /// When the configuration is broken.
    pub(crate) fn files(&self) -> Result<ModelFiles, MllmError> {
        let mut texts: BTreeMap<String, String> =
            [("config.json", self.config), ("preprocessor_config.json", self.preprocessor)]
                .map(|(name, text)| (name.to_string(), text.to_string()))
                .into();
        let place = Path::new(self.name);
        let files = ModelFiles::packed(place, texts.clone());
        let vocabulary = Architecture::of(&files)?.decoder(&files)?.vocabulary;
        let config = files.required_json("config.json")?;
        let image = config["image_token_index"].as_u64().map_or(vocabulary, |id| id as usize);
        texts.insert("tokenizer.json".into(), tokenizer(vocabulary, image).to_string());
        texts.insert("tokenizer_config.json".into(), TOKENIZER_CONFIG.into());
        texts.insert("chat_template.jinja".into(), CHAT_TEMPLATE.into());
        Ok(ModelFiles::packed(place, texts))
    }
}

/// The special tokens of [`tokenizer`].
const TOKENIZER_CONFIG: &str = r#"{"bos_token": "<s>", "eos_token": "</s>", "unk_token": "<unk>"}"#;
/// The form of a chat.
const CHAT_TEMPLATE: &str = include_str!("../../../models/nano/chat_template.jinja");

/// A byte-pair tokenizer without merges: special tokens, the bytes, an image, and filling up to `vocabulary` tokens.
fn tokenizer(vocabulary: usize, image: usize) -> Value {
    let token = |id: usize| match id {
        0 => "<unk>".to_string(),
        1 => "<s>".to_string(),
        2 => "</s>".to_string(),
        _ if id == image => "<image>".to_string(),
        byte @ 3..=258 => format!("<0x{:02X}>", byte - 3),
        other => format!("[{other}]"),
    };
    let vocab: Map<String, Value> = (0..vocabulary).map(|id| (token(id), id.into())).collect();
    let added: Vec<Value> = [0, 1, 2, image]
        .map(|id| {
            json!({"id": id, "content": token(id), "special": true, "single_word": false, "lstrip": false,
                "rstrip": false, "normalized": false})
        })
        .into();
    json!({
        "version": "1.0", "truncation": null, "padding": null, "added_tokens": added, "normalizer": null,
        "pre_tokenizer": null, "post_processor": null, "decoder": {"type": "ByteFallback"},
        "model": {"type": "BPE", "dropout": null, "unk_token": "<unk>", "continuing_subword_prefix": null,
            "end_of_word_suffix": null, "fuse_unk": false, "byte_fallback": true, "vocab": vocab, "merges": []},
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mllm::checkpoint::Checkpoint;
    use crate::mllm::matrix::WeightFormat;

    /// Billions of weights by the sizes of decoders and towers that their papers and model cards give; the tower's last
    /// layer, which LLaVA leaves unused, is not among them.
    #[test]
    fn shapes_have_the_weights_that_their_names_say() {
        for (name, billions) in [
            ("nano", 0.004_02),
            ("llava-1.1b", 1.41),
            ("llava-1.5-7b", 7.06),
            ("llava-1.5-13b", 13.35),
            ("llava-v1.6-vicuna-7b", 7.06),
            ("llava-v1.6-mistral-7b", 7.57),
            ("llava-v1.6-vicuna-13b", 13.35),
            ("cogvlm-chat-17b", 17.64),
        ] {
            let shape = ModelShape::find(name).unwrap();
            let checkpoint = Checkpoint::random(shape.files().unwrap(), WeightFormat::Q4K, 0).unwrap();
            let found = checkpoint.weights.elements() as f64 / 1e9;
            assert!((found / billions - 1.0).abs() < 0.01, "{name}: {found}");
        }
        assert!(ModelShape::find("llava").unwrap_err().to_string().contains("llava-1.5-7b"));
    }
}
