//! The lines of a response: server-sent events as servers really write them, or a body in one
//! piece.

use super::MAX_BYTES;
use crate::EndpointFailure;
use std::io::BufRead;

/// Fields of server-sent events; the empty one begins a comment. `error` is that of older servers
/// of llama.cpp.
const FIELDS: [&str; 6] = ["data", "event", "id", "retry", "error", ""];

/// What some gateways put before JSON, so that no browser runs it.
const NO_SCRIPT: &str = ")]}'";

/// What a response has next.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Line {
    /// The data of an event.
    Event(String),
    /// What an event of the type `error` says.
    Error(String),
    /// A body that is no stream.
    Whole(String),
    /// The mark of a stream's end.
    Done,
    /// The end of the bytes.
    End,
}

pub(super) struct Events<R> {
    body: R,
    read: u64,
    /// Whether a line of a stream was seen.
    streams: bool,
    /// Whether the type of the event is `error`.
    is_error: bool,
    /// The data lines of an event that is not complete.
    data: String,
    /// The bytes up to the last line feed, whose lines may end in carriage returns alone.
    lines: String,
    /// Where the next of these lines begins; `None` after the last.
    next: Option<usize>,
    /// Why the bytes ended, where lines before the end are not taken yet.
    broken: Option<EndpointFailure>,
}

impl<R: BufRead> Events<R> {
    pub(super) fn new(body: R) -> Self {
        let (data, lines) = (String::new(), String::new());
        Self {
            body,
            read: 0,
            streams: false,
            is_error: false,
            data,
            lines,
            next: None,
            broken: None,
        }
    }

    /// The source of the bytes.
    pub(super) fn bytes(&mut self) -> &mut R {
        &mut self.body
    }

    /// The next event.
    ///
    /// # Errors
    /// When the body is too long, ends early or comes too late.
    pub(super) fn next(&mut self) -> Result<Line, EndpointFailure> {
        loop {
            let Some(line) = self.line()? else {
                let rest = std::mem::take(&mut self.data);
                // A body without a line is no stream.
                let streamed = std::mem::replace(&mut self.streams, true);
                return Ok(match rest.is_empty() {
                    false => self.event(rest),
                    true if streamed => Line::End,
                    true => Line::Whole(String::new()),
                });
            };
            if !self.streams && line.trim() == NO_SCRIPT {
                continue;
            }
            if !self.streams && !line.trim().is_empty() {
                if field(&line).is_none() {
                    return self.whole(line);
                }
                self.streams = true;
            }
            if let Some(event) = self.take(&line) {
                return Ok(event);
            }
        }
    }

    /// Takes a line of a stream, which may complete an event.
    fn take(&mut self, line: &str) -> Option<Line> {
        match field(line) {
            Some(("data", "[DONE]")) => return Some(Line::Done),
            Some(("data", data)) if !data.is_empty() => {
                // Some servers put no blank line between events, so a complete value is an event.
                // Only the first line is tried: trying all that came so far, line by line, would
                // let a server keep this process busy.
                if self.data.is_empty() && !is_open(data) {
                    return Some(self.event(data.to_owned()));
                }
                if !self.data.is_empty() {
                    self.data.push('\n');
                }
                self.data.push_str(data);
            }
            Some(("error", text)) if !text.is_empty() => return Some(Line::Error(text.to_owned())),
            Some(("event", kind)) => self.is_error = kind == "error",
            // A blank line ends an event.
            None if line.trim().is_empty() => {
                let data = std::mem::take(&mut self.data);
                let event = (!data.is_empty()).then(|| self.event(data));
                self.is_error = false;
                return event;
            }
            // JSON without a field, as in lines of JSON.
            None if line.trim_start().starts_with('{') => {
                return Some(Line::Event(line.trim().to_owned()));
            }
            // Comments keep the connection open; other fields carry no text.
            _ => {}
        }
        None
    }

    fn event(&self, data: String) -> Line {
        if self.is_error {
            Line::Error(data)
        } else {
            Line::Event(data)
        }
    }

    /// The rest of a body that is no stream.
    fn whole(&mut self, first: String) -> Result<Line, EndpointFailure> {
        self.streams = true;
        let mut text = first;
        loop {
            match self.line() {
                Ok(Some(line)) => {
                    text.push('\n');
                    text.push_str(&line);
                }
                // A connection that breaks behind the last byte of JSON costs nothing.
                Err(failure) if !is_value(&text) => return Err(failure),
                Ok(None) | Err(_) => return Ok(Line::Whole(text)),
            }
        }
    }

