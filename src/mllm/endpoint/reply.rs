//! What comes back: a chat completion in one piece or as a stream of server-sent events, read up to a limit.

use std::io::{BufRead, BufReader, Read};
use std::time::Instant;

use serde::Deserialize;

use crate::mllm::{EndpointFailure, FinishReason, TokenCounts};

/// Most bytes of an answer; the longest sensible one, in stream events of a token each, takes a tenth of it.
pub(super) const MAX_BYTES: u64 = 4 << 20;
/// Characters of a server's words that a message shows.
const SHOWN: usize = 300;

/// A complete answer.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Reply {
    /// The text.
    pub(super) content: String,
    /// Why it ends.
    pub(super) finish: FinishReason,
    /// What the server counts; zero where it says nothing.
    pub(super) tokens: TokenCounts,
    /// When the first text came; none if the answer came in one piece.
    pub(super) first_text: Option<Instant>,
}

/// A chat completion, or a part of one.
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
        }
    }
}

/// What has come so far.
#[derive(Debug, Default)]
struct Gathered {
    content: String,
    finish: Option<FinishReason>,
    tokens: TokenCounts,
    first_text: Option<Instant>,
}

impl Gathered {
    fn add(&mut self, text: &str) -> Result<(), EndpointFailure> {
        let invalid = |problem: String| EndpointFailure::InvalidReply(problem);
        let part: Completion =
            serde_json::from_str(text).map_err(|error| invalid(format!("{error} in {:?}", shown(text))))?;
        if let Some(error) = part.error {
            return Err(invalid(message_of(&error)));
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
        }
        self.finish = match choice.finish_reason.as_deref() {
            None => self.finish,
            Some("stop") => Some(FinishReason::EndOfSequence),
            Some("length") => Some(FinishReason::Length),
            Some(other) => return Err(invalid(format!("it ends by {:?}", shown(other)))),
        };
        Ok(())
    }

    /// The whole answer; none before its end was told.
    fn complete(self) -> Option<Reply> {
        let Self { content, finish, tokens, first_text } = self;
        finish.map(|finish| Reply { content, finish, tokens, first_text })
    }
}

/// Reads an answer that comes in one piece.
///
/// # Errors
/// When it is too long, breaks off, or is no chat completion.
pub(super) fn read_whole(body: impl Read) -> Result<Reply, EndpointFailure> {
    let mut bytes = Vec::new();
    body.take(MAX_BYTES + 1).read_to_end(&mut bytes).map_err(|error| broken_off(&error))?;
    if bytes.len() as u64 > MAX_BYTES {
        return Err(EndpointFailure::TooLong(MAX_BYTES));
    }
    let text = String::from_utf8_lossy(&bytes);
    let mut gathered = Gathered::default();
    gathered.add(&text)?;
    gathered.first_text = None;
    gathered
        .complete()
        .ok_or_else(|| EndpointFailure::InvalidReply(format!("no finished choice in {:?}", shown(&text))))
}

/// Reads an answer that is streamed.
///
/// # Errors
/// As [`read_whole`]; a stream that ends before the answer did breaks off.
pub(super) fn read_stream(body: impl Read) -> Result<Reply, EndpointFailure> {
    let mut lines = BufReader::new(body.take(MAX_BYTES + 1));
    let mut gathered = Gathered::default();
    let mut read = 0;
    let mut line = Vec::new();
    loop {
        line.clear();
        let length = lines.read_until(b'\n', &mut line).map_err(|error| broken_off(&error))?;
        read += length as u64;
        if read > MAX_BYTES {
            return Err(EndpointFailure::TooLong(MAX_BYTES));
        }
        // Lines of other fields and comments, by which a server keeps the connection open, say nothing.
        let text = String::from_utf8_lossy(&line);
        match text.strip_prefix("data:").map(str::trim) {
            Some("[DONE]") => break,
            Some(event) if !event.is_empty() => gathered.add(event)?,
            _ if length == 0 => break,
            _ => {}
        }
    }
    gathered.complete().ok_or_else(|| EndpointFailure::Closed("the stream ended early".into()))
}

