//! Conversion of text to token ids and back, by a model's `tokenizer.json`.

use super::token_bytes::token_bytes;
use crate::MllmError;
use crate::checkpoint::{ConfigObject, ModelFiles};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tokenizers::Tokenizer;

/// The tokenizer of a model with the special tokens of its chat template.
#[derive(Debug, Clone)]
pub struct ChatTokenizer {
    tokenizer: Arc<Tokenizer>,
    path: PathBuf,
    special: BTreeMap<String, String>,
    bytes: Arc<Vec<Vec<u8>>>,
}

/// Keys of special tokens in `tokenizer_config.json`.
const SPECIAL_TOKENS: [&str; 4] = ["bos_token", "eos_token", "unk_token", "pad_token"];

impl ChatTokenizer {
    /// Opens `tokenizer.json`, and `tokenizer_config.json` if it exists, for a model with
    /// `vocabulary` token ids. Only the image placeholder may have an id outside of them.
    pub(crate) fn open(
        files: &ModelFiles,
        vocabulary: usize,
        image_token: u32,
    ) -> Result<Self, MllmError> {
        let json = files.required_json("tokenizer.json")?;
        let path = files.path("tokenizer.json");
        let broken = |problem: String| MllmError::Tokenizer {
            path: path.clone(),
            problem,
        };
        let mut tokenizer: Tokenizer =
            serde_json::from_value(json.clone()).map_err(|error| broken(error.to_string()))?;
        // Some files set a fixed length for batches, which would cut or pad prompts.
        tokenizer.with_padding(None);
        tokenizer
            .with_truncation(None)
            .map_err(|error| broken(error.to_string()))?;
        let outside = tokenizer
            .get_vocab(true)
            .into_iter()
            .map(|(token, id)| (id, token))
            .filter(|(id, _)| *id as usize >= vocabulary && *id != image_token)
            .min();
        if let Some((id, token)) = outside {
            return Err(MllmError::Vocabulary {
                token,
                id,
                vocabulary,
            });
        }
        let bytes = token_bytes(&json, &tokenizer, vocabulary).map_err(broken)?;
        Ok(Self {
            special: special_tokens(files)?,
            tokenizer: Arc::new(tokenizer),
            path,
            bytes: Arc::new(bytes),
        })
    }

    /// The file, for error messages.
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// Special tokens by role (`bos_token`, `eos_token`, ...).
    pub(crate) fn special(&self) -> &BTreeMap<String, String> {
        &self.special
    }

    /// The tokenizer with the names of special tokens treated as text.
    pub(crate) fn for_plain_text(&self) -> Tokenizer {
        let mut tokenizer = (*self.tokenizer).clone();
        tokenizer.set_encode_special_tokens(true);
        tokenizer
    }

    /// The bytes of each token id; see [`token_bytes`].
    pub(crate) fn bytes(&self) -> &[Vec<u8>] {
        &self.bytes
    }

    pub(crate) fn id(&self, token: &str) -> Option<u32> {
        self.tokenizer.token_to_id(token)
    }

    pub(crate) fn token(&self, id: u32) -> Option<String> {
        self.tokenizer.id_to_token(id)
    }

    /// How the vocabulary differs from another's, if it does: the first token id that stands for
    /// something else.
    pub(crate) fn vocabulary_difference(&self, other: &Self) -> Option<String> {
        let by_id = |tokenizer: &Self| -> BTreeMap<u32, String> {
            tokenizer
                .tokenizer
                .get_vocab(true)
                .into_iter()
                .map(|(token, id)| (id, token))
                .collect()
        };
        let (own, others) = (by_id(self), by_id(other));
        let id = own
            .keys()
            .chain(others.keys())
            .filter(|id| own.get(id) != others.get(id))
            .min()?;
        let quoted = |tokens: &BTreeMap<u32, String>| {
            tokens
                .get(id)
                .map_or_else(|| "no token".to_owned(), |token| format!("'{token}'"))
        };
        Some(format!(
            "its token {id} is {}, that of the model is {}",
            quoted(&own),
            quoted(&others)
        ))
    }

    /// Ids of a rendered chat. As in transformers, the tokenizer adds its special tokens only if
    /// the rendered chat does not begin with the beginning-of-sequence token.
    pub(crate) fn encode_chat(&self, rendered: &str) -> Result<Vec<u32>, MllmError> {
        let begun = self
            .special
            .get("bos_token")
            .is_some_and(|bos| rendered.starts_with(bos.as_str()));
        self.tokenizer
            .encode_fast(rendered, !begun)
            .map(|encoding| encoding.get_ids().to_vec())
            .map_err(|error| self.error(error.to_string()))
    }

    /// Ids of a text, without special tokens.
    pub(crate) fn encode_text(&self, text: &str) -> Result<Vec<u32>, MllmError> {
        self.tokenizer
            .encode_fast(text, false)
            .map(|encoding| encoding.get_ids().to_vec())
            .map_err(|error| self.error(error.to_string()))
    }

    /// Text of an answer, without special tokens.
    pub(crate) fn decode(&self, ids: &[u32]) -> Result<String, MllmError> {
        self.tokenizer
            .decode(ids, true)
            .map_err(|error| self.error(error.to_string()))
    }

    /// Text of an answer by the bytes of its tokens. Unlike [`Self::decode`], it keeps the leading
    /// space that some tokenizers add and remove.
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
        MllmError::Tokenizer {
            path: self.path.clone(),
            problem,
        }
    }
}

/// A special token in `tokenizer_config.json`.
#[derive(Deserialize)]
#[serde(
    untagged,
    expecting = "expected a text, or an object with a text as content"
)]
enum SpecialToken {
    Text(String),
    Object { content: String },
}

/// Reads the special tokens of `tokenizer_config.json` by role. Each is a text, or an object with
/// its `content`.
pub(crate) fn special_tokens(files: &ModelFiles) -> Result<BTreeMap<String, String>, MllmError> {
    const NAME: &str = "tokenizer_config.json";
    let mut special = BTreeMap::new();
    let Some(value) = files.json(NAME)? else {
        return Ok(special);
    };
    let path = files.path(NAME);
    let root = ConfigObject::root(&path, &value)?;
    for key in SPECIAL_TOKENS {
        if let Some(SpecialToken::Text(text) | SpecialToken::Object { content: text }) =
            root.value(key)?
        {
            special.insert(key.to_string(), text);
        }
    }
    Ok(special)
}
