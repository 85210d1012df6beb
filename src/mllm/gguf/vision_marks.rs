//! What shows that a decoder is part of a vision model.

use super::header::Header;
use crate::MllmError;

/// Architectures of the decoders of vision models.
const ARCHITECTURES: [&str; 3] = ["qwen2vl", "qwen3vl", super::qwen35::ARCHITECTURE];
/// Tokens that only vision models have. `<|image_pad|>` is none of them: Qwen's language models
/// have it too.
const TOKENS: [&str; 2] = ["<image>", "<IMG_CONTEXT>"];
const TOKEN_LIST: &str = "tokenizer.ggml.tokens";

/// What shows a decoder as part of a vision model; none if nothing does.
pub(super) fn find(decoder: &Header) -> Result<Option<String>, MllmError> {
    let architecture = decoder.architecture()?;
    if ARCHITECTURES.contains(&architecture) {
        return Ok(Some(format!("its architecture {architecture}")));
    }
    let tokens = decoder
        .metadata
        .get(TOKEN_LIST)
        .and_then(serde_json::Value::as_array);
    let mark = tokens.and_then(|tokens| {
        TOKENS
            .into_iter()
            .find(|mark| tokens.iter().any(|token| token == mark))
    });
    Ok(mark.map(|mark| format!("its token {mark}")))
}
