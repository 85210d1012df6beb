//! Answers, written with a time limit.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{Shutdown, TcpStream};
use std::time::{Duration, Instant};

/// Maximum time in which a client takes an answer.
const MAX_TIME: Duration = Duration::from_secs(30);
/// Bytes that are handed to the system at a time.
const CHUNK: usize = 64 * 1024;
/// Time and bytes for which a refused request is read on: a connection that closes with unread
/// bytes loses its answer.
const DRAIN: Duration = Duration::from_millis(300);
const MAX_DRAINED: usize = 256 * 1024;
/// What the page may do: run its own scripts and styles, draw pictures of its own data, ask this
/// server. No other site may frame it.
const POLICY: &str = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:; connect-src \
                      'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// The kinds of answers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Status {
    Found,
    Bad,
    NotFound,
    OtherMethod,
    Timeout,
    OtherHost,
    TooLarge,
    Failed,
    Unavailable,
}

impl Status {
    /// Number and words of HTTP.
    fn line(self) -> &'static str {
        match self {
            Self::Found => "200 OK",
            Self::Bad => "400 Bad Request",
            Self::NotFound => "404 Not Found",
            Self::OtherMethod => "405 Method Not Allowed",
            Self::Timeout => "408 Request Timeout",
            Self::OtherHost => "421 Misdirected Request",
            Self::TooLarge => "431 Request Header Fields Too Large",
            Self::Failed => "500 Internal Server Error",
            Self::Unavailable => "503 Service Unavailable",
        }
    }
}

/// The bytes of an answer.
#[derive(Debug)]
pub(super) enum Content {
    Plain(Vec<u8>),
    /// As gzip.
    Packed(Vec<u8>),
}

/// An answer.
#[derive(Debug)]
pub(super) struct Response {
    status: Status,
    kind: &'static str,
    content: Content,
}

impl Response {
    /// The page.
    pub(super) fn page(html: &[u8]) -> Self {
        Self {
            status: Status::Found,
            kind: "text/html; charset=utf-8",
            content: Content::Plain(html.to_vec()),
        }
    }

    /// JSON.
    pub(super) fn data(content: Content) -> Self {
        Self {
            status: Status::Found,
            kind: "application/json",
            content,
        }
    }

    /// A sentence for people.
    pub(super) fn words(status: Status, words: &str) -> Self {
        let content = Content::Plain(format!("{words}\n").into_bytes());
        Self {
            status,
            kind: "text/plain; charset=utf-8",
            content,
        }
    }

    #[cfg(test)]
    pub(super) fn status(&self) -> Status {
        self.status
    }

    /// Writes it and closes the connection; without `body`, only the head.
    pub(super) fn write(&self, stream: &TcpStream, body: bool) -> io::Result<()> {
        let (bytes, encoding) = match &self.content {
            Content::Plain(bytes) => (bytes, ""),
            Content::Packed(bytes) => (bytes, "Content-Encoding: gzip\r\n"),
        };
        let allow = if self.status == Status::OtherMethod {
            "Allow: GET, HEAD\r\n"
        } else {
            ""
        };
        let head = format!(
            "HTTP/1.1 {}\r\nContent-Type: {}\r\nContent-Length: {}\r\n{encoding}{allow}Cache-Control: no-store\r\n\
             X-Content-Type-Options: nosniff\r\nReferrer-Policy: no-referrer\r\nCross-Origin-Resource-Policy: same-origin\r\n\
             Content-Security-Policy: {POLICY}\r\nConnection: close\r\n\r\n",
            self.status.line(),
            self.kind,
            bytes.len(),
        );
        let end = Instant::now() + MAX_TIME;
        send(stream, head.as_bytes(), end)?;
        if body {
            send(stream, bytes, end)?;
        }
        stream.shutdown(Shutdown::Write)?;
        if self.status != Status::Found {
            drain(stream);
        }
        Ok(())
    }
}

/// Writes bytes before `end`.
fn send(mut stream: &TcpStream, bytes: &[u8], end: Instant) -> io::Result<()> {
    for chunk in bytes.chunks(CHUNK) {
        let mut left = chunk;
        while !left.is_empty() {
            let time = end.saturating_duration_since(Instant::now());
            if time.is_zero() {
                return Err(ErrorKind::TimedOut.into());
            }
            stream.set_write_timeout(Some(time))?;
            let count = stream.write(left)?;
            if count == 0 {
                return Err(ErrorKind::WriteZero.into());
            }
            left = left
                .get(count..)
                .expect("a write takes no more than it is given");
        }
    }
    Ok(())
}

/// Reads what the client still sends.
fn drain(mut stream: &TcpStream) {
    let (end, mut taken) = (Instant::now() + DRAIN, 0);
    let mut bytes = [0; 4096];
    while taken < MAX_DRAINED {
        let time = end.saturating_duration_since(Instant::now());
        if time.is_zero() || stream.set_read_timeout(Some(time)).is_err() {
            return;
        }
        match stream.read(&mut bytes) {
            Ok(0) | Err(_) => return,
            Ok(count) => taken += count,
        }
    }
}
