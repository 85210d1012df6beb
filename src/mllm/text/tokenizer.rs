//! Text to token ids and back, from a model's `tokenizer.json`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde_json::Value;
use tokenizers::Tokenizer;

use super::token_bytes::token_bytes;
use crate::mllm::MllmError;
use crate::mllm::checkpoint::{ModelFiles, Section};

/// The tokenizer of a model, with the special tokens that its chat template may name.
#[derive(Debug, Clone)]
pub struct ChatTokenizer {
    tokenizer: Arc<Tokenizer>,
    path: PathBuf,
    special: BTreeMap<String, String>,
    bytes: Arc<Vec<Vec<u8>>>,
}

/// Keys of `tokenizer_config.json` that name a special token.
const SPECIAL_TOKENS: [&str; 4] = ["bos_token", "eos_token", "unk_token", "pad_token"];

impl ChatTokenizer {
    /// Opens `tokenizer.json`, and `tokenizer_config.json` if it is there, for a model of `vocabulary` token ids, outside of
    /// which only the placeholder of an image may lie.
    ///
    /// # Errors
    /// When the file is missing or broken, or makes ids outside of the vocabulary.
    pub(crate) fn open(files: &ModelFiles, vocabulary: usize, image_token: u32) -> Result<Self, MllmError> {
        let json = files.required_json("tokenizer.json")?;
        let path = files.path("tokenizer.json");
        let broken = |problem: String| MllmError::Tokenizer { path: path.clone(), problem };
        let mut tokenizer: Tokenizer =
            serde_json::from_value(json.clone()).map_err(|error| broken(error.to_string()))?;
        // A fixed length for batches, which some files carry, would cut or pad prompts.
        tokenizer.with_padding(None);
        tokenizer.with_truncation(None).map_err(|error| broken(error.to_string()))?;
        let outside = tokenizer
            .get_vocab(true)
            .into_iter()
            .map(|(token, id)| (id, token))
            .filter(|(id, _)| *id as usize >= vocabulary && *id != image_token)
            .min();
        if let Some((id, token)) = outside {
            return Err(MllmError::Vocabulary { token, id, vocabulary });
        }
        let bytes = token_bytes(&json, &tokenizer, vocabulary).map_err(broken)?;
        Ok(Self { special: special_tokens(files)?, tokenizer: Arc::new(tokenizer), path, bytes: Arc::new(bytes) })
    }

    /// The file, for messages.
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// Special tokens by role (`bos_token`, `eos_token`, ...).
    pub(crate) fn special(&self) -> &BTreeMap<String, String> {
        &self.special
    }

    /// The underlying tokenizer, made to take the names of special tokens for text.
    pub(crate) fn for_plain_text(&self) -> Tokenizer {
        let mut tokenizer = (*self.tokenizer).clone();
        tokenizer.set_encode_special_tokens(true);
        tokenizer
    }

    /// What each token id stands for in an answer; see [`token_bytes`].
    pub(crate) fn bytes(&self) -> &[Vec<u8>] {
        &self.bytes
    }

    /// The id of a token.
    pub(crate) fn id(&self, token: &str) -> Option<u32> {
        self.tokenizer.token_to_id(token)
    }

    /// The token of an id.
    pub(crate) fn token(&self, id: u32) -> Option<String> {
        self.tokenizer.id_to_token(id)
    }

    /// Ids of a rendered chat. As in transformers, the tokenizer adds its own special tokens only if the chat template
    /// has not begun with the beginning-of-sequence token itself.
    ///
    /// # Errors
    /// When the tokenizer refuses the text.
    pub(crate) fn encode_chat(&self, rendered: &str) -> Result<Vec<u32>, MllmError> {
        let begun = self.special.get("bos_token").is_some_and(|bos| rendered.starts_with(bos.as_str()));
        self.tokenizer
            .encode_fast(rendered, !begun)
            .map(|encoding| encoding.get_ids().to_vec())
            .map_err(|error| self.error(error.to_string()))
    }

    /// Ids of a text, without special tokens around it.
    ///
    /// # Errors
    /// When the tokenizer refuses the text.
    pub(crate) fn encode_text(&self, text: &str) -> Result<Vec<u32>, MllmError> {
        self.tokenizer
            .encode_fast(text, false)
            .map(|encoding| encoding.get_ids().to_vec())
            .map_err(|error| self.error(error.to_string()))
    }

    /// Text of an answer, without special tokens.
    ///
    /// # Errors
    /// When the tokenizer cannot decode the ids.
    pub(crate) fn decode(&self, ids: &[u32]) -> Result<String, MllmError> {
        self.tokenizer.decode(ids, true).map_err(|error| self.error(error.to_string()))
    }

    /// Text of an answer, each token's bytes one after another; unlike [`Self::decode`] it keeps a leading space that the
    /// tokenizer takes for its own.
    pub(crate) fn decode_verbatim(&self, ids: &[u32]) -> String {
        let bytes: Vec<u8> = ids
            .iter()
            .filter_map(|id| self.bytes.get(*id as usize))
            .filter(|bytes| bytes.first() != Some(&toktrie::TokTrie::SPECIAL_TOKEN_MARKER))
            .flatten()
            .copied()
            .collect();
        String::from_utf8_lossy(&bytes).into_owned()
    }

    fn error(&self, problem: String) -> MllmError {
        MllmError::Tokenizer { path: self.path.clone(), problem }
    }
}

/// Reads the special tokens of `tokenizer_config.json` by role, each a text or an object with its `content`.
///
/// # Errors
/// When the file is broken.
pub(crate) fn special_tokens(files: &ModelFiles) -> Result<BTreeMap<String, String>, MllmError> {
    const NAME: &str = "tokenizer_config.json";
    let mut special = BTreeMap::new();
    let Some(value) = files.json(NAME)? else {
        return Ok(special);
    };
    let path = files.path(NAME);
    let root = Section::root(&path, &value)?;
    for key in SPECIAL_TOKENS {
        let text = match root.get(key) {
            None => continue,
            Some(Value::String(text)) => Some(text),
            Some(Value::Object(token)) => match token.get("content") {
                Some(Value::String(text)) => Some(text),
                _ => None,
            },
            Some(_) => None,
        };
        let text =
            text.ok_or_else(|| root.error(key, "expected a text, or an object with a text as content".into()))?;
        special.insert(key.to_string(), text.clone());
    }
    Ok(special)
}
