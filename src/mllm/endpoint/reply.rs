//! The response: a chat completion in one piece or as a stream of server-sent events, of limited size.

use std::io::{BufRead, BufReader, Read};
use std::time::Instant;

use serde::Deserialize;

use crate::{EndpointFailure, FinishReason, TokenCounts};

/// Maximum bytes of a response. The longest sensible one, with a stream event for each token, takes a tenth of it.
pub(super) const MAX_BYTES: u64 = 4 << 20;
/// Maximum characters of a server's text in a message.
const MAX_SHOWN: usize = 300;

/// Removes the API key from a text.
pub(super) type Hide<'a> = &'a dyn Fn(&str) -> String;

/// How an answer is passed on while it comes.
pub(super) struct Listen<'a> {
    pub(super) hide: Hide<'a>,
    /// Whether the answer is passed on at its end and not in pieces.
    pub(super) whole: bool,
    pub(super) on_text: &'a mut dyn FnMut(&str),
}

#[derive(Debug, Clone, PartialEq)]
pub(super) struct Reply {
    pub(super) content: String,
    pub(super) finish: FinishReason,
    /// The server's counts; zero where it gives none.
    pub(super) tokens: TokenCounts,
    /// When the first text arrived; `None` if the answer came in one piece.
    pub(super) first_text: Option<Instant>,
}

/// A chat completion, or an event of a streamed one.
#[derive(Debug, Deserialize)]
struct Completion {
    #[serde(default)]
    choices: Vec<Choice>,
    usage: Option<Usage>,
    error: Option<serde_json::Value>,
}

#[derive(Debug, Deserialize)]
struct Choice {
    #[serde(alias = "delta")]
    message: Option<Message>,
    finish_reason: Option<String>,
}

#[derive(Debug, Default, Deserialize)]
struct Message {
    content: Option<String>,
    refusal: Option<String>,
}

#[derive(Debug, Deserialize)]
struct Usage {
    #[serde(default)]
    prompt_tokens: usize,
    #[serde(default)]
    completion_tokens: usize,
    prompt_tokens_details: Option<PromptTokens>,
}

#[derive(Debug, Deserialize)]
struct PromptTokens {
    cached_tokens: Option<usize>,
}

impl From<&Usage> for TokenCounts {
    fn from(usage: &Usage) -> Self {
        let cached = usage.prompt_tokens_details.as_ref().and_then(|details| details.cached_tokens).unwrap_or(0);
        Self {
            text: usage.prompt_tokens.saturating_sub(cached),
            image: 0,
            cached: cached.min(usage.prompt_tokens),
            fast_forwarded: 0,
            sampled: usage.completion_tokens,
            drafted: 0,
            accepted: 0,
        }
    }
}

/// The answer so far.
#[derive(Debug, Default)]
struct Gathered {
    content: String,
    finish: Option<FinishReason>,
    tokens: TokenCounts,
    first_text: Option<Instant>,
}

impl Gathered {
    fn add(&mut self, text: &str, listen: &mut Listen<'_>) -> Result<(), EndpointFailure> {
        let invalid = |problem: String| EndpointFailure::InvalidReply(problem);
        let hide = listen.hide;
        let shown = |text: &str| shortened(&hide(text));
        let part: Completion = serde_json::from_str(text)
            .map_err(|error| invalid(format!("{} in '{}'", shown(&error.to_string()), shown(text))))?;
        if let Some(error) = part.error {
            return Err(invalid(message_of(&error, hide)));
        }
        if let Some(usage) = &part.usage {
            self.tokens = usage.into();
        }
        let Some(choice) = part.choices.into_iter().next() else { return Ok(()) };
        let message = choice.message.unwrap_or_default();
        if let Some(refusal) = message.refusal.filter(|refusal| !refusal.is_empty()) {
            return Err(invalid(format!("the model refuses: {}", shown(&refusal))));
        }
        if let Some(content) = message.content.filter(|content| !content.is_empty()) {
            self.first_text.get_or_insert_with(Instant::now);
            self.content.push_str(&content);
            if !listen.whole {
                (listen.on_text)(&content);
            }
        }
        self.finish = match choice.finish_reason.as_deref() {
            None => self.finish,
            Some("stop") => Some(FinishReason::EndOfSequence),
            Some("length") => Some(FinishReason::Length),
            Some(other) => return Err(invalid(format!("unknown finish_reason '{}'", shown(other)))),
        };
        Ok(())
    }