/// A body of an error status in words: the message of `OpenAI`'s error object, else its beginning.
pub(super) fn error_message(body: impl Read) -> String {
    let mut bytes = Vec::new();
    // What cannot be read of an explanation is no other error than the status.
    let _ = body.take(MAX_BYTES).read_to_end(&mut bytes);
    let text = String::from_utf8_lossy(&bytes);
    match serde_json::from_str::<Completion>(&text) {
        Ok(Completion { error: Some(error), .. }) => message_of(&error),
        _ => shown(text.trim()),
    }
}

fn message_of(error: &serde_json::Value) -> String {
    let message = error.get("message").unwrap_or(error);
    shown(&message.as_str().map_or_else(|| message.to_string(), ToString::to_string))
}

fn broken_off(error: &std::io::Error) -> EndpointFailure {
    let timed_out = |error: &(dyn std::error::Error + Send + Sync + 'static)| {
        error.downcast_ref::<reqwest::Error>().is_some_and(reqwest::Error::is_timeout)
    };
    match error.get_ref() {
        // The limit is known to the caller, who puts it in.
        Some(inner) if timed_out(inner) => EndpointFailure::Timeout(std::time::Duration::ZERO),
        _ => EndpointFailure::Closed(error.to_string()),
    }
}

/// The beginning of a text.
fn shown(text: &str) -> String {
    match text.char_indices().nth(SHOWN) {
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
        let reply = read_whole(body.as_bytes()).unwrap();
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
        let reply = read_stream(body.as_bytes()).unwrap();
        assert_eq!((reply.content.as_str(), reply.finish), ("keep", FinishReason::EndOfSequence));
        assert_eq!((reply.tokens.text, reply.tokens.sampled), (5, 2));
        assert!(reply.first_text.is_some());
    }

    #[test]
    fn nonsense_and_broken_answers_are_told_apart() {
        let whole = |body: &str| read_whole(body.as_bytes()).unwrap_err();
        for invalid in ["", "<html>", "[]", "{}", r#"{"choices": []}"#, r#"{"choices": [{"message": {"content": 3}}]}"#]
        {
            assert!(matches!(whole(invalid), EndpointFailure::InvalidReply(_)), "{invalid}");
        }
        let refusal = r#"{"choices":[{"message":{"refusal":"I cannot"},"finish_reason":"stop"}]}"#;
        assert!(whole(refusal).to_string().contains("I cannot"));
        let stream = |body: &str| read_stream(body.as_bytes()).unwrap_err();
        let cut = "data: {\"choices\":[{\"delta\":{\"content\":\"ke\"}}]}\n\n";
        assert!(matches!(stream(cut), EndpointFailure::Closed(_)));
        assert!(
            matches!(stream("data: {\"error\":{\"message\":\"no\"}}\n"), EndpointFailure::InvalidReply(m) if m == "no")
        );
    }

    #[test]
    fn an_endless_answer_is_not_read_to_its_end() {
        let endless = std::io::repeat(b' ');
        assert_eq!(read_whole(endless).unwrap_err(), EndpointFailure::TooLong(MAX_BYTES));
        let endless = std::io::repeat(b'\n');
        assert_eq!(read_stream(endless).unwrap_err(), EndpointFailure::TooLong(MAX_BYTES));
    }

    #[test]
    fn errors_are_told_in_the_servers_words() {
        assert_eq!(error_message(&br#"{"error": {"message": "no such model", "code": 404}}"#[..]), "no such model");
        assert_eq!(error_message(&br#"{"error": "busy"}"#[..]), "busy");
        assert_eq!(error_message(&b" Bad gateway\n"[..]), "Bad gateway");
        assert_eq!(error_message("x".repeat(1000).as_bytes()).len(), SHOWN + 3);
    }
}
