//! What a server says about a failure, in every form, and whether a later request can succeed.

use crate::EndpointFailure;
use crate::endpoint::reply::{Hide, MAX_BYTES, shortened};
use reqwest::StatusCode;
use serde_json::Value;
use std::io::Read;

/// Members with the words of a failure, in the order in which they are looked for.
const WORDS: [&str; 11] = [
    "message",
    "msg",
    "status_msg",
    "error",
    "detail",
    "errors",
    "description",
    "error_description",
    "title",
    "reason",
    "status",
];
/// How deep the words may lie.
const MAX_DEPTH: usize = 5;
/// Most failures that are named of a list.
const MAX_LISTED: usize = 3;
/// Types and codes of errors that pass, for servers that give no status.
const PASSING: [&str; 14] = [
    "server_error",
    "internal_server_error",
    "internal_error",
    "internalservererror",
    "api_error",
    "overloaded_error",
    "server_overloaded",
    "rate_limit_error",
    "rate_limit_exceeded",
    "unavailable_error",
    "service_unavailable",
    "unavailable",
    "resource_exhausted",
    "timeout",
];
/// Words of failures that no retry mends, though their status is 429 or 5xx: quotas of `OpenAI`;
/// llama.cpp's server without a vision part, with a grammar or a template that it cannot use, with
/// a prompt that is too long.
const LASTING: [&str; 11] = [
    "insufficient_quota",
    "exceeded your current quota",
    "billing_hard_limit",
    "image input is not supported",
    "does not support image",
    "required for image input",
    "failed to parse grammar",
    "exceeds the available context size",
    "system role not supported",
    "roles must alternate",
    "only user and assistant roles",
];

/// A failure in a server's words.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Trouble {
    message: String,
    /// The status, or the code of an error in a reply with status 200.
    status: u16,
    /// Whether only the type of the error says that it passes.
    passing: bool,
    lasting: bool,
}

impl Trouble {
    /// The failure in a reply with status 200, if it is one. A complete answer is none, whatever
    /// stands beside it.
    pub(super) fn in_reply(reply: &Value) -> Option<Self> {
        // Gemini sends a list.
        let reply = reply
            .as_array()
            .and_then(|list| list.first())
            .unwrap_or(reply);
        let choice = reply.pointer("/choices/0");
        let error = reply
            .get("error")
            .or_else(|| choice.and_then(|choice| choice.get("error")))
            .filter(|e| is_said(e));
        if let Some(error) = error {
            return Some(Self::from_reply(StatusCode::OK.as_u16(), error, reply));
        }
        // `MiniMax` puts a failure beside the answer, which is null then.
        if let Some(base) = reply.get("base_resp").filter(|_| choice.is_none()) {
            return Some(Self::from_reply(StatusCode::OK.as_u16(), base, reply));
        }
        let kind = ["object", "type"]
            .iter()
            .any(|name| reply.get(name).and_then(Value::as_str) == Some("error"));
        let names = ["detail", "errors", "message", "msg"];
        let told = choice.is_none()
            && names
                .iter()
                .filter_map(|name| reply.get(name))
                .any(|told| is_said(told) && !told.is_object());
        (kind || told).then(|| Self::from_reply(StatusCode::OK.as_u16(), reply, reply))
    }

    /// The failure behind an error status.
    pub(super) fn behind(status: StatusCode, body: impl Read) -> Self {
        let mut bytes = Vec::new();
        // The status is the error; an unreadable explanation adds none.
        let _ = body.take(MAX_BYTES).read_to_end(&mut bytes);
        let text = String::from_utf8_lossy(&bytes);
        match serde_json::from_str::<Value>(&text) {
            Ok(value) if is_said(&value) => {
                let whole = value
                    .as_array()
                    .and_then(|list| list.first())
                    .filter(|first| first.is_object())
                    .unwrap_or(&value);
                let error = whole
                    .get("error")
                    .filter(|error| error.is_object())
                    .unwrap_or(whole);
                Self::from_reply(status.as_u16(), error, whole)
            }
            _ => {
                let text = in_words(text.trim());
                let message = if text.is_empty() {
                    status.canonical_reason().unwrap_or("no reason").to_owned()
                } else {
                    text
                };
                Self {
                    lasting: lasts(&message),
                    message,
                    status: status.as_u16(),
                    passing: false,
                }
            }
        }
    }

    fn from_reply(status: u16, error: &Value, whole: &Value) -> Self {
        let message = message(error, 0).unwrap_or_else(|| error.to_string());
        let names = ["code", "type", "status"];
        let mut kinds = [error, whole]
            .into_iter()
            .flat_map(|part| names.iter().filter_map(|name| part.get(name)));
        let lasting = lasts(&message) || kinds.clone().filter_map(Value::as_str).any(lasts);
        let passes = |kind: &Value| {
            kind.as_str()
                .is_some_and(|kind| PASSING.contains(&kind.to_ascii_lowercase().as_str()))
        };
        let passing = status == 200 && kinds.clone().any(passes);
        let code = kinds.find_map(number).filter(|_| status == 200);
        Self {
            message,
            status: code.unwrap_or(status),
            passing,
            lasting,
        }
    }

