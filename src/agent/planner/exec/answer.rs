//! Reads the answer of a command, and says what is wrong with one that is no message.

use super::agents::ExecAgent;
use super::json_fault::{JsonFault, first_fault};
use super::messages::{ExecReply, ExecState};
use serde::Deserialize;
use serde_json::Value;

/// The mark that some programs write before text in UTF-8.
const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";
/// Characters that an error shows on each side of the place of a fault.
const MAX_AROUND: usize = 40;
/// Characters that an error shows of an answer whose fault has no place.
const MAX_SHOWN: usize = 120;
/// The values of `type` in an answer.
const TYPES: [&str; 4] = ["ready", "trajectory", "agents", "error"];

/// The message of a line of a command; else what is wrong with the line, with the text around the
/// place.
pub fn read(line: &[u8]) -> Result<ExecReply, String> {
    let line = line
        .strip_prefix(BYTE_ORDER_MARK)
        .unwrap_or(line)
        .trim_ascii();
    // A list is no message, though serde would take one for the fields in their order.
    if line.starts_with(b"{")
        && let Ok(reply) = serde_json::from_slice(line)
    {
        return Ok(reply);
    }
    Err(fault(line))
}

/// The beginning of a line for errors.
pub(super) fn beginning(line: &[u8]) -> String {
    shown(&String::from_utf8_lossy(line), 0..MAX_SHOWN)
}

fn fault(line: &[u8]) -> String {
    // From what is no text to what is nearly a message: each check relies on those before it.
    if line.is_empty() {
        return "an empty line; each line of stdout must be one JSON object, and all else goes to stderr"
            .to_owned();
    }
    if line.starts_with(b"\xff\xfe") || line.starts_with(b"\xfe\xff") || line.contains(&0) {
        return "text in UTF-16, or binary data; write JSON in UTF-8".to_owned();
    }
    let text = match std::str::from_utf8(line) {
        Ok(text) => text,
        Err(error) => {
            let at = error.valid_up_to();
            let near = shown(
                &String::from_utf8_lossy(line),
                at.saturating_sub(MAX_AROUND)..at + MAX_AROUND,
            );
            return format!("byte {} is not UTF-8: {near}", at + 1);
        }
    };
    if text.starts_with('<') {
        return format!(
            "a page in HTML or XML, perhaps of a server or a proxy: {}",
            shown(text, 0..MAX_SHOWN)
        );
    }
    if !text.starts_with(['{', '[', '"', '\'']) && serde_json::from_str::<Value>(text).is_err() {
        return before_the_message(text);
    }
    if let Some(JsonFault { what, at }) = first_fault(text) {
        let begin = at.saturating_sub(MAX_AROUND);
        return format!(
            "{what}, at byte {}: {}",
            at + 1,
            shown(text, begin..at + MAX_AROUND)
        );
    }
    match serde_json::from_str::<Value>(text) {
        Ok(value) => shape_fault(value),
        Err(error) => format!("{error}: {}", shown(text, 0..MAX_SHOWN)),
    }
}

/// A line that begins with something else than JSON.
fn before_the_message(text: &str) -> String {
    let advice = "print text for people to stderr";
    match text.find("{\"type\"") {
        Some(at) => format!(
            "there is text before the message, {advice}: {}",
            shown(text, 0..at + MAX_AROUND)
        ),
        None => format!(
            "a line of text and no JSON object; {advice}: {}",
            shown(text, 0..MAX_SHOWN)
        ),
    }
}

/// The states of a `trajectory`.
#[derive(Deserialize)]
struct States {
    #[expect(dead_code, reason = "serde checks it, and nobody reads it")]
    states: Vec<ExecState>,
}

/// The objects of `agents`.
#[derive(Deserialize)]
struct Objects {
    #[expect(dead_code, reason = "serde checks it, and nobody reads it")]
    objects: Vec<ExecAgent>,
}

/// The text of an `error`.
#[derive(Deserialize)]
struct Message {
    #[expect(dead_code, reason = "serde checks it, and nobody reads it")]
    message: String,
}

/// What is wrong with a value of JSON that is no message.
fn shape_fault(value: Value) -> String {
    let types = TYPES.join(", ");
    let Value::Object(fields) = &value else {
        return format!(
            "{} and no JSON object; a message is an object with the key type ({types}): {}",
            kind(&value),
            shown(&value.to_string(), 0..MAX_SHOWN)
        );
    };
    let named = match fields.get("type") {
        Some(Value::String(named)) if TYPES.contains(&named.as_str()) => named.clone(),
        found => {
            let found = found.map_or_else(
                || "no key type".to_owned(),
                |found| format!("type {}", shown(&found.to_string(), 0..MAX_AROUND)),
            );
            return format!(
                "the object has {found}; a type is one of {types}: {}",
                shown(&value.to_string(), 0..MAX_SHOWN)
            );
        }
    };
    // Serde's error on the whole union names no field; the type of the message alone does.
    let problem = match named.as_str() {
        "trajectory" => field_fault::<States>(value),
        "agents" => field_fault::<Objects>(value),
        _ => field_fault::<Message>(value),
    };
    format!("{named}: {problem}")
}

