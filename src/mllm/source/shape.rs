//! The shapes of known models, for benchmarks with random weights.

use super::{Checkpoint, DEFAULT_RANDOM_FORMAT, random};
use crate::MllmError;
use crate::checkpoint::ModelFiles;
use crate::families::Families;
use crate::gguf::tokenizer::added_token;
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::path::Path;

/// A published model's configuration without its weights. Its outputs mean nothing, but it takes
/// the same time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ModelShape {
    /// The name in `models/shapes/`: that of its description in `models/`, where it has one.
    pub name: &'static str,
    /// JSON: where the configuration is from (`origin`), and the model's small files by name.
    text: &'static str,
}

/// The shape of a file in `models/shapes/`.
macro_rules! shape {
    ($name:literal) => {
        ModelShape {
            name: $name,
            text: include_str!(concat!("../../../models/shapes/", $name, ".json")),
        }
    };
}

impl ModelShape {
    pub const ALL: [Self; 31] = [
        shape!("nano"),
        shape!("llava-1.1b"),
        shape!("llava-1.5-7b"),
        shape!("llava-1.5-13b"),
        shape!("llava-v1.6-vicuna-7b"),
        shape!("llava-v1.6-mistral-7b"),
        shape!("llava-v1.6-vicuna-13b"),
        shape!("cogvlm-chat-17b"),
        shape!("smolvlm2-256m"),
        shape!("smolvlm2-500m"),
        shape!("smolvlm2-2.2b"),
        shape!("internvl3-1b"),
        shape!("internvl3-2b"),
        shape!("qwen3-vl-2b"),
        shape!("qwen3-vl-4b"),
        shape!("qwen2.5-vl-3b"),
        shape!("qwen2.5-vl-7b"),
        shape!("qwen2-vl-2b"),
        shape!("qwen2-vl-7b"),
        shape!("llava-onevision-0.5b"),
        shape!("llava-onevision-7b"),
        shape!("gemma-3-4b"),
        shape!("gemma-3n-e2b"),
        shape!("gemma-4-e2b"),
        shape!("gemma-4-e4b"),
        shape!("lfm2-vl-450m"),
        shape!("lfm2.5-vl-450m"),
        shape!("lfm2.5-vl-1.6b"),
        shape!("qwen3.5-0.8b"),
        shape!("qwen3.5-2b"),
        shape!("qwen3.5-4b"),
    ];

    pub fn find(name: &str) -> Result<&'static Self, MllmError> {
        Self::ALL
            .iter()
            .find(|shape| shape.name == name)
            .ok_or_else(|| MllmError::UnknownShape {
                name: name.to_string(),
                known: Self::ALL.map(|shape| shape.name).join(", "),
            })
    }

    /// The shape of a repository of the hub.
    pub(crate) fn of_hub(id: &str) -> Option<&'static Self> {
        let origin = |shape: &Self| {
            shape
                .texts()
                .ok()?
                .remove(ORIGIN)?
                .as_str()
                .map(str::to_owned)
        };
        // A comma and a remark may follow the id.
        Self::ALL
            .iter()
            .find(|shape| origin(shape).is_some_and(|origin| origin.split(',').next() == Some(id)))
    }

    /// The headers of a model of this shape in f16, without a tokenizer.
    pub(crate) fn checkpoint(&self, families: &Families) -> Result<Checkpoint, MllmError> {
        let texts = self
            .texts()?
            .into_iter()
            .map(|(name, value)| (name, value.to_string()));
        let files = ModelFiles::packed(Path::new(self.name), texts.collect());
        random::checkpoint(files, DEFAULT_RANDOM_FORMAT, 0, families)
    }

    fn texts(&self) -> Result<BTreeMap<String, Value>, MllmError> {
        serde_json::from_str(self.text).map_err(|source| MllmError::Json {
            path: self.name.into(),
            source,
        })
    }

    /// The small files of a model of this shape. Its tokenizer has a token for each byte, and fills
    /// up the vocabulary.
    pub(super) fn files(&self, families: &Families) -> Result<ModelFiles, MllmError> {
        let place = Path::new(self.name);
        let mut texts: BTreeMap<String, String> = self
            .texts()?
            .into_iter()
            .map(|(name, value)| (name, value.to_string()))
            .collect();
        let files = ModelFiles::packed(place, texts.clone());
        let vocabulary = (families.detect_in(&files)?.family().decoder_config)(&files)?.vocabulary;
        let config = files.required_json("config.json")?;
        let image = config["image_token_index"]
            .as_u64()
            .or(config["image_token_id"].as_u64());
        let image = image.map_or(vocabulary, |id| id as usize);
        texts.insert(
            "tokenizer.json".into(),
            tokenizer(vocabulary, image).to_string(),
        );
        texts.insert("tokenizer_config.json".into(), TOKENIZER_CONFIG.into());
        texts.insert("chat_template.jinja".into(), CHAT_TEMPLATE.into());
        Ok(ModelFiles::packed(place, texts))
    }
}

