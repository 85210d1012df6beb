//! GGUF metadata of a `tokenizer.json` for llama.cpp. This program reads the packed file instead.

use crate::gguf::{Entries, byte_level, tokenizer::piece};
use serde_json::{Value as Json, json};
use std::collections::{BTreeMap, HashMap};

/// The metadata of a byte-pair tokenizer for a model of `vocabulary` rows. `special` holds its
/// special tokens by role (`bos_token`, ...). None for other kinds of tokenizers, for which
/// llama.cpp has no such keys.
pub(crate) fn metadata(
    tokenizer: &Json,
    special: &BTreeMap<String, String>,
    vocabulary: usize,
) -> Option<Entries> {
    let model = &tokenizer["model"];
    let merges = merges(&model["merges"])?;
    let sentence_piece = model["byte_fallback"].as_bool() == Some(true);
    let mut tokens: Vec<String> = (0..vocabulary).map(|id| format!("[PAD{id}]")).collect();
    let mut kinds = vec![piece::UNUSED; vocabulary];
    let mut ids = HashMap::new();
    let mut put = |token: &str, id: &Json, kind: i64| -> Option<()> {
        let id = id.as_u64()? as usize;
        // The placeholder of an image may lie behind the vocabulary.
        if let (Some(place), Some(known)) = (tokens.get_mut(id), kinds.get_mut(id)) {
            (*place, *known) = (token.to_string(), kind);
            ids.insert(token.to_string(), id);
        }
        Some(())
    };
    for (token, id) in model["vocab"].as_object()? {
        let byte =
            sentence_piece && token.len() == 6 && token.starts_with("<0x") && token.ends_with('>');
        put(token, id, if byte { piece::BYTE } else { piece::NORMAL })?;
    }
    for added in tokenizer["added_tokens"].as_array().into_iter().flatten() {
        let token = added["content"].as_str()?;
        let kind = match added["special"].as_bool() {
            _ if model["unk_token"].as_str() == Some(token) => piece::UNKNOWN,
            Some(true) => piece::CONTROL,
            _ => piece::USER_DEFINED,
        };
        put(token, &added["id"], kind)?;
    }
    let mut metadata = Vec::new();
    if sentence_piece {
        let scores = scores(&merges, &ids, vocabulary);
        metadata.push(("tokenizer.ggml.scores", json!(scores)));
        metadata.push(("tokenizer.ggml.model", json!("llama")));
        let prefix = tokenizer["normalizer"].to_string().contains("Prepend")
            || tokenizer["pre_tokenizer"]["prepend_scheme"]
                .as_str()
                .is_some_and(|scheme| scheme != "never");
        metadata.push(("tokenizer.ggml.add_space_prefix", json!(prefix)));
    } else {
        let merges: Vec<String> = merges
            .iter()
            .map(|[left, right]| format!("{left} {right}"))
            .collect();
        metadata.push(("tokenizer.ggml.merges", json!(merges)));
        metadata.push(("tokenizer.ggml.model", json!("gpt2")));
        let splits = byte_level::name_of(tokenizer).unwrap_or("default");
        metadata.push(("tokenizer.ggml.pre", json!(splits)));
    }
    metadata.push(("tokenizer.ggml.tokens", json!(tokens)));
    metadata.push(("tokenizer.ggml.token_type", json!(kinds)));
    let begins = tokenizer["post_processor"]["single"]
        .to_string()
        .contains("SpecialToken");
    metadata.push(("tokenizer.ggml.add_bos_token", json!(begins)));
    for (role, key) in [
        ("bos_token", "tokenizer.ggml.bos_token_id"),
        ("eos_token", "tokenizer.ggml.eos_token_id"),
        ("unk_token", "tokenizer.ggml.unknown_token_id"),
        ("pad_token", "tokenizer.ggml.padding_token_id"),
    ] {
        if let Some(id) = special.get(role).and_then(|token| ids.get(token)) {
            metadata.push((key, json!(id)));
        }
    }
    Some(
        metadata
            .into_iter()
            .map(|(key, value)| (key.to_string(), value))
            .collect(),
    )
}

/// The merges, each a pair or a text of two words.
fn merges(merges: &Json) -> Option<Vec<[String; 2]>> {
    let pair = |merge: &Json| match merge {
        Json::String(text) => text
            .split_once(' ')
            .map(|(left, right)| [left.to_string(), right.to_string()]),
        Json::Array(pair) => match pair.as_slice() {
            [left, right] => Some([left.as_str()?.to_string(), right.as_str()?.to_string()]),
            _ => None,
        },
        _ => None,
    };
    merges.as_array()?.iter().map(pair).collect()
}

/// A score for every token: the earlier its merge, the higher. Tokens without a merge have the
/// lowest score.
fn scores(merges: &[[String; 2]], ids: &HashMap<String, usize>, vocabulary: usize) -> Vec<f32> {
    let mut scores = vec![-(merges.len() as f32) - 1.0; vocabulary];
    for (rank, [left, right]) in merges.iter().enumerate().rev() {
        if let Some(score) = ids
            .get(&format!("{left}{right}"))
            .and_then(|id| scores.get_mut(*id))
        {
            *score = -(rank as f32);
        }
    }
    scores
}
