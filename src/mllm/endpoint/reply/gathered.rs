//! The answer so far, from a body in one piece or from the events of a stream.

use super::finish::Ending;
use super::interfaces::{Interface, interface_of};
use super::lenient::{readable, value};
use super::marks::{bare, settled};
use super::message::{Said, is_message};
use super::thinking::Reader;
use super::usage::counts;
use super::{Listen, Reply, shortened};
use crate::endpoint::trouble::{Trouble, in_words};
use crate::{EndpointFailure, FinishReason, TokenCounts};
use serde_json::{Deserializer, Value};
use std::time::Instant;

/// What to do against an answer that stands in the reasoning.
const ALL_REASONING: &str = "the content is empty and the text is all in the reasoning; switch the model's thinking off, \
    set the server's reasoning parser for this model, or raise generation.max_new_tokens (docs/endpoint.md)";

#[derive(Debug, Default)]
pub(super) struct Gathered {
    content: Reader,
    reasoning: String,
    refusal: String,
    ending: Option<Ending>,
    tokens: TokenCounts,
    first_text: Option<Instant>,
    /// What was passed on of the answer.
    told: String,
    /// Whether a message was seen, perhaps without text.
    chosen: bool,
    /// Whether a tool was called.
    called: bool,
    /// The first event that is no JSON, such as a word that keeps the connection open.
    odd: Option<String>,
    /// The other interface that the reply is of.
    other: Option<&'static Interface>,
}

impl Gathered {
    /// Whether the answer has all its text. What follows can add counts, and nothing can take the
    /// answer away.
    pub(super) fn is_complete(&self) -> bool {
        matches!(self.ending, Some(Ending::Answer(_))) && !self.content().is_empty()
    }

    /// Whether the server named a reason to end.
    pub(super) fn has_ended(&self) -> bool {
        self.ending.is_some()
    }

    /// The content so far, with reasoning that is inside of it.
    fn content(&self) -> &str {
        self.content.content()
    }

    fn has_text(&self) -> bool {
        !self.content().is_empty() || !self.reasoning.is_empty()
    }

    /// Adds the data of an event.
    pub(super) fn add_event(
        &mut self,
        event: &str,
        listen: &mut Listen<'_>,
    ) -> Result<(), EndpointFailure> {
        match value(event) {
            Ok(value) => self.add(&value, listen),
            // Of broken JSON a part of the answer may be lost.
            Err(error) if event.starts_with(['{', '[']) => Err(EndpointFailure::InvalidReply(
                no_json(event, &error, listen),
            )),
            Err(error) => {
                self.odd
                    .get_or_insert_with(|| no_json(event, &error, listen));
                Ok(())
            }
        }
    }

    /// Adds an event of the type `error`.
    pub(super) fn add_error(&self, text: &str, listen: &Listen<'_>) -> Result<(), EndpointFailure> {
        let error = serde_json::from_str(text).unwrap_or_else(|_| Value::String(text.to_owned()));
        let reply = if error.get("error").is_some() {
            error
        } else {
            serde_json::json!({ "error": error })
        };
        Trouble::in_reply(&reply).map_or(Ok(()), |trouble| Err(self.broken_by(trouble, listen)))
    }

    /// The answer of a body in one piece, or of lines of JSON.
    pub(super) fn of_whole(
        mut self,
        text: &str,
        mut listen: Listen<'_>,
    ) -> Result<Reply, EndpointFailure> {
        for value in Deserializer::from_str(&readable(text)).into_iter::<Value>() {
            match value
                .map_err(|error| EndpointFailure::InvalidReply(no_json(text, &error, &listen)))
                .and_then(|value| self.add(&value, &mut listen))
            {
                Err(_) if self.is_complete() => break,
                added => added?,
            }
        }
        self.first_text = None;
        if self.chosen && (self.ending.is_some() || self.has_text()) {
            return self.complete(true, &mut listen);
        }
        let shown = shortened(&(listen.hide)(text));
        Err(EndpointFailure::InvalidReply(self.other.map_or_else(
            || format!("no finished choice in '{shown}'"),
            |other| other.told(listen.asked),
        )))
    }

    fn add(&mut self, part: &Value, listen: &mut Listen<'_>) -> Result<(), EndpointFailure> {
        if let Value::Array(parts) = part {
            return parts.iter().try_for_each(|part| self.add(part, listen));
        }
        if let Some(inner) = inner_text(part) {
            return self.add(&inner, listen);
        }
        let part = unwrapped(part);
        let choice = choice_of(part);
        if let Some(trouble) = Trouble::in_reply(part)
            && !choice.is_some_and(is_whole)
        {
            return Err(self.broken_by(trouble, listen));
        }
        if !part.is_object() {
            let shown = shortened(&(listen.hide)(&part.to_string()));
            return Err(EndpointFailure::InvalidReply(format!(
                "expected an object, found '{shown}'"
            )));
        }
        if let Some(tokens) = counts(part) {
            self.tokens = tokens;
        }
        if let Some(choice) = choice {
            self.add_choice(choice, listen);
            return Ok(());
        }
        self.other = self.other.or_else(|| interface_of(part));
        Ok(())
    }

