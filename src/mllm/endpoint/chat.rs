//! The request for one chat completion.

use super::grammar::{gbnf, pattern};
use super::reply::value;
use crate::{
    Constraint, ConstraintUse, EndpointSettings, GrammarField, LimitField, MllmError, Request,
    Sampling, Turn,
};
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use image::{ImageFormat, RgbImage};
use serde_json::{Deserializer, Map, Value, json};
use std::io::Cursor;

/// The member of a JSON answer with the text.
const ANSWER: &str = "answer";
/// Most places in an answer where an object is looked for.
const MAX_OBJECTS: usize = 8;
/// Mask of the seed: every server accepts positive 32-bit integers.
const SEED_BITS: u64 = 0x7fff_ffff;

/// A chat that ends with a prompt of the user.
#[derive(Debug, Clone, Copy)]
pub(super) struct Chat<'a> {
    /// The system prompt; empty for none.
    pub(super) system: &'a str,
    /// The images that prompts begin with.
    pub(super) images: &'a [TurnImage],
    pub(super) turns: &'a [Turn],
    pub(super) prompt: &'a str,
}

/// An image that the prompt of a turn begins with.
#[derive(Debug)]
pub(super) struct TurnImage {
    /// The turn, from 0.
    pub(super) turn: usize,
    /// The image as a `data:` address with a PNG.
    url: String,
}

impl TurnImage {
    pub(super) fn new(image: &RgbImage, turn: usize) -> Result<Self, MllmError> {
        let url = data_url(image)?;
        Ok(Self { turn, url })
    }
}

/// The body of a request.
pub(super) fn body(
    settings: &EndpointSettings,
    chat: &Chat<'_>,
    request: &Request,
    seed: u64,
) -> Result<Value, MllmError> {
    let mut fields = Map::new();
    let mut set = |name: &str, value: Value| fields.insert(name.to_string(), value);
    set("model", json!(settings.model));
    set("messages", messages(chat));
    let limit = match settings.limit {
        LimitField::MaxTokens => "max_tokens",
        LimitField::MaxCompletionTokens => "max_completion_tokens",
    };
    set(limit, json!(request.max_new_tokens));
    match request.sampling {
        Sampling::Greedy => {
            set("temperature", json!(0));
        }
        Sampling::Sample { temperature, top_p } => {
            set("temperature", json!(temperature));
            set("top_p", json!(top_p));
        }
    }
    set("seed", json!(seed & SEED_BITS));
    set("stream", json!(settings.stream));
    if settings.stream {
        set("stream_options", json!({"include_usage": true}));
    }
    if let Some((name, value)) = constraint_field(settings.grammar, &request.constraint)? {
        set(name, value);
    }
    // Last, so that a description can remove or replace whatever a server refuses.
    for name in &settings.omit {
        fields.remove(name);
    }
    fields.extend(settings.extra.clone());
    Ok(Value::Object(fields))
}

fn messages(chat: &Chat<'_>) -> Value {
    let mut messages = Vec::new();
    if !chat.system.is_empty() {
        messages.push(json!({"role": "system", "content": chat.system}));
    }
    let said = chat
        .turns
        .iter()
        .map(|turn| (turn.prompt.as_str(), Some(turn.answer.as_str())));
    for (index, (prompt, answer)) in said.chain([(chat.prompt, None)]).enumerate() {
        let images = chat.images.iter().filter(|image| image.turn == index);
        let images =
            images.map(|image| json!({"type": "image_url", "image_url": {"url": image.url}}));
        let mut parts: Vec<Value> = images.collect();
        let content = if parts.is_empty() {
            json!(prompt)
        } else {
            parts.push(json!({"type": "text", "text": prompt}));
            Value::Array(parts)
        };
        messages.push(json!({"role": "user", "content": content}));
        if let Some(answer) = answer {
            messages.push(json!({"role": "assistant", "content": answer}));
        }
    }
    Value::Array(messages)
}

/// The field that carries the constraint; `None` where there is nothing to send.
fn constraint_field(
    field: GrammarField,
    constraint: &Constraint,
) -> Result<Option<(&'static str, Value)>, MllmError> {
    if *constraint == Constraint::Free {
        return Ok(None);
    }
    let fail = |problem: String| MllmError::Grammar {
        constraint: format!("{constraint:?}"),
        problem,
    };
    // One match: an arm is a row of docs/endpoint.md, with the form that its servers take.
    Ok(match field {
        GrammarField::None => None,
        GrammarField::Gbnf => Some(("grammar", json!(gbnf(constraint).map_err(fail)?))),
        GrammarField::JsonSchema => Some((
            "response_format",
            json_schema(&pattern(constraint).map_err(fail)?),
        )),
        GrammarField::StructuredOutputs => Some((
            "structured_outputs",
            json!({"regex": pattern(constraint).map_err(fail)?}),
        )),
        GrammarField::GuidedRegex => {
            Some(("guided_regex", json!(pattern(constraint).map_err(fail)?)))
        }
        GrammarField::Regex => Some(("regex", json!(pattern(constraint).map_err(fail)?))),
        GrammarField::TaggedRegex => Some((
            "grammar",
            json!({"type": "regex", "value": pattern(constraint).map_err(fail)?}),
        )),
    })
}

