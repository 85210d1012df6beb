//! Where servers put the text of an answer, and what they put beside it.

use serde_json::{Map, Value};

/// Members with the reasoning of a model: vLLM, `SGLang`, llama.cpp's server and LM Studio; Ollama
/// and `OpenRouter`; `LiteLLM`; others.
const REASONING: [&str; 7] = [
    "reasoning_content",
    "reasoning",
    "thinking",
    "reasoning_details",
    "thinking_blocks",
    "thinking_content",
    "reasoning_text",
];
/// Types of parts with text of the answer.
const TEXT_PARTS: [&str; 2] = ["text", "output_text"];
/// Types of parts with reasoning: Mistral, `OpenRouter`, others.
const REASONING_PARTS: [&str; 5] = [
    "thinking",
    "reasoning",
    "reasoning_content",
    "reasoning.text",
    "reasoning.summary",
];

/// What a choice says: a whole message, or a piece of a streamed one.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Said {
    pub(super) text: String,
    pub(super) reasoning: String,
    pub(super) refusal: String,
    /// Whether a tool is called.
    pub(super) called: bool,
}

/// Members with calls of tools.
const CALLS: [&str; 2] = ["tool_calls", "function_call"];

impl Said {
    /// Reads a choice.
    pub(super) fn from_choice(choice: &Value) -> Self {
        let mut said = Self::default();
        if let Some(text) = choice.as_str() {
            said.text.push_str(text);
            return said;
        }
        let piece = choice.get("delta").and_then(message_of);
        let whole = ["message", "messages"]
            .iter()
            .filter_map(|name| choice.get(*name))
            .find_map(message_of);
        let spoken = |message: &&Value| is_spoken(message);
        let message = piece
            .filter(spoken)
            .or(whole.filter(spoken))
            .or(piece)
            .or(whole);
        if let Some(text) = message.and_then(Value::as_str) {
            said.text.push_str(text);
        } else if let Some(message) = message {
            said.add(message.get("content").unwrap_or(&Value::Null));
            if said.reasoning.is_empty() {
                let fields = REASONING.iter().filter_map(|name| message.get(name));
                said.reasoning = fields
                    .map(reasoning_of)
                    .find(|text| !text.is_empty())
                    .unwrap_or_default();
            }
            said.called = CALLS
                .iter()
                .filter_map(|name| message.get(name))
                .any(is_call);
            if let Some(refusal) = message.get("refusal").and_then(Value::as_str) {
                said.refusal.push_str(refusal);
            }
        }
        if said.text.is_empty()
            && let Some(text) = choice.get("text").and_then(Value::as_str)
        {
            // The older completions have no message.
            said.text.push_str(text);
        }
        said
    }

    /// Adds a content: a text, a list of parts, or a part. Proxies that read the answer's JSON put
    /// its value there.
    fn add(&mut self, content: &Value) {
        match content {
            Value::Null => {}
            Value::String(text) => self.text.push_str(text),
            Value::Array(parts) => parts.iter().for_each(|part| self.add_part(part)),
            Value::Object(part) if is_part(part) => self.add_part(content),
            Value::Bool(_) | Value::Number(_) | Value::Object(_) => {
                self.text.push_str(&content.to_string());
            }
        }
    }

    /// Adds a part. Parts of unknown types, such as references, are no text of the answer.
    fn add_part(&mut self, part: &Value) {
        if let Some(text) = part.as_str() {
            self.text.push_str(text);
            return;
        }
        let kind = part.get("type").and_then(Value::as_str).unwrap_or("text");
        if TEXT_PARTS.contains(&kind) {
            self.text
                .push_str(part.get("text").map(text_of).unwrap_or_default());
        } else if REASONING_PARTS.contains(&kind) {
            self.reasoning.push_str(&reasoning_of(part));
        } else if kind == "refusal" {
            self.refusal
                .push_str(part.get("refusal").map(text_of).unwrap_or_default());
        }
    }
}

/// Whether an object is a part of a content, and no value of its own.
fn is_part(object: &Map<String, Value>) -> bool {
    let mut named = ["type", "text", "thinking", "reasoning"].iter();
    object.is_empty() || named.any(|name| object.contains_key(*name))
}

/// Whether a choice has a message so far, and no piece of one.
pub(super) fn is_message(choice: &Value) -> bool {
    let piece = choice.get("delta").and_then(message_of);
    let mut named = ["message", "messages"].iter();
    !piece.is_some_and(is_spoken)
        && named.any(|name| choice.get(*name).and_then(message_of).is_some())
}

/// A message: an object, its text alone, or the last of a list.
fn message_of(message: &Value) -> Option<&Value> {
    match message {
        Value::Object(_) | Value::String(_) => Some(message),
        Value::Array(messages) => messages.iter().rev().find(|message| message.is_object()),
        _ => None,
    }
}

/// Whether a message has a content.
fn is_spoken(message: &Value) -> bool {
    match message.get("content").unwrap_or(message) {
        Value::String(text) => !text.is_empty(),
        Value::Array(parts) => !parts.is_empty(),
        Value::Null => false,
        _ => message.get("content").is_some(),
    }
}