    /// The complete answer; `None` before its finish reason arrived.
    fn complete(self, listen: &mut Listen<'_>) -> Option<Reply> {
        let Self { content, finish, tokens, first_text } = self;
        // Only the whole answer: an event may end within the key.
        let (finish, content) = (finish?, (listen.hide)(&content));
        if listen.whole && !content.is_empty() {
            (listen.on_text)(&content);
        }
        Some(Reply { content, finish, tokens, first_text })
    }
}

/// Reads a chat completion in one piece.
pub(super) fn read_whole(body: impl Read, mut listen: Listen<'_>) -> Result<Reply, EndpointFailure> {
    let mut bytes = Vec::new();
    body.take(MAX_BYTES + 1).read_to_end(&mut bytes).map_err(|error| incomplete(&error))?;
    if bytes.len() as u64 > MAX_BYTES {
        return Err(EndpointFailure::TooLong(MAX_BYTES));
    }
    let text = String::from_utf8_lossy(&bytes);
    let mut gathered = Gathered::default();
    gathered.add(&text, &mut listen)?;
    gathered.first_text = None;
    let unfinished = format!("no finished choice in '{}'", shortened(&(listen.hide)(&text)));
    gathered.complete(&mut listen).ok_or(EndpointFailure::InvalidReply(unfinished))
}

/// Reads a streamed chat completion. `on_text` gets its pieces.
///
/// # Errors
/// As [`read_whole`]; a stream without the end of the answer is incomplete.
pub(super) fn read_stream(body: impl Read, mut listen: Listen<'_>) -> Result<Reply, EndpointFailure> {
    let mut lines = BufReader::new(body.take(MAX_BYTES + 1));
    let mut gathered = Gathered::default();
    let mut read = 0;
    let mut line = Vec::new();
    loop {
        line.clear();
        let length = lines.read_until(b'\n', &mut line).map_err(|error| incomplete(&error))?;
        read += length as u64;
        if read > MAX_BYTES {
            return Err(EndpointFailure::TooLong(MAX_BYTES));
        }
        // Other fields and comments, which keep the connection open, carry no text.
        let text = String::from_utf8_lossy(&line);
        match text.strip_prefix("data:").map(str::trim) {
            Some("[DONE]") => break,
            Some(event) if !event.is_empty() => gathered.add(event, &mut listen)?,
            _ if length == 0 => break,
            _ => {}
        }
    }
    gathered.complete(&mut listen).ok_or_else(|| EndpointFailure::Closed("the stream ended before the answer".into()))
}

/// The message of an error response: that of `OpenAI`'s error object, else the beginning of the body.
pub(super) fn error_message(body: impl Read, hide: Hide<'_>) -> String {
    let mut bytes = Vec::new();
    // The status is the error; an unreadable explanation adds none.
    let _ = body.take(MAX_BYTES).read_to_end(&mut bytes);
    let text = String::from_utf8_lossy(&bytes);
    match serde_json::from_str::<Completion>(&text) {
        Ok(Completion { error: Some(error), .. }) => message_of(&error, hide),
        _ => shortened(&hide(text.trim())),
    }
}

fn message_of(error: &serde_json::Value, hide: Hide<'_>) -> String {
    let message = error.get("message").unwrap_or(error);
    shortened(&hide(&message.as_str().map_or_else(|| message.to_string(), ToString::to_string)))
}

fn incomplete(error: &std::io::Error) -> EndpointFailure {
    let timed_out = |error: &(dyn std::error::Error + Send + Sync + 'static)| {
        error.downcast_ref::<reqwest::Error>().is_some_and(reqwest::Error::is_timeout)
    };
    match error.get_ref() {
        // The caller sets the limit.
        Some(inner) if timed_out(inner) => EndpointFailure::Timeout(std::time::Duration::ZERO),
        _ => EndpointFailure::Closed(error.to_string()),
    }
}