/// The field at fault with its path, such as `states[3].x`.
fn field_fault<T: for<'de> Deserialize<'de>>(value: Value) -> String {
    let whole = value.clone();
    let Err(error) = serde_path_to_error::deserialize::<_, T>(value) else {
        // Only what a parsed object cannot show: a key that stood twice.
        return "an object has a key twice".to_owned();
    };
    let found = error
        .path()
        .iter()
        .try_fold(&whole, |value, segment| match segment {
            serde_path_to_error::Segment::Seq { index } => value.get(index),
            serde_path_to_error::Segment::Map { key } => value.get(key),
            _ => None,
        })
        .unwrap_or(&Value::Null);
    let path = error.path().to_string();
    let place = if path == "." {
        String::new()
    } else {
        format!("{path}: ")
    };
    let problem = error.inner().to_string();
    let near = shown(&found.to_string(), 0..MAX_AROUND);
    match problem.split_once(", expected ") {
        // JSON has no NaN, so a null among numbers mostly was one: the user is better served by
        // that cause.
        _ if found.is_null() && problem.contains("null") => format!(
            "{place}null where {} belongs; some programs write NaN and infinity as null",
            problem
                .split_once(", expected ")
                .map_or("a value", |(_, wanted)| belonging(wanted))
        ),
        Some((_, wanted)) => format!(
            "{place}{} where {} belongs: {near}",
            kind(found),
            belonging(wanted)
        ),
        None => format!("{place}{problem}: {near}"),
    }
}

/// A kind of value in words.
fn kind(value: &Value) -> &'static str {
    match value {
        Value::Object(_) => "an object",
        Value::Array(_) => "a list",
        Value::String(_) => "a text in quotes",
        Value::Number(_) => "a number",
        Value::Bool(_) | Value::Null => "a single word",
    }
}

/// What serde expects, in words.
fn belonging(wanted: &str) -> &str {
    match wanted {
        "f64" | "f32" => "a number",
        "a sequence" => "a list",
        "a string" => "a text",
        "a boolean" => "true or false",
        _ if wanted.starts_with("struct") || wanted == "a map" => {
            "an object with the keys of docs/exec.md"
        }
        "u64" | "u32" | "u16" | "u8" | "usize" => "a whole number from 0 on",
        "i64" | "i32" => "a whole number",
        _ => wanted,
    }
}