    /// The failure, whose text has neither the API key nor more than is read at a glance.
    pub(super) fn failure(self, hide: Hide<'_>) -> EndpointFailure {
        let Self {
            message,
            status,
            passing,
            lasting,
        } = self;
        let loads = loads(status, &message);
        let message = shortened(&hide(message.trim()));
        if loads {
            EndpointFailure::Loading {
                status,
                message,
                waited: std::time::Duration::ZERO,
            }
        } else if !lasting && (passing || passes(status)) {
            EndpointFailure::Unavailable { status, message }
        } else {
            EndpointFailure::Refused { status, message }
        }
    }
}

/// Whether the same request may succeed after this status: a time limit, a lock, a limit of
/// requests, a fault of the server. A server that does not implement something will not do so
/// later.
fn passes(status: u16) -> bool {
    matches!(status, 408 | 409 | 425 | 429 | 500 | 502..=504 | 506..=599)
}

/// Whether a server says that it loads its model. One that failed to load it says so too, and will
/// not be ready later.
fn loads(status: u16, message: &str) -> bool {
    let plain = message.to_ascii_lowercase();
    let loading = [
        "loading model",
        "model is loading",
        "model loading",
        "currently loading",
        "still loading",
        "loading the model",
        "loading weights",
        "being loaded",
        "not yet loaded",
        "not loaded yet",
    ];
    // Other states of a server that will serve, where its status says so too.
    let starting = [
        "warming up",
        "starting up",
        "is starting",
        "initializing",
        "not ready",
    ];
    let failed = ["error", "fail", "unable", "cannot"];
    let says = |words: &[&str]| words.iter().any(|words| plain.contains(words));
    (passes(status) && says(&loading) || status == 503 && says(&starting)) && !says(&failed)
}

fn lasts(text: &str) -> bool {
    let plain = text.to_ascii_lowercase();
    let no_model = ["not found", "does not exist", "no available channel"];
    if plain.contains("model") && no_model.iter().any(|words| plain.contains(words)) {
        return true;
    }
    LASTING.iter().any(|words| plain.contains(words))
}

/// A status in a member: a number, or its digits.
fn number(code: &Value) -> Option<u16> {
    let number = code
        .as_u64()
        .or_else(|| code.as_str().and_then(|digits| digits.parse().ok()))?;
    u16::try_from(number)
        .ok()
        .filter(|code| (400..600).contains(code))
}

/// Whether a member says anything: servers write null, false, an empty text or an empty object for
/// no error.
fn is_said(value: &Value) -> bool {
    match value {
        Value::Null | Value::Bool(_) => false,
        // Gateways write the code 0 where nothing failed.
        Value::Number(code) => code.as_f64() != Some(0.0),
        Value::String(text) => !text.trim().is_empty(),
        Value::Array(items) => items.iter().any(is_said),
        Value::Object(fields) => fields.values().any(is_said),
    }
}

/// The words of an error: a text, or those of a member.
fn message(error: &Value, depth: usize) -> Option<String> {
    match error {
        _ if depth > MAX_DEPTH => None,
        Value::String(text) if !text.trim().is_empty() => Some(text.clone()),
        Value::Array(errors) => {
            let told: Vec<String> = errors
                .iter()
                .filter_map(|error| message(error, depth + 1))
                .take(MAX_LISTED)
                .collect();
            (!told.is_empty()).then(|| told.join("; "))
        }
        Value::Object(fields) => {
            let words = WORDS
                .iter()
                .filter_map(|name| fields.get(*name))
                .find_map(|words| message(words, depth + 1))?;
            // FastAPI names the place of a wrong field.
            let place = fields.get("loc").and_then(Value::as_array).map(|place| {
                let parts = place.iter().map(|part| {
                    part.as_str()
                        .map_or_else(|| part.to_string(), ToOwned::to_owned)
                });
                parts.collect::<Vec<_>>().join(".")
            });
            Some(place.map_or(words.clone(), |place| format!("{place}: {words}")))
        }
        _ => None,
    }
}

/// A web page by its title, any other text as it is.
pub(super) fn in_words(text: &str) -> String {
    let plain = text.to_ascii_lowercase();
    let title = plain.find("<title>").zip(plain.find("</title>"));
    // Lower case of ASCII letters moves no byte.
    match title.and_then(|(from, to)| text.get(from + "<title>".len()..to)) {
        Some(title) if plain.trim_start().starts_with('<') => {
            format!("a web page, '{}'", title.trim())
        }
        _ => text.to_owned(),
    }
}

#[cfg(test)]
mod tests;
