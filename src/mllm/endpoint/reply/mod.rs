//! The response: a chat completion in one piece or as a stream of server-sent events, of limited
//! size.

mod events;
mod finish;
mod gathered;
mod interfaces;
mod lenient;
mod marks;
mod message;
mod thinking;
mod usage;

use crate::{EndpointFailure, FinishReason, TokenCounts};
use events::{Events, Line};
use gathered::Gathered;
pub(super) use lenient::value;
use std::io::{BufReader, Read};
use std::time::Instant;

/// Maximum bytes of a response. The longest sensible one, with a stream event for each token, takes
/// a tenth of it.
pub(super) const MAX_BYTES: u64 = 4 << 20;
/// Maximum characters of a server's text in a message.
const MAX_SHOWN: usize = 300;

/// Removes the API key from a text.
pub(super) type Hide<'a> = &'a dyn Fn(&str) -> String;

/// How an answer is passed on while it comes.
pub(super) struct Listen<'a> {
    pub(super) hide: Hide<'a>,
    /// The address of chat completions that was asked.
    pub(super) asked: &'a str,
    /// Whether the answer is passed on at its end and not in pieces.
    pub(super) whole: bool,
    pub(super) on_text: &'a mut dyn FnMut(&str),
}

/// The bytes of a response.
pub(super) trait Body: Read {
    /// Told when the answer is complete: what else comes is not worth a long wait.
    fn hurry(&mut self) {}
}

impl Body for &[u8] {}

#[derive(Debug, Clone, PartialEq)]
pub(super) struct Reply {
    pub(super) content: String,
    pub(super) finish: FinishReason,
    /// The server's counts; zero where it gives none.
    pub(super) tokens: TokenCounts,
    /// When the first text arrived; `None` if the answer came in one piece.
    pub(super) first_text: Option<Instant>,
}

/// Reads a chat completion. Its bytes say whether it is a stream: servers answer in one piece
/// though a stream was asked for, and label streams as anything.
///
/// # Errors
/// When there is no complete answer. One that is complete is kept, whatever follows it.
pub(super) fn read(body: impl Body, mut listen: Listen<'_>) -> Result<Reply, EndpointFailure> {
    let mut events = Events::new(BufReader::new(body.take(MAX_BYTES + 1)));
    let mut gathered = Gathered::default();
    loop {
        let line = match events.next() {
            Ok(line) => line,
            Err(_) if gathered.is_complete() => Line::End,
            Err(failure) => return Err(failure),
        };
        let added = match line {
            Line::Event(event) => gathered.add_event(&event, &mut listen),
            Line::Error(text) => gathered.add_error(&text, &listen),
            Line::Whole(text) => return gathered.of_whole(&text, listen),
            Line::Done => return gathered.complete(true, &mut listen),
            Line::End => return gathered.complete(false, &mut listen),
        };
        match added {
            Err(_) if gathered.is_complete() => {}
            added => added?,
        }
        if gathered.has_ended() {
            events.bytes().get_mut().get_mut().hurry();
        }
    }
}

/// The beginning of a text, which must not have the key in it.
pub(super) fn shortened(text: &str) -> String {
    match text
        .char_indices()
        .nth(MAX_SHOWN)
        .and_then(|(end, _)| text.get(..end))
    {
        None => text.to_string(),
        Some(beginning) => format!("{beginning}..."),
    }
}

#[cfg(test)]
mod tests;