/// Where a configuration is from, among the texts of a shape.
const ORIGIN: &str = "origin";

/// The special tokens of [`tokenizer`].
const TOKENIZER_CONFIG: &str = r#"{"bos_token": "<s>", "eos_token": "</s>", "unk_token": "<unk>"}"#;
const CHAT_TEMPLATE: &str = include_str!("../../../models/nano/chat_template.jinja");

/// A byte-pair tokenizer without merges: special tokens, the bytes, an image, and filling up to
/// `vocabulary` tokens.
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
    let added = [0, 1, 2, image].map(|id| added_token(id as u64, &token(id), true));
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
    use crate::source::ModelPlace;
    use planagent_kernels::matrix::WeightFormat;

    /// Billions of weights by the sizes of decoders and towers that their papers and model cards
    /// give; the tower's last layer, which LLaVA leaves unused, is not among them.
    #[test]
    fn shapes_have_the_weights_that_their_names_say() {
        for (name, billions) in [
            ("nano", 0.004_08),
            ("llava-1.1b", 1.41),
            ("llava-1.5-7b", 7.06),
            ("llava-1.5-13b", 13.35),
            ("llava-v1.6-vicuna-7b", 7.06),
            ("llava-v1.6-mistral-7b", 7.57),
            ("llava-v1.6-vicuna-13b", 13.35),
            ("cogvlm-chat-17b", 17.64),
            ("smolvlm2-256m", 0.256_5),
            ("smolvlm2-500m", 0.507_5),
            ("smolvlm2-2.2b", 2.247),
            ("internvl3-1b", 0.938_2),
            ("internvl3-2b", 2.089),
            ("qwen3-vl-2b", 2.127_5),
            ("qwen3-vl-4b", 4.438),
            ("qwen2.5-vl-3b", 3.755),
            ("qwen2.5-vl-7b", 8.292),
            ("qwen2-vl-2b", 2.209),
            ("qwen2-vl-7b", 8.291),
            ("llava-onevision-0.5b", 0.894),
            ("llava-onevision-7b", 8.03),
            ("gemma-3-4b", 4.297),
            ("gemma-3n-e2b", 4.77),
            ("gemma-4-e2b", 4.797),
            ("gemma-4-e4b", 7.627),
            ("lfm2-vl-450m", 0.450_8),
            ("lfm2.5-vl-450m", 0.448_7),
            ("lfm2.5-vl-1.6b", 1.597),
            ("qwen3.5-0.8b", 0.853),
            ("qwen3.5-2b", 2.213),
            ("qwen3.5-4b", 4.539),
        ] {
            let shape = ModelShape::find(name).unwrap();
            let place = ModelPlace::Random { shape, seed: 0 };
            let checkpoint =
                Checkpoint::open(&place, Some(WeightFormat::Q4K), &Families::default()).unwrap();
            let found = checkpoint.weights.elements() as f64 / 1e9;
            assert!((found / billions - 1.0).abs() < 0.01, "{name}: {found}");
        }
        assert!(
            ModelShape::find("llava")
                .unwrap_err()
                .to_string()
                .contains("llava-1.5-7b")
        );
    }

    #[test]
    fn a_repository_of_the_hub_has_its_shape() {
        let name = |id| ModelShape::of_hub(id).map(|shape| shape.name);
        assert_eq!(name("Qwen/Qwen3-VL-2B-Instruct"), Some("qwen3-vl-2b"));
        assert_eq!(name("THUDM/cogvlm-chat-hf"), Some("cogvlm-chat-17b"));
        assert_eq!(name("Qwen/Qwen3-VL-2B"), None);
    }

    #[test]
    fn the_shape_of_nano_is_that_of_its_files() {
        let files = ModelShape::find("nano")
            .unwrap()
            .files(&Families::default())
            .unwrap();
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models/nano");
        for name in ["config.json", "preprocessor_config.json"] {
            assert_eq!(
                files.json(name).unwrap(),
                ModelFiles::folder(&folder).unwrap().json(name).unwrap(),
                "{name}"
            );
        }
    }
}
