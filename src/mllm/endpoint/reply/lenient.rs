//! JSON as servers really write it: Python's `NaN`, halves of characters beyond 16 bits, control
//! characters inside texts. None of them may cost an answer.

use serde_json::{Deserializer, Value};
use std::borrow::Cow;

/// Numbers that are no JSON, in the words of Python, JavaScript and C.
const NO_NUMBERS: [&str; 6] = ["NaN", "-Infinity", "Infinity", "nan", "-inf", "inf"];
/// The sign for what cannot be read, as an escape.
const UNREADABLE: &str = "\\ufffd";

/// The value of a text.
///
/// # Errors
/// Those of the text as it came.
pub(in crate::endpoint) fn value(text: &str) -> Result<Value, serde_json::Error> {
    serde_json::from_str(text)
        .or_else(|error| serde_json::from_str(&mended(text)).map_err(|_| error))
}

/// A text of values one behind the other, mended where one of them is no JSON.
pub(super) fn readable(text: &str) -> Cow<'_, str> {
    let mut values = Deserializer::from_str(text).into_iter::<Value>();
    if values.any(|value| value.is_err()) {
        Cow::Owned(mended(text))
    } else {
        Cow::Borrowed(text)
    }
}

/// A text whose odd numbers are null and whose texts are JSON's.
fn mended(text: &str) -> String {
    let mut mended = String::with_capacity(text.len());
    let (mut rest, mut inside) = (text, false);
    while let Some(first) = rest.chars().next() {
        let (piece, taken) = if inside {
            in_text(rest, first)
        } else {
            between(rest, first)
        };
        mended.push_str(&piece);
        inside ^= first == '"';
        rest = rest.get(taken..).unwrap_or("");
    }
    mended
}

/// The next piece outside of texts, and how many bytes it stands for.
fn between(rest: &str, first: char) -> (Cow<'_, str>, usize) {
    if let Some(word) = NO_NUMBERS.iter().find(|word| rest.starts_with(**word)) {
        return ("null".into(), word.len());
    }
    if first == '-' || first.is_ascii_digit() {
        let is_number = |c: char| c.is_ascii_digit() || "+-.eE".contains(c);
        let length = rest.find(|c| !is_number(c)).unwrap_or(rest.len());
        let number = rest.get(..length).unwrap_or("");
        let too_large = number.parse::<f64>().is_ok_and(f64::is_infinite);
        return (if too_large { "null" } else { number }.into(), length);
    }
    (first.to_string().into(), first.len_utf8())
}

/// The next piece inside of a text, and how many bytes it stands for.
fn in_text(rest: &str, first: char) -> (Cow<'_, str>, usize) {
    if first.is_control() && first.is_ascii() {
        return (format!("\\u{:04x}", u32::from(first)).into(), 1);
    }
    if first != '\\' {
        return (first.to_string().into(), first.len_utf8());
    }
    let verbatim = |length: usize| (rest.get(..length).unwrap_or("").into(), length);
    match rest.as_bytes().get(1) {
        Some(b'u') => match (unit(rest), unit(rest.get(6..).unwrap_or(""))) {
            (Some(0xd800..=0xdbff), Some(0xdc00..=0xdfff)) => verbatim(12),
            (Some(0xd800..=0xdfff), _) => (UNREADABLE.into(), 6),
            _ => verbatim(2),
        },
        Some(b'"' | b'\\' | b'/' | b'b' | b'f' | b'n' | b'r' | b't') => verbatim(2),
        // JSON knows no other escapes, and writers who do mean the character alone.
        _ => ("".into(), 1),
    }
}

/// The unit of UTF-16 of an escape.
fn unit(escape: &str) -> Option<u16> {
    u16::from_str_radix(escape.strip_prefix("\\u")?.get(..4)?, 16).ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn what_is_nearly_json_is_read() {
        for (text, expected) in [
            (r#"{"a": NaN}"#, json!({"a": null})),
            (
                "[-Infinity, Infinity, nan, -inf, inf]",
                json!([null, null, null, null, null]),
            ),
            ("[1e999, -1e999, 1.5e3]", json!([null, null, 1500.0])),
            (
                r#"["NaN", "1e999", "\"NaN"]"#,
                json!(["NaN", "1e999", "\"NaN"]),
            ),
            (
                r#"["\ud83d", "\ude00x", "\ud83d\ude00"]"#,
                json!(["\u{fffd}", "\u{fffd}x", "😀"]),
            ),
            (
                r#"["\ud83d\n", "\\ud83d"]"#,
                json!(["\u{fffd}\n", "\\ud83d"]),
            ),
            ("[\"a\nb\tc\"]", json!(["a\nb\tc"])),
            (r#"["it\'s"]"#, json!(["it's"])),
        ] {
            assert_eq!(value(text).unwrap(), expected, "{text}");
        }
    }

    #[test]
    fn what_is_no_json_has_the_error_of_its_own_text() {
        for text in [
            "",
            "{",
            "[1, 2",
            "NaN NaN",
            "\"\\",
            "\"\\u12",
            "[\"\\ud83d",
            "nonsense",
            "-",
        ] {
            let own = serde_json::from_str::<Value>(text).unwrap_err().to_string();
            assert_eq!(value(text).unwrap_err().to_string(), own, "{text}");
        }
        assert!(matches!(readable("{} []"), Cow::Borrowed(_)));
        assert_eq!(readable("{} NaN"), "{} null");
    }
}
