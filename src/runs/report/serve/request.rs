//! The head of a request: read with a time limit, and refused unless it asks this machine for a
//! page.

use super::response::{Response, Status};
use std::io::Read;
use std::net::TcpStream;
use std::time::{Duration, Instant};

/// Maximum time in which the head of a request arrives.
const MAX_TIME: Duration = Duration::from_secs(5);
/// Maximum size of a head, bytes. Those of browsers have about 1 KB.
const MAX_BYTES: usize = 16 * 1024;
/// Maximum number of fields of a head; browsers send fewer than half as many.
const MAX_HEADERS: usize = 64;
/// The names of this machine. A page of another name that leads here by DNS (DNS rebinding) has its
/// own name as host.
const OWN_NAMES: [&str; 2] = ["127.0.0.1", "localhost"];

/// A request that may be answered.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Request {
    path: String,
    is_head: bool,
}

impl Request {
    /// Reads a request, or gives the answer that refuses it.
    pub(super) fn read(stream: &TcpStream) -> Result<Self, Response> {
        let mut head = Vec::new();
        let begun = Instant::now();
        loop {
            // One limit for the whole head: a client that sends a byte now and then must not hold
            // the server.
            let left = MAX_TIME.saturating_sub(begun.elapsed());
            let waits = if left.is_zero() {
                None
            } else {
                stream.set_read_timeout(Some(left)).ok()
            };
            let mut more = [0; 2048];
            match waits.and_then(|()| {
                let mut stream = stream;
                stream.read(&mut more).ok()
            }) {
                None => {
                    return Err(Response::words(
                        Status::Timeout,
                        "the request did not arrive in time",
                    ));
                }
                Some(0) => return Err(Response::words(Status::Bad, "the request is not complete")),
                Some(count) => head.extend(more.iter().take(count)),
            }
            if let Some(request) = Self::parse(&head)? {
                return Ok(request);
            }
            if head.len() > MAX_BYTES {
                return Err(Response::words(
                    Status::TooLarge,
                    "the head of the request is too large",
                ));
            }
        }
    }

    /// The request of a head; none if the head goes on.
    fn parse(head: &[u8]) -> Result<Option<Self>, Response> {
        let bad = |why: &str| Response::words(Status::Bad, why);
        let mut headers = [httparse::EMPTY_HEADER; MAX_HEADERS];
        let mut request = httparse::Request::new(&mut headers);
        match request.parse(head) {
            Ok(httparse::Status::Partial) => return Ok(None),
            Ok(httparse::Status::Complete(_)) => {}
            Err(error) => return Err(bad(&format!("no HTTP request: {error}"))),
        }
        let mut hosts = request
            .headers
            .iter()
            .filter(|header| header.name.eq_ignore_ascii_case("host"));
        // A page of another site may send requests here under its own name; the host gives it away.
        let (Some(host), None) = (hosts.next(), hosts.next()) else {
            return Err(bad("the request needs one host"));
        };
        if !std::str::from_utf8(host.value).is_ok_and(is_own) {
            let words = format!("this server answers only as {}", OWN_NAMES.join(" or "));
            return Err(Response::words(Status::OtherHost, &words));
        }
        let method = request.method.expect("a complete request has a method");
        if !["GET", "HEAD"].contains(&method) {
            return Err(Response::words(
                Status::OtherMethod,
                "this server is read-only: GET and HEAD",
            ));
        }
        let target = request.path.expect("a complete request has a target");
        let path = target
            .split(['?', '#'])
            .next()
            .expect("a split gives one part at least");
        if !path.starts_with('/') {
            return Err(bad("the path of the request must start with /"));
        }
        Ok(Some(Self {
            path: path.to_owned(),
            is_head: method == "HEAD",
        }))
    }

    /// The path, without what comes after a question mark.
    pub(super) fn path(&self) -> &str {
        &self.path
    }

    /// Whether the client asks for more than the head of the answer.
    pub(super) fn wants_body(&self) -> bool {
        !self.is_head
    }
}

/// Whether a host is this machine. Any port will do: a tunnel has another one.
fn is_own(host: &str) -> bool {
    let (name, port) = host.split_once(':').unwrap_or((host, "80"));
    OWN_NAMES.iter().any(|own| name.eq_ignore_ascii_case(own)) && port.parse::<u16>().is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn status(head: &str) -> Option<Status> {
        Request::parse(head.as_bytes())
            .err()
            .map(|refusal| refusal.status())
    }

    #[test]
    fn only_this_machine_is_asked_for() {
        for host in ["127.0.0.1:4747", "localhost", "LOCALHOST:80"] {
            assert!(is_own(host), "{host}");
        }
        for host in [
            "",
            "evil.example",
            "127.0.0.1.evil.example",
            "localhost:",
            "localhost:a",
            "[::1]:80",
            "127.0.0.1:80:80",
        ] {
            assert!(!is_own(host), "{host}");
        }
        assert_eq!(
            status("GET / HTTP/1.1\r\nHost: evil.example:4747\r\n\r\n"),
            Some(Status::OtherHost)
        );
        assert_eq!(
            status("GET / HTTP/1.1\r\nHost: localhost\r\nHost: evil.example\r\n\r\n"),
            Some(Status::Bad)
        );
        assert_eq!(status("GET / HTTP/1.0\r\n\r\n"), Some(Status::Bad));
    }

    #[test]
    fn a_request_is_read_when_its_head_is_complete() {
        let whole = "HEAD /data/index?x=1 HTTP/1.1\r\nAccept: */*\r\nhost: 127.0.0.1:4747\r\n\r\n";
        for length in 0..whole.len() {
            assert_eq!(
                Request::parse(&whole.as_bytes()[..length]).unwrap(),
                None,
                "{length}"
            );
        }
        let request = Request::parse(whole.as_bytes()).unwrap().unwrap();
        assert_eq!(
            (request.path(), request.wants_body()),
            ("/data/index", false)
        );
        assert_eq!(
            status("POST / HTTP/1.1\r\nHost: localhost\r\n\r\n"),
            Some(Status::OtherMethod)
        );
        assert_eq!(
            status("GET http://localhost/ HTTP/1.1\r\nHost: localhost\r\n\r\n"),
            Some(Status::Bad)
        );
        assert_eq!(
            status("\u{16}\u{3}\u{1} nonsense\r\n\r\n"),
            Some(Status::Bad)
        );
    }
}