/// A schema of an object with one string of this pattern: `OpenAI` accepts only objects.
fn json_schema(pattern: &str) -> Value {
    json!({"type": "json_schema", "json_schema": {"name": ANSWER, "strict": true, "schema": {
        "type": "object",
        "properties": {ANSWER: {"type": "string", "pattern": format!("^{pattern}$")}},
        "required": [ANSWER],
        "additionalProperties": false,
    }}})
}

/// The text of an answer. A JSON answer has it in a member.
pub(super) fn text(
    settings: &EndpointSettings,
    constraint: &Constraint,
    content: String,
) -> String {
    if settings.grammar != GrammarField::JsonSchema || *constraint == Constraint::Free {
        return content;
    }
    member_of(&content).unwrap_or(content)
}

/// The text in a JSON answer, around which models like to put a fence of Markdown or words.
fn member_of(content: &str) -> Option<String> {
    let member = |value: &Value| value.get(ANSWER)?.as_str().map(ToString::to_string);
    if let Ok(value) = value(without_fence(content)) {
        return member(&value);
    }
    let begins = content.match_indices('{').take(MAX_OBJECTS);
    let mut rests = begins.filter_map(|(at, _)| content.get(at..));
    rests.find_map(|rest| {
        let first = Deserializer::from_str(rest).into_iter().next()?.ok()?;
        member(&first)
    })
}

/// A text without the fence of Markdown around it, which models like around JSON.
fn without_fence(text: &str) -> &str {
    let inside = text
        .trim()
        .strip_prefix("```")
        .and_then(|rest| rest.strip_suffix("```"));
    inside.map_or(text, |inside| inside.strip_prefix("json").unwrap_or(inside))
}

/// Checks the answer against the constraint.
pub(super) fn constraint_use(
    settings: &EndpointSettings,
    constraint: &Constraint,
    text: &str,
) -> ConstraintUse {
    if *constraint == Constraint::Free {
        return ConstraintUse::Unconstrained;
    }
    if settings.grammar == GrammarField::None {
        return ConstraintUse::NotSent;
    }
    let whole = pattern(constraint)
        .ok()
        .and_then(|pattern| regex::Regex::new(&format!("^(?:{pattern})$")).ok());
    if whole.is_some_and(|whole| whole.is_match(text)) {
        ConstraintUse::Satisfied
    } else {
        ConstraintUse::Violated
    }
}

/// An image as a `data:` address with a PNG.
fn data_url(image: &RgbImage) -> Result<String, MllmError> {
    let mut png = Cursor::new(Vec::new());
    image
        .write_to(&mut png, ImageFormat::Png)
        .map_err(|error| MllmError::Image {
            problem: error.to_string(),
        })?;
    Ok(format!(
        "data:image/png;base64,{}",
        BASE64_STANDARD.encode(png.into_inner())
    ))
}

#[cfg(test)]
mod fence_tests {
    use super::{member_of, without_fence};

    #[test]
    fn json_is_read_inside_a_fence() {
        for text in [
            "{\"a\": 1}",
            "```json\n{\"a\": 1}\n```",
            " ```\n{\"a\": 1}```\n",
        ] {
            assert_eq!(without_fence(text).trim(), "{\"a\": 1}", "{text:?}");
        }
        assert_eq!(without_fence("```json"), "```json");
    }

    #[test]
    fn the_text_of_a_json_answer_is_found_among_words() {
        for text in [
            "{\"answer\": \"keep\"}",
            "Here it is:\n```json\n{\"answer\": \"keep\"}\n```\nDone.",
            "The {lane} is free. {\"answer\": \"keep\"} {\"answer\": \"left\"}",
        ] {
            assert_eq!(member_of(text).as_deref(), Some("keep"), "{text}");
        }
        assert_eq!(member_of("{\"answer\": \"a\nb\"}").as_deref(), Some("a\nb"));
        for text in ["keep", "{\"other\": \"keep\"}", "{", "{\"answer\": 3}"] {
            assert_eq!(member_of(text), None, "{text}");
        }
    }
}