/// Whether a member holds a call: no null and no empty list.
fn is_call(member: &Value) -> bool {
    match member {
        Value::Array(calls) => !calls.is_empty(),
        Value::Object(call) => !call.is_empty(),
        _ => false,
    }
}

/// A text, or the value of a text in an object.
fn text_of(text: &Value) -> &str {
    text.as_str()
        .or_else(|| text.get("value").and_then(Value::as_str))
        .unwrap_or_default()
}

/// Reasoning, which may be a text, a part or a list of parts. JSON is parsed to a limited depth, so
/// this ends.
fn reasoning_of(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        Value::Array(parts) => parts.iter().map(reasoning_of).collect(),
        Value::Object(part) => {
            let names = [
                "thinking",
                "reasoning",
                "reasoning_content",
                "text",
                "content",
                "summary",
            ];
            names
                .iter()
                .filter_map(|name| part.get(*name))
                .map(reasoning_of)
                .find(|text| !text.is_empty())
                .unwrap_or_default()
        }
        _ => String::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn the_answer_is_found_in_every_form() {
        for (what, choice) in [
            ("a text", json!({"message": {"content": "keep left"}})),
            ("a piece", json!({"delta": {"content": "keep left"}})),
            (
                "both, as some proxies send",
                json!({"delta": {"content": "keep left"}, "message": null}),
            ),
            (
                "a piece before the whole",
                json!({"delta": {"content": "keep left"}, "message": {"content": "so far"}}),
            ),
            (
                "a whole beside an empty piece",
                json!({"delta": {"role": "assistant", "content": ""}, "message": {"content": "keep left"}}),
            ),
            ("a message that is a text", json!({"message": "keep left"})),
            ("a piece that is a text", json!({"delta": "keep left"})),
            (
                "a piece in a list",
                json!({"delta": [{"content": "keep left"}]}),
            ),
            (
                "a list of messages",
                json!({"messages": [{"role": "user", "content": "x"}, {"role": "assistant", "content": "keep left"}]}),
            ),
            (
                "parts",
                json!({"message": {"content": [{"type": "text", "text": "keep "}, {"type": "text", "text": "left"}]}}),
            ),
            (
                "a single part",
                json!({"message": {"content": {"type": "text", "text": "keep left"}}}),
            ),
            (
                "parts of the newer interface",
                json!({"message": {"content": [{"type": "output_text", "text": "keep left"}]}}),
            ),
            (
                "parts without a type",
                json!({"message": {"content": [{"text": "keep "}, {"text": {"value": "left"}}]}}),
            ),
            (
                "texts in a list",
                json!({"message": {"content": ["keep ", "left"]}}),
            ),
            (
                "with a reference",
                json!({"message": {"content": [{"type": "text", "text": "keep left"}, {"type": "reference", "reference_ids": [1]}]}}),
            ),
            ("older completions", json!({"text": "keep left"})),
            ("a choice that is a text", json!("keep left")),
            (
                "older completions with a null message",
                json!({"text": "keep left", "message": {"content": null}}),
            ),
        ] {
            assert_eq!(
                Said::from_choice(&choice),
                Said {
                    text: "keep left".into(),
                    ..Said::default()
                },
                "{what}"
            );
        }
    }

    #[test]
    fn reasoning_is_no_answer_under_any_name() {
        for (what, message) in [
            ("vLLM", json!({"content": null, "reasoning_content": "Hm."})),
            ("Ollama", json!({"content": "", "reasoning": "Hm."})),
            (
                "both names",
                json!({"reasoning": "Hm.", "reasoning_content": "Hm."}),
            ),
            (
                "the other is empty",
                json!({"reasoning_content": "", "reasoning": "Hm."}),
            ),
            (
                "OpenRouter",
                json!({"reasoning_details": [{"type": "reasoning.text", "text": "Hm."}]}),
            ),
            ("thinking", json!({"thinking": "Hm."})),
            ("an object", json!({"thinking": {"content": "Hm."}})),
            (
                "Mistral",
                json!({"content": [{"type": "thinking", "thinking": [{"type": "text", "text": "Hm."}]}]}),
            ),
            (
                "a plain part",
                json!({"content": [{"type": "reasoning", "text": "Hm."}]}),
            ),
        ] {
            let said = Said::from_choice(&json!({"message": message}));
            assert_eq!(
                said,
                Said {
                    reasoning: "Hm.".into(),
                    ..Said::default()
                },
                "{what}"
            );
        }
    }

    #[test]
    fn nothing_and_refusals_are_told_from_nonsense() {
        for choice in [
            json!({}),
            json!({"delta": {"role": "assistant"}}),
            json!({"message": {"content": []}}),
            json!(3),
        ] {
            assert_eq!(Said::from_choice(&choice), Said::default(), "{choice}");
        }
        for message in [
            json!({"refusal": "No."}),
            json!({"content": [{"type": "refusal", "refusal": "No."}]}),
        ] {
            assert_eq!(
                Said::from_choice(&json!({"message": message})).refusal,
                "No."
            );
        }
        for content in [
            json!(3),
            json!(-0.5),
            json!(true),
            json!({"answer": "keep"}),
        ] {
            let said = Said::from_choice(&json!({"message": {"content": content}}));
            assert_eq!(
                said.text,
                content.to_string(),
                "a value in place of its text"
            );
        }
    }
}
