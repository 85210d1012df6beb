//! The small files of a decoder's part of a model, made from its metadata.

use super::{Header, TEMPLATE, TOKENIZER, llama, tokenizer};
use crate::MllmError;
use serde_json::Value;
use std::collections::BTreeMap;

/// Tokenizer, chat template and `text_config` of a decoder.
pub(crate) struct TextFiles {
    pub(crate) text_config: Value,
    tokenizer: Value,
    files: BTreeMap<String, String>,
}

impl TextFiles {
    pub(crate) fn read(decoder: &Header, notes: &mut Vec<String>) -> Result<Self, MllmError> {
        const KEY: &str = "tokenizer.chat_template";
        let text_config = llama::text_config(decoder, notes)?;
        let vocabulary = text_config["vocab_size"]
            .as_u64()
            .expect("the configuration of a decoder says its vocabulary")
            as usize;
        let mut files = BTreeMap::new();
        let tokenizer = tokenizer::files(decoder, vocabulary, &mut files)?;
        files.insert(TOKENIZER.to_string(), tokenizer.to_string());
        if !decoder.path.with_file_name(TEMPLATE).is_file() {
            let problem =
                format!("the file has no chat template; put the model's {TEMPLATE} beside it");
            let template = decoder
                .text(KEY)?
                .ok_or_else(|| decoder.error(KEY, problem))?;
            files.insert(TEMPLATE.to_string(), template.to_string());
        }
        Ok(Self {
            text_config,
            tokenizer,
            files,
        })
    }

    /// The id of a special token.
    pub(crate) fn added_id(&self, decoder: &Header, token: &str) -> Result<u64, MllmError> {
        tokenizer::added_id(&self.tokenizer, token).ok_or_else(|| MllmError::Tokenizer {
            path: tokenizer::place(decoder),
            problem: format!("the special token {token} is missing{}", untyped(decoder)),
        })
    }

    /// The id of a special token, which is added behind all others where the file has none.
    pub(crate) fn id_of(&mut self, decoder: &Header, token: &str) -> Result<u64, MllmError> {
        let id = tokenizer::placeholder(&mut self.tokenizer, token).map_err(|problem| {
            MllmError::Tokenizer {
                path: tokenizer::place(decoder),
                problem: problem.into(),
            }
        })?;
        self.files
            .insert(TOKENIZER.to_string(), self.tokenizer.to_string());
        Ok(id)
    }

    /// Adds a file.
    pub(crate) fn put(&mut self, name: &str, value: &Value) {
        self.files.insert(name.to_string(), value.to_string());
    }

    pub(crate) fn into_files(self) -> BTreeMap<String, String> {
        self.files
    }
}

/// Why a decoder's tokenizer may have no special tokens.
fn untyped(decoder: &Header) -> String {
    const TYPES: &str = "tokenizer.ggml.token_type";
    let is_typed = decoder.metadata.contains_key(TYPES);
    if is_typed || decoder.path.with_file_name(TOKENIZER).is_file() {
        String::new()
    } else {
        format!("; the file has no {TYPES}, so put the model's {TOKENIZER} beside it")
    }
}