    fn add_choice(&mut self, choice: &Value, listen: &mut Listen<'_>) {
        let said = Said::from_choice(choice);
        self.chosen |= choice.is_string()
            || ["delta", "message", "messages", "text"]
                .iter()
                .any(|name| choice.get(name).is_some());
        if !said.text.is_empty() || !said.reasoning.is_empty() {
            self.first_text.get_or_insert_with(Instant::now);
        }
        // A whole message at the end of a stream repeats its pieces.
        let repeats = is_message(choice)
            && choice.get("done").is_none()
            && !self.content().is_empty()
            && said.text.starts_with(self.content());
        if repeats {
            self.content = Reader::default();
        }
        self.content.push(&said.text);
        self.reasoning.push_str(&said.reasoning);
        self.refusal.push_str(&said.refusal);
        self.called |= said.called;
        self.ending = Ending::from_choice(choice).or(self.ending.take());
        if !listen.whole
            && let Some(text) = self.content.known()
            && let Some(piece) = settled(text).get(self.told.len()..)
            && !piece.is_empty()
        {
            (listen.on_text)(piece);
            self.told.push_str(piece);
        }
    }

    /// The answer at the end of the bytes; `marked` says that the server marked this end.
    pub(super) fn complete(
        mut self,
        marked: bool,
        listen: &mut Listen<'_>,
    ) -> Result<Reply, EndpointFailure> {
        let hide = listen.hide;
        let shown = |text: &str| shortened(&hide(text));
        if !self.refusal.trim().is_empty() {
            return Err(EndpointFailure::Withheld(format!(
                "the model refuses: {}",
                shown(self.refusal.trim())
            )));
        }
        if let Some(other) = self.other
            && !self.chosen
        {
            return Err(EndpointFailure::InvalidReply(other.told(listen.asked)));
        }
        let finish = self.finish(marked, &shown)?;
        if self.called && self.content().trim().is_empty() {
            Ending::Tools("tool_calls".to_owned()).reason(&shown)?;
        }
        let found = std::mem::take(&mut self.content).finish();
        let reasoned = found.reasoned || !self.reasoning.trim().is_empty();
        if found.text.trim().is_empty() && reasoned {
            return Err(EndpointFailure::NoAnswer(ALL_REASONING.to_owned()));
        }
        let text = bare(&found.text);
        // Only the whole answer: an event may end within the key.
        let content = hide(text);
        // What may have been the beginning of a mark was not passed on yet. What was passed on stays
        // where it is, also if it was reasoning whose end came late.
        let rest = if listen.whole {
            Some(content.as_str())
        } else {
            text.strip_prefix(self.told.as_str())
        };
        if let Some(rest) = rest.filter(|rest| !rest.is_empty()) {
            (listen.on_text)(rest);
        }
        Ok(Reply {
            content,
            finish,
            tokens: self.tokens,
            first_text: self.first_text,
        })
    }

    /// Why the answer ended.
    fn finish(
        &self,
        marked: bool,
        shown: &dyn Fn(&str) -> String,
    ) -> Result<FinishReason, EndpointFailure> {
        match &self.ending {
            // Some servers name tools at the end of every answer of a model that knows some.
            Some(Ending::Tools(_)) if !self.called && !self.content().trim().is_empty() => {
                Ok(FinishReason::EndOfSequence)
            }
            Some(ending) => ending.reason(shown),
            // Some servers name no reason.
            None if marked && self.has_text() => Ok(FinishReason::EndOfSequence),
            None => Err(match &self.odd {
                Some(odd) if !self.has_text() => EndpointFailure::InvalidReply(odd.clone()),
                _ => EndpointFailure::Closed("the stream ended before the answer".into()),
            }),
        }
    }

    /// The failure of a server: a refusal at the beginning, and a broken answer after it.
    fn broken_by(&self, trouble: Trouble, listen: &Listen<'_>) -> EndpointFailure {
        let failure = trouble.failure(listen.hide);
        if self.has_text() {
            EndpointFailure::Closed(failure.to_string())
        } else {
            failure
        }
    }
}

/// A completion that stands as a text in another reply, as behind functions of a cloud.
fn inner_text(part: &Value) -> Option<Value> {
    if part.get("choices").is_some() {
        return None;
    }
    let text = part.as_str().or_else(|| part.get("body")?.as_str())?;
    value(text)
        .ok()
        .filter(|inner| inner.get("choices").is_some())
}

/// A completion without what a gateway wraps it into.
fn unwrapped(part: &Value) -> &Value {
    if part.get("choices").is_some() {
        return part;
    }
    // The last is a line of a file of batches.
    let inner = [
        "/data",
        "/result",
        "/output",
        "/response",
        "/body",
        "/response/body",
    ];
    inner
        .iter()
        .filter_map(|place| part.pointer(place))
        .find(|inner| inner.get("choices").is_some_and(Value::is_array))
        .unwrap_or(part)
}

/// The first choice of a completion. Ollama's own interface has its only one beside the counts.
fn choice_of(part: &Value) -> Option<&Value> {
    let is_own = || part.get("message").is_some_and(Value::is_object) && part.get("done").is_some();
    match part.get("choices") {
        Some(Value::Array(choices)) => choices.iter().find(|choice| !choice.is_null()),
        Some(choice @ Value::Object(_)) => Some(choice),
        _ => is_own().then_some(part),
    }
}

/// Whether a choice is an answer and its end, which no error beside it takes away.
fn is_whole(choice: &Value) -> bool {
    !Said::from_choice(choice).text.is_empty()
        && matches!(Ending::from_choice(choice), Some(Ending::Answer(_)))
}

/// What is wrong with a text that is no JSON.
fn no_json(text: &str, error: &serde_json::Error, listen: &Listen<'_>) -> String {
    let shown = |text: &str| shortened(&(listen.hide)(text));
    match in_words(text) {
        page if page != text => shown(&page),
        _ => format!("{} in '{}'", shown(&error.to_string()), shown(text)),
    }
}