    /// The next line without its end; `None` at the end of the bytes.
    fn line(&mut self) -> Result<Option<String>, EndpointFailure> {
        if self.next.is_none() && !self.fill()? {
            return Ok(None);
        }
        let rest = self
            .next
            .and_then(|next| self.lines.get(next..))
            .unwrap_or_default();
        let (line, more) = rest
            .split_once('\r')
            .map_or((rest, false), |(line, _)| (line, true));
        let line = line.to_owned();
        self.next = self.next.filter(|_| more).map(|next| next + line.len() + 1);
        Ok(Some(line))
    }

    /// Reads up to the next line feed; `false` at the end of the bytes.
    fn fill(&mut self) -> Result<bool, EndpointFailure> {
        if let Some(failure) = self.broken.take() {
            return Err(failure);
        }
        let mut bytes = Vec::new();
        if let Err(error) = self.body.read_until(b'\n', &mut bytes) {
            self.broken = Some(incomplete(&error));
            if bytes.is_empty() {
                return self.fill();
            }
        }
        let length = bytes.len();
        let first = self.read == 0;
        self.read += length as u64;
        if self.read > MAX_BYTES {
            return Err(EndpointFailure::TooLong(MAX_BYTES));
        }
        let text = String::from_utf8_lossy(&bytes);
        // A byte order mark is no part of a stream, and none of JSON.
        let text = text
            .strip_prefix('\u{feff}')
            .filter(|_| first)
            .unwrap_or(&text);
        let text = text.strip_suffix('\n').unwrap_or(text);
        text.strip_suffix('\r')
            .unwrap_or(text)
            .clone_into(&mut self.lines);
        self.next = Some(0).filter(|_| length > 0);
        Ok(length > 0)
    }
}

fn is_value(text: &str) -> bool {
    serde_json::from_str::<serde::de::IgnoredAny>(text).is_ok()
}

/// Whether a text is the beginning of a JSON value.
fn is_open(data: &str) -> bool {
    serde_json::from_str::<serde::de::IgnoredAny>(data).is_err_and(|error| error.is_eof())
}

/// Name and value of a field; `None` for a line of another kind. The standard knows small letters
/// without a space alone, and no stream has another meaning for others.
fn field(line: &str) -> Option<(&str, &str)> {
    let (written, value) = line.split_once(':')?;
    let written = written.trim_start();
    let name = ["data", "event"]
        .into_iter()
        .find(|name| name.eq_ignore_ascii_case(written))
        .unwrap_or(written);
    let mut value = value.trim();
    // A proxy that takes an event for its data puts a second name before it.
    while name == "data"
        && let Some(inner) = value.strip_prefix("data:")
    {
        value = inner.trim_start();
    }
    FIELDS.contains(&name).then_some((name, value))
}

