//! A byte-level tokenizer in GGUF metadata (`tokenizer.ggml.model = gpt2`), converted to an
//! equivalent `tokenizer.json`.
//!
//! The file has tokens and merges. How a text is split before that has only a name there
//! (`tokenizer.ggml.pre`).

use super::header::Header;
use super::tokenizer::{Pieces, Special, TokenizerFiles, beginning, piece};
use crate::MllmError;
use serde_json::{Map, Value as Json, json};

/// How texts are split (`llm_tokenizer_bpe` of llama.cpp, and the models' own files).
const QWEN2: &str = r"(?i:'s|'t|'re|'ve|'m|'ll|'d)|[^\r\n\p{L}\p{N}]?\p{L}+|\p{N}| ?[^\s\p{L}\p{N}]+[\r\n]*|\s*[\r\n]+|\s+(?!\S)|\s+";
/// As Qwen 2, but combining marks stay with their letters.
const QWEN35: &str = r"(?i:'s|'t|'re|'ve|'m|'ll|'d)|[^\r\n\p{L}\p{N}]?[\p{L}\p{M}]+|\p{N}| ?[^\s\p{L}\p{M}\p{N}]+[\r\n]*|\s*[\r\n]+|\s+(?!\S)|\s+";
const LLAMA3: &str = r"(?i:'s|'t|'re|'ve|'m|'ll|'d)|[^\r\n\p{L}\p{N}]?\p{L}+|\p{N}{1,3}| ?[^\s\p{L}\p{N}]+[\r\n]*|\s*[\r\n]+|\s+(?!\S)|\s+";
/// The names that are known.
const KNOWN: [&str; 7] = [
    "default",
    "gpt-2",
    "smollm",
    "qwen2",
    "qwen35",
    "llama-bpe",
    "lfm2",
];

/// The key of the way that texts are split.
const PRE: &str = "tokenizer.ggml.pre";
/// The name that says nothing: the split of GPT-2 is taken, as llama.cpp does.
const DEFAULT: &str = "default";

/// The name of the way that texts are split. Files of before May 2024 have none; all Qwens of that
/// time split alike.
fn split_name(header: &Header) -> Result<&str, MllmError> {
    Ok(match header.text(PRE)? {
        Some(name) => name,
        None if header.architecture()? == super::qwen35::ARCHITECTURE => "qwen35",
        None if header.architecture()?.starts_with("qwen") => "qwen2",
        None => DEFAULT,
    })
}

/// A note where the file does not say how texts are split.
pub(super) fn note(header: &Header) -> Result<Option<String>, MllmError> {
    let stored = header.text(PRE)?;
    if stored.is_some_and(|name| name != DEFAULT) {
        return Ok(None);
    }
    let stored = stored.map_or_else(
        || format!("has no {PRE}"),
        |name| format!("says {PRE} = {name}"),
    );
    let taken = match split_name(header)? {
        DEFAULT => "GPT-2",
        name => name,
    };
    Ok(Some(format!(
        "{} {stored}, so it does not name how texts are split; the split of {taken} is taken, and other tokens mean other \
         answers; the model's tokenizer.json beside the file decides",
        header.path.display()
    )))
}