/// The beginning of a text, which must not have the key in it.
pub(super) fn shortened(text: &str) -> String {
    match text.char_indices().nth(MAX_SHOWN) {
        None => text.to_string(),
        Some((end, _)) => format!("{}...", &text[..end]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_whole_completion_is_read() {
        let body = r#"{"id": "x", "choices": [{"index": 0, "message": {"role": "assistant", "content": "keep"},
            "finish_reason": "length"}], "usage": {"prompt_tokens": 12, "completion_tokens": 3, "total_tokens": 15,
            "prompt_tokens_details": {"cached_tokens": 8}}}"#;
        let reply =
            read_whole(body.as_bytes(), Listen { hide: &str::to_owned, whole: false, on_text: &mut |_| () }).unwrap();
        assert_eq!((reply.content.as_str(), reply.finish), ("keep", FinishReason::Length));
        assert_eq!(reply.tokens, TokenCounts { text: 4, cached: 8, sampled: 3, ..TokenCounts::default() });
        assert_eq!(reply.first_text, None);
    }

    #[test]
    fn a_stream_is_gathered_over_comments_and_empty_choices() {
        let body = ": ping\r\n\r\ndata: {\"choices\":[{\"delta\":{\"role\":\"assistant\",\"content\":\"\"}}]}\n\n\
            data: {\"choices\":[{\"delta\":{\"content\":\"ke\"},\"finish_reason\":null}]}\n\nevent: x\n\
            data:{\"choices\":[{\"delta\":{\"content\":\"ep\"}}]}\n\n\
            data: {\"choices\":[{\"delta\":{},\"finish_reason\":\"stop\"}]}\n\n\
            data: {\"choices\":[],\"usage\":{\"prompt_tokens\":5,\"completion_tokens\":2}}\n\ndata: [DONE]\n\n";
        let reply =
            read_stream(body.as_bytes(), Listen { hide: &str::to_owned, whole: false, on_text: &mut |_| () }).unwrap();
        assert_eq!((reply.content.as_str(), reply.finish), ("keep", FinishReason::EndOfSequence));
        assert_eq!((reply.tokens.text, reply.tokens.sampled), (5, 2));
        assert!(reply.first_text.is_some());
    }

    #[test]
    fn nonsense_and_broken_answers_are_told_apart() {
        let whole = |body: &str| {
            read_whole(body.as_bytes(), Listen { hide: &str::to_owned, whole: false, on_text: &mut |_| () })
                .unwrap_err()
        };
        for invalid in ["", "<html>", "[]", "{}", r#"{"choices": []}"#, r#"{"choices": [{"message": {"content": 3}}]}"#]
        {
            assert!(matches!(whole(invalid), EndpointFailure::InvalidReply(_)), "{invalid}");
        }
        let refusal = r#"{"choices":[{"message":{"refusal":"I cannot"},"finish_reason":"stop"}]}"#;
        assert!(whole(refusal).to_string().contains("I cannot"));
        let stream = |body: &str| {
            read_stream(body.as_bytes(), Listen { hide: &str::to_owned, whole: false, on_text: &mut |_| () })
                .unwrap_err()
        };
        let cut = "data: {\"choices\":[{\"delta\":{\"content\":\"ke\"}}]}\n\n";
        assert!(matches!(stream(cut), EndpointFailure::Closed(_)));
        assert!(
            matches!(stream("data: {\"error\":{\"message\":\"no\"}}\n"), EndpointFailure::InvalidReply(m) if m == "no")
        );
    }

    #[test]
    fn an_endless_answer_is_not_read_to_its_end() {
        let endless = std::io::repeat(b' ');
        assert_eq!(
            read_whole(endless, Listen { hide: &str::to_owned, whole: false, on_text: &mut |_| () }).unwrap_err(),
            EndpointFailure::TooLong(MAX_BYTES)
        );
        let endless = std::io::repeat(b'\n');
        assert_eq!(
            read_stream(endless, Listen { hide: &str::to_owned, whole: false, on_text: &mut |_| () }).unwrap_err(),
            EndpointFailure::TooLong(MAX_BYTES)
        );
    }

    #[test]
    fn errors_are_told_in_the_servers_words() {
        let message = |body: &[u8]| error_message(body, &str::to_owned);
        assert_eq!(message(br#"{"error": {"message": "no such model", "code": 404}}"#), "no such model");
        assert_eq!(message(br#"{"error": "busy"}"#), "busy");
        assert_eq!(message(b" Bad gateway\n"), "Bad gateway");
        assert_eq!(message("x".repeat(1000).as_bytes()).len(), MAX_SHOWN + 3);
    }
}
