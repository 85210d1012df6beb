//! The bytes of each token, on which grammars work.

use serde_json::Value;
use tokenizers::Tokenizer;
use toktrie::TokTrie;

/// Maximum bytes of a token in constrained decoding (the token trie has at most 1,024 levels).
const MAX_TOKEN_BYTES: usize = 1000;

/// How a vocabulary spells bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Spelling {
    /// GPT-2: every byte is one printable character.
    ByteLevel,
    /// `SentencePiece`: `▁` is a space, `<0x0A>` a byte.
    SentencePiece,
}

/// The bytes of every token id below `vocabulary`, empty for ids without a token. Special tokens
/// begin with [`TokTrie::SPECIAL_TOKEN_MARKER`], a byte that no text contains.
pub(super) fn token_bytes(
    json: &Value,
    tokenizer: &Tokenizer,
    vocabulary: usize,
) -> Result<Vec<Vec<u8>>, String> {
    let spelling = spelling(json)?;
    let mut bytes = vec![Vec::new(); vocabulary];
    for (token, id) in tokenizer.get_vocab(false) {
        if let Some(entry) = bytes.get_mut(id as usize) {
            *entry = match spelling {
                Spelling::ByteLevel => byte_level(&token).ok_or_else(|| {
                    format!(
                        "token '{}' has characters outside the byte-level spelling",
                        token.escape_debug()
                    )
                })?,
                Spelling::SentencePiece => sentence_piece(&token),
            };
        }
    }
    // After the vocabulary, because added tokens are spelled as they are and may stand in both.
    for (id, added) in tokenizer.get_added_tokens_decoder() {
        if let Some(entry) = bytes.get_mut(id as usize) {
            entry.clear();
            if added.special {
                entry.push(TokTrie::SPECIAL_TOKEN_MARKER);
            }
            entry.extend(added.content.as_bytes());
        }
    }
    for entry in &mut bytes {
        if entry.len() > MAX_TOKEN_BYTES {
            entry.clear();
        }
    }
    Ok(bytes)
}

/// The spelling of the vocabulary, from the decoder and the pre-tokenizer.
fn spelling(json: &Value) -> Result<Spelling, String> {
    let (decoder, pre_tokenizer, model) =
        (&json["decoder"], &json["pre_tokenizer"], &json["model"]);
    if has_type(decoder, "decoders", "ByteLevel")
        || has_type(pre_tokenizer, "pretokenizers", "ByteLevel")
    {
        Ok(Spelling::ByteLevel)
    } else if has_type(decoder, "decoders", "ByteFallback")
        || has_type(decoder, "decoders", "Metaspace")
        || model["byte_fallback"].as_bool() == Some(true)
    {
        Ok(Spelling::SentencePiece)
    } else {
        Err("the tokenizer is neither byte-level nor SentencePiece, so its tokens have no known bytes".into())
    }
}

/// Whether a component has a type, or is a sequence with a part of that type.
fn has_type(component: &Value, parts: &str, wanted: &str) -> bool {
    component["type"].as_str() == Some(wanted)
        || component[parts].as_array().is_some_and(|parts| {
            parts
                .iter()
                .any(|part| part["type"].as_str() == Some(wanted))
        })
}

/// Decodes GPT-2's spelling: printable Latin-1 stands for itself; the 68 other bytes are, in order,
/// U+0100 and up.
fn byte_level(token: &str) -> Option<Vec<u8>> {
    token
        .chars()
        .map(|character| match u32::from(character) {
            code @ (0x21..=0x7e | 0xa1..=0xac | 0xae..=0xff) => u8::try_from(code).ok(),
            code @ 0x100..=0x120 => u8::try_from(code - 0x100).ok(),
            code @ 0x121..=0x142 => u8::try_from(code - 0x121 + 0x7f).ok(),
            0x143 => Some(0xad),
            _ => None,
        })
        .collect()
}

fn sentence_piece(token: &str) -> Vec<u8> {
    let hexadecimal = token
        .strip_prefix("<0x")
        .and_then(|rest| rest.strip_suffix('>'));
    match hexadecimal
        .filter(|digits| digits.len() == 2)
        .map(|digits| u8::from_str_radix(digits, 16))
    {
        Some(Ok(byte)) => vec![byte],
        _ => token.replace('\u{2581}', " ").into_bytes(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn byte_level_spelling_covers_every_byte_once() {
        let characters = (0x21..=0x7e)
            .chain(0xa1..=0xac)
            .chain(0xae..=0xff)
            .chain(0x100..=0x143);
        let text: String = characters.filter_map(char::from_u32).collect();
        let mut bytes = byte_level(&text).unwrap();
        bytes.sort_unstable();
        assert_eq!(bytes, (0..=255).collect::<Vec<u8>>());
        assert_eq!(byte_level("\u{120}a\u{10a}").unwrap(), b" a\n");
        assert_eq!(byte_level("\u{2581}"), None);
    }

    #[test]
    fn sentence_piece_spelling_has_spaces_and_bytes() {
        assert_eq!(sentence_piece("\u{2581}lane"), b" lane");
        assert_eq!(sentence_piece("<0x0A>"), b"\n");
        assert_eq!(sentence_piece("<0xZZ>"), b"<0xZZ>");
        assert_eq!(sentence_piece("<0x"), b"<0x");
    }
}