/// Reads the tokenizer of a model whose embedding has `vocabulary` rows.
pub(super) fn read(header: &Header, vocabulary: usize) -> Result<TokenizerFiles, MllmError> {
    const MERGES: &str = "tokenizer.ggml.merges";
    let name = split_name(header)?;
    let Some((normalizer, pre_tokenizer)) = splitting(name) else {
        let known = KNOWN.join(", ");
        let problem = format!(
            "'{name}' is not known ({known} are); put the model's tokenizer.json beside the file"
        );
        return Err(header.error(PRE, problem));
    };
    let pieces = Pieces::read(header, vocabulary)?;
    let Some(merges) = header.list::<String>(MERGES, "a list of texts")? else {
        return Err(header.error(
            MERGES,
            "the file has none; put the model's tokenizer.json beside it",
        ));
    };
    let Some(merges) = merges
        .iter()
        .map(|merge| merge.split_once(' '))
        .collect::<Option<Vec<_>>>()
    else {
        return Err(header.error(MERGES, "expected pairs of tokens with a space between"));
    };
    // Special tokens keep their ids only if the vocabulary has them too.
    let all = pieces.tokens.iter().zip(&pieces.kinds).enumerate();
    let vocab: Map<String, Json> = all
        .filter(|(_, (_, kind))| **kind != piece::UNUSED)
        .map(|(id, (token, _))| ((*token).to_string(), json!(id)))
        .collect();
    if let Some((left, right)) = merges
        .iter()
        .find(|(left, right)| !vocab.contains_key(&format!("{left}{right}")))
    {
        return Err(header.error(
            MERGES,
            format!(
                "'{}' and '{}' make no token",
                left.escape_debug(),
                right.escape_debug()
            ),
        ));
    }
    let Special {
        bos, ends, config, ..
    } = Special::read(header, &pieces)?;
    let begins = header
        .flag("tokenizer.ggml.add_bos_token")?
        .unwrap_or(splits_as_llama3(name));
    let tokenizer = json!({
        "version": "1.0",
        "added_tokens": pieces.added(),
        "normalizer": normalizer,
        "pre_tokenizer": pre_tokenizer,
        "post_processor": bos.filter(|_| begins).map(|(id, token)| beginning(id, token)),
        "decoder": {"type": "ByteLevel", "add_prefix_space": true, "trim_offsets": true, "use_regex": true},
        "model": {
            "type": "BPE", "dropout": null, "unk_token": null, "continuing_subword_prefix": null,
            "end_of_word_suffix": null, "fuse_unk": false, "byte_fallback": false,
            "ignore_merges": splits_as_llama3(name), "vocab": vocab, "merges": merges,
        },
    });
    Ok(TokenizerFiles {
        tokenizer,
        config,
        ends,
    })
}

/// The name of the way in which a `tokenizer.json` splits texts; none if it has no name.
pub(crate) fn name_of(tokenizer: &Json) -> Option<&'static str> {
    let own = (
        tokenizer["normalizer"].clone(),
        without_offsets(tokenizer["pre_tokenizer"].clone()),
    );
    KNOWN.into_iter().find(|name| {
        splitting(name)
            .is_some_and(|(normalizer, splits)| own == (normalizer, without_offsets(splits)))
    })
}

/// A pre-tokenizer without what changes no token.
fn without_offsets(mut splits: Json) -> Json {
    if let Some(parts) = splits["pretokenizers"].as_array_mut() {
        for part in parts {
            if let Some(keys) = part.as_object_mut() {
                keys.remove("trim_offsets");
            }
        }
    } else if let Some(keys) = splits.as_object_mut() {
        keys.remove("trim_offsets");
    }
    splits
}

/// Whether texts are split as by Llama 3, whose tokens are taken whole, before any merge.
fn splits_as_llama3(name: &str) -> bool {
    ["llama-bpe", "lfm2"].contains(&name)
}

/// Normalizer and pre-tokenizer of a name.
fn splitting(name: &str) -> Option<(Json, Json)> {
    let bytes = |use_regex: bool| json!({"type": "ByteLevel", "add_prefix_space": false, "trim_offsets": true, "use_regex": use_regex});
    let sequence =
        |first: Json, bytes: Json| json!({"type": "Sequence", "pretokenizers": [first, bytes]});
    let pattern = |pattern: &str| {
        let split = json!({"type": "Split", "pattern": {"Regex": pattern}, "behavior": "Isolated", "invert": false});
        sequence(split, bytes(false))
    };
    match name {
        "default" | "gpt-2" => Some((Json::Null, bytes(true))),
        "smollm" => Some((
            Json::Null,
            sequence(
                json!({"type": "Digits", "individual_digits": true}),
                bytes(true),
            ),
        )),
        "qwen2" => Some((json!({"type": "NFC"}), pattern(QWEN2))),
        "qwen35" => Some((json!({"type": "NFC"}), pattern(QWEN35))),
        name if splits_as_llama3(name) => Some((Json::Null, pattern(LLAMA3))),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_known_name_has_a_way_to_split() {
        assert!(KNOWN.into_iter().all(|name| splitting(name).is_some()));
        assert!(splitting("tekken").is_none());
        for name in KNOWN
            .into_iter()
            .filter(|name| !["gpt-2", "lfm2"].contains(name))
        {
            let (normalizer, splits) = splitting(name).unwrap();
            let mut file = json!({"normalizer": normalizer, "pre_tokenizer": splits});
            assert_eq!(name_of(&file), Some(name));
            if let Some(parts) = file["pre_tokenizer"]["pretokenizers"].as_array_mut() {
                parts.last_mut().unwrap()["trim_offsets"] = json!(false);
            }
            assert_eq!(name_of(&file), Some(name));
        }
        assert_eq!(
            name_of(&json!({"pre_tokenizer": {"type": "Metaspace"}})),
            None
        );
    }
}