/// A part of a text, by bytes, on one line and with marks where it is cut.
fn shown(text: &str, bytes: std::ops::Range<usize>) -> String {
    let floor = |at: usize| {
        let at = at.min(text.len());
        (0..=at)
            .rev()
            .find(|at| text.is_char_boundary(*at))
            .unwrap_or(0)
    };
    let (begin, end) = (floor(bytes.start), floor(bytes.end));
    let mut out = String::new();
    if begin > 0 {
        out.push('…');
    }
    for character in text.get(begin..end).unwrap_or("").chars() {
        if character.is_control() {
            out.extend(character.escape_default());
        } else {
            out.push(character);
        }
    }
    if end < text.len() {
        out.push('…');
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fault_of(line: &[u8]) -> String {
        read(line).unwrap_err()
    }

    fn trajectory(x: &str) -> String {
        let state = |x: &str| {
            format!("{{\"t\": 0.0, \"x\": {x}, \"y\": 0.0, \"heading\": 0.0, \"speed\": 1.0}}")
        };
        let many = vec![state("1.0"); 10].join(", ");
        format!(
            "{{\"type\": \"trajectory\", \"states\": [{many}, {}, {many}]}}",
            state(x)
        )
    }

    #[test]
    fn a_message_is_read_whatever_ends_or_begins_its_line() {
        for line in [
            &b"{\"type\": \"ready\"}"[..],
            b"{\"type\": \"ready\"}\r",
            b"\xef\xbb\xbf{\"type\": \"ready\"}",
            b"  {\"type\":\"ready\", \"version\": 3}\t",
        ] {
            assert_eq!(read(line), Ok(ExecReply::Ready {}));
        }
        assert!(read(trajectory("2").as_bytes()).is_ok());
    }

    #[test]
    fn a_number_that_is_none_is_named_with_its_place() {
        for word in [
            "NaN",
            "Infinity",
            "-Infinity",
            "nan",
            "inf",
            "-inf",
            "1.#QNAN",
        ] {
            let fault = fault_of(trajectory(word).as_bytes());
            assert!(fault.contains("states[10].x"), "{word}: {fault}");
            assert!(fault.contains(&format!("\"x\": {word}")), "{word}: {fault}");
            assert!(fault.chars().count() < 250, "{fault}");
        }
        let null = fault_of(trajectory("null").as_bytes());
        assert!(
            null.contains("states[10].x") && null.contains("NaN and infinity as null"),
            "{null}"
        );
        let later = fault_of(trajectory("-2E+5, \"y\": 1e-3, \"z\": NaN").as_bytes());
        assert!(later.contains("states[10].z is NaN"), "{later}");
        let large = fault_of(trajectory("1e999").as_bytes());
        assert!(
            large.contains("states[10].x") && large.contains("too large"),
            "{large}"
        );
        let text = fault_of(trajectory("\"1.0\"").as_bytes());
        assert!(
            text.contains("states[10].x: a text in quotes where a number belongs: \"1.0\""),
            "{text}"
        );
    }

    #[test]
    fn each_kind_of_wrong_line_has_a_sentence_of_its_own() {
        for (line, expected) in [
            ("", "an empty line"),
            (
                "loading the model",
                "print text for people to stderr: loading",
            ),
            ("INFO: {\"type\": \"ready\"}", "text before the message"),
            ("Traceback (most recent call last):", "a line of text"),
            ("<!DOCTYPE html><html>", "HTML"),
            ("{'type': 'ready'}", "single quotes"),
            (
                "{\"type\": \"trajectory\", \"states\": [], \"states\": []}",
                "an object has a key twice",
            ),
            ("{\"type\": 'ready'}", "single quotes"),
            ("{\"type\": \"ready\",}", "comma"),
            (
                "{\"type\": \"ready\"}{\"type\": \"ready\"}",
                "two messages in one line",
            ),
            ("{\"type\": \"ready\"} ok", "text behind the message"),
            (
                "{\"type\": \"trajectory\", \"states\": [{\"t\": 0",
                "ends inside states[0];",
            ),
            ("{", "ends inside"),
            ("{type: \"ready\"}", "key without quotes"),
            ("{\"type\": ready}", "without quotes"),
            ("{\"type\": \"ready\", \"a\": None}", "Python"),
            ("{\"type\": \"ready\", \"a\": True}", "Python"),
            (
                "{\"type\": \"ready\", \"a\": np.float64(1.0)}",
                "np.float64",
            ),
            ("{\"type\": \"ready\" \"a\": 1}", "expected a comma"),
            ("{\"type\": \"ready\", \"a\": .5}", "is no number of JSON"),
            ("{\"type\": \"ready\", \"a\": 01}", "is no number of JSON"),
            ("{\"type\" \"ready\"}", "expected a colon"),
            ("{\"type\": \"rea", "ends inside"),
            ("{\"type\": \"rea\\q\"}", "escape"),
            ("[{\"type\": \"ready\"}]", "a list and no JSON object"),
            ("[\"ready\"]", "a list and no JSON object"),
            ("3.5", "a number and no JSON object"),
            ("true", "a single word"),
            ("\"ready\"", "a text in quotes"),
            ("{\"states\": []}", "no key type"),
            ("{\"type\": \"plan\"}", "type \"plan\""),
            ("{\"type\": 1}", "type 1"),
            ("{\"type\": \"trajectory\"}", "missing field `states`"),
            (
                "{\"type\": \"trajectory\", \"states\": {}}",
                "states: an object where a list belongs: {}",
            ),
            (
                "{\"type\": \"trajectory\", \"states\": [{\"t\": 0}]}",
                "states[0]: missing field `x`",
            ),
            (
                "{\"type\": \"trajectory\", \"states\": [[0, 0, 0]]}",
                "states[0]: a list where an object with the keys",
            ),
            (
                "{\"type\": \"agents\", \"objects\": [{\"track\": -1}]}",
                "objects[0].track",
            ),
            ("{\"type\": \"error\"}", "missing field `message`"),
        ] {
            let fault = fault_of(line.as_bytes());
            assert!(fault.contains(expected), "{line}: {fault}");
        }
        let utf16: Vec<u8> = "{\"type\": \"ready\"}"
            .encode_utf16()
            .flat_map(u16::to_le_bytes)
            .collect();
        assert!(fault_of(&utf16).contains("UTF-16"));
        assert!(fault_of(b"{\"type\": \"\xff\"}").contains("byte 11 is not UTF-8"));
    }

    #[test]
    fn what_an_error_shows_is_one_short_line() {
        let long = format!("{}\u{1b}[31m{}", "x".repeat(50), "ä".repeat(500));
        let fault = fault_of(long.as_bytes());
        assert!(
            fault.contains("\\u{1b}[31m") && fault.ends_with('…'),
            "{fault}"
        );
        assert!(fault.chars().count() < 250, "{fault}");
        let deep = "[".repeat(100_000);
        assert!(fault_of(deep.as_bytes()).contains("nested"));
    }

    proptest::proptest! {
        #[test]
        fn no_line_panics(line in proptest::collection::vec(proptest::num::u8::ANY, 0..200)) {
            let _ = read(&line);
            let _ = beginning(&line);
        }

        #[test]
        fn no_text_like_json_panics(text in "[\\[\\]{}:,\"'\\\\a-zA-Z0-9.+ -]{0,60}") {
            let _ = read(format!("{{{text}").as_bytes());
        }
    }
}