fn incomplete(error: &std::io::Error) -> EndpointFailure {
    let timed_out = |error: &(dyn std::error::Error + Send + Sync + 'static)| {
        error
            .downcast_ref::<reqwest::Error>()
            .is_some_and(reqwest::Error::is_timeout)
    };
    match error.get_ref() {
        // The caller sets the limit.
        Some(inner) if timed_out(inner) => EndpointFailure::Timeout(std::time::Duration::ZERO),
        _ => EndpointFailure::Closed(error.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// All that a body has, up to its end.
    fn lines(body: &str) -> Vec<Line> {
        let mut events = Events::new(body.as_bytes());
        std::iter::from_fn(|| Some(events.next().unwrap()).filter(|line| *line != Line::End))
            .collect()
    }

    fn event(data: &str) -> Line {
        Line::Event(data.to_owned())
    }

    #[test]
    fn events_are_found_however_a_server_writes_them() {
        let two = [event(r#"{"a":1}"#), event(r#"{"b":2}"#), Line::Done];
        for (what, body) in [
            (
                "as the standard says",
                "data: {\"a\":1}\n\ndata: {\"b\":2}\n\ndata: [DONE]\n\n",
            ),
            (
                "without spaces",
                "data:{\"a\":1}\n\ndata:{\"b\":2}\n\ndata:[DONE]\n\n",
            ),
            (
                "carriage returns too",
                "data: {\"a\":1}\r\n\r\ndata: {\"b\":2}\r\n\r\ndata: [DONE]\r\n\r\n",
            ),
            (
                "carriage returns alone",
                "data: {\"a\":1}\r\rdata: {\"b\":2}\r\rdata: [DONE]\r\r",
            ),
            (
                "comments and fields",
                ": ping\n\nevent: x\nid: 7\nretry: 3\ndata: {\"a\":1}\n\n:\n\ndata: {\"b\":2}\n\ndata: [DONE]\n",
            ),
            (
                "no blank lines",
                "data: {\"a\":1}\ndata: {\"b\":2}\ndata: [DONE]\n",
            ),
            (
                "an event of several lines",
                "data: {\ndata: \"a\":1}\n\ndata: {\"b\":2}\n\ndata: [DONE]\n\n",
            ),
            (
                "blank lines first",
                "\n\r\n\ndata: {\"a\":1}\n\ndata: {\"b\":2}\n\ndata: [DONE]",
            ),
            (
                "a byte order mark",
                "\u{feff}data: {\"a\":1}\n\ndata: {\"b\":2}\n\ndata: [DONE]\n\n",
            ),
            (
                "empty data",
                "data:\n\ndata: {\"a\":1}\n\ndata: \n\ndata: {\"b\":2}\n\ndata: [DONE]\n\n",
            ),
            (
                "the field twice",
                "data: data: {\"a\":1}\n\ndata: data:{\"b\":2}\n\ndata: data: [DONE]\n\n",
            ),
            (
                "large letters and spaces",
                " Data: {\"a\":1}\n\nEVENT: x\nDATA: {\"b\":2}\n\nDATA: [DONE]\n\n",
            ),
            (
                "JSON without a field",
                "data: {\"a\":1}\n\n{\"b\":2}\n\ndata: [DONE]\n\n",
            ),
        ] {
            let joined = lines(body).into_iter().map(|line| match line {
                Line::Event(data) => Line::Event(data.replace('\n', "")),
                line => line,
            });
            assert_eq!(joined.collect::<Vec<_>>(), two, "{what}");
        }
        assert_eq!(lines("data: {\n"), [event("{")], "an event that is cut");
    }

    #[test]
    fn errors_and_other_bodies_are_told_from_events() {
        let error = |text: &str| Line::Error(text.to_owned());
        assert_eq!(
            lines("data: {\"a\":1}\n\nevent: error\ndata: {\"b\":2}\n\n"),
            [event("{\"a\":1}"), error("{\"b\":2}")]
        );
        assert_eq!(
            lines("error: {\"message\":\"x\"}\n\n"),
            [error("{\"message\":\"x\"}")]
        );
        assert_eq!(
            lines("event: error\n\ndata: {\"a\":1}\n\n"),
            [event("{\"a\":1}")]
        );
        assert_eq!(lines("data: broken\n\n"), [event("broken")]);
        assert_eq!(lines(")]}'\n{}"), [Line::Whole("{}".to_owned())]);
        for whole in ["{\n\"a\": 1\n}", "<html>\nx", "no JSON", "[1]", "datum: 3"] {
            assert_eq!(lines(whole), [Line::Whole(whole.to_owned())]);
        }
        assert_eq!(lines(" \n\r\n"), [Line::Whole(String::new())]);
    }

    /// Bytes whose connection breaks behind them.
    struct Cut(&'static [u8]);

    impl std::io::Read for Cut {
        fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
            match self.0.read(buffer)? {
                0 => Err(std::io::ErrorKind::UnexpectedEof.into()),
                length => Ok(length),
            }
        }
    }

    #[test]
    fn what_came_before_a_connection_breaks_is_read() {
        let mut whole = Events::new(std::io::BufReader::new(Cut(b"{\n\"a\": 1}")));
        assert_eq!(whole.next().unwrap(), Line::Whole("{\n\"a\": 1}".into()));
        let mut half = Events::new(std::io::BufReader::new(Cut(b"{\"a\": ")));
        assert!(matches!(half.next(), Err(EndpointFailure::Closed(_))));
        for stream in ["data: {\"a\":1}", "data: {\"a\":1}\n\ndata: {\"b\""] {
            let mut events = Events::new(std::io::BufReader::new(Cut(stream.as_bytes())));
            assert_eq!(events.next().unwrap(), event("{\"a\":1}"));
            assert!(matches!(events.next(), Err(EndpointFailure::Closed(_))));
        }
    }
}
