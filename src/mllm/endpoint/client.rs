//! One request to the server, with retries after transient failures.

use std::time::{Duration, SystemTime};

use backon::{BackoffBuilder, ExponentialBuilder};
use reqwest::blocking::Response;
use reqwest::header::{AUTHORIZATION, CONTENT_TYPE, RETRY_AFTER};
use reqwest::redirect::Policy;
use reqwest::{StatusCode, Url};
use serde_json::Value;

use super::key::ApiKey;
use super::reply::{Listen, Reply, error_message, read_stream, read_whole, shortened};
use crate::{Deadline, EndpointFailure, EndpointSettings, MllmError};

/// Maximum wait before a retry, unless the server asks for a longer one.
const MAX_WAIT: Duration = Duration::from_secs(30);

/// A connection pool to one server.
#[derive(Debug)]
pub(super) struct Client {
    http: reqwest::blocking::Client,
    url: Url,
    key: Option<ApiKey>,
    timeout: Duration,
    retries: usize,
    first_wait: Duration,
}

#[derive(Debug)]
struct Failed {
    failure: EndpointFailure,
    /// The wait that the server asks for.
    retry_after: Option<Duration>,
}

impl From<EndpointFailure> for Failed {
    fn from(failure: EndpointFailure) -> Self {
        Self { failure, retry_after: None }
    }
}

impl Client {
    pub(super) fn new(settings: &EndpointSettings, url: Url, key: Option<ApiKey>) -> Result<Self, MllmError> {
        let mut builder = reqwest::blocking::Client::builder()
            .connect_timeout(Duration::from_millis(settings.connect_timeout_ms))
            .user_agent(concat!("planagent/", env!("CARGO_PKG_VERSION")))
            .redirect(Policy::none());
        if settings.is_local() {
            builder = builder.no_proxy();
        }
        let http = builder.build().map_err(|error| MllmError::Endpoint {
            endpoint: url.to_string(),
            failure: EndpointFailure::Connect(causes(&error)),
        })?;
        Ok(Self {
            http,
            url,
            key,
            timeout: Duration::from_millis(settings.timeout_ms),
            retries: settings.retries,
            first_wait: Duration::from_millis(settings.first_wait_ms),
        })
    }

    /// Sends a request, with retries as the settings allow; `seed` determines the random parts of the waits. `on_text` gets the
    /// pieces of the answer; after the first, nothing is retried.
    ///
    /// # Errors
    /// The last failure; [`MllmError::Deadline`] when the deadline passes, or would pass during a wait, and there is a server.
    pub(super) fn ask(
        &self,
        body: &Value,
        seed: u64,
        deadline: Deadline,
        mut on_text: Option<&mut dyn FnMut(&str)>,
    ) -> Result<Reply, MllmError> {
        let mut spoken = false;
        let mut waits = ExponentialBuilder::default()
            .with_min_delay(self.first_wait)
            .with_max_delay(MAX_WAIT)
            .with_max_times(self.retries)
            .with_jitter()
            .with_jitter_seed(seed)
            .build();
        loop {
            deadline.check()?;
            let Failed { failure, retry_after } = match self.ask_once(body, deadline, &mut |text| {
                if let Some(on_text) = &mut on_text {
                    spoken = true;
                    on_text(text);
                }
            }) {
                Ok(reply) => return Ok(reply),
                Err(failed) => failed,
            };
            // A server that is not there fails, however much time is left.
            let is_absent = matches!(failure, EndpointFailure::Connect(_));
            if !is_absent {
                deadline.check()?;
            }
            let again = if may_retry(&failure) && !spoken { waits.next() } else { None };
            let Some(wait) = again else { return Err(self.error(failure)) };
            let wait = retry_after.unwrap_or(wait);
            if let (EndpointFailure::Unavailable { status, .. }, true) = (&failure, wait > self.timeout) {
                return Err(self.error(EndpointFailure::Wait { status: *status, seconds: wait.as_secs() }));
            }
            if deadline.left().is_some_and(|left| wait >= left) {
                return Err(if is_absent { self.error(failure) } else { MllmError::Deadline });
            }
            std::thread::sleep(wait);
        }
    }

    fn ask_once(&self, body: &Value, deadline: Deadline, on_text: &mut dyn FnMut(&str)) -> Result<Reply, Failed> {
        let limit = deadline.left().map_or(self.timeout, |left| left.min(self.timeout));
        let mut request = self.http.post(self.url.clone()).timeout(limit).json(body);
        if let Some(key) = &self.key {
            request = request.header(AUTHORIZATION, key.header());
        }
        let response = request.send().map_err(|error| self.unsent(&error))?;
        if !response.status().is_success() {
            return Err(self.refused(response));
        }
        let streamed = response
            .headers()
            .get(CONTENT_TYPE)
            .and_then(|kind| kind.to_str().ok())
            .is_some_and(|kind| kind.starts_with("text/event-stream"));
        let hide = |text: &str| self.hide(text);
        // A piece of an answer may end within the key: with one, the answer is shown as a whole.
        let whole = self.key.is_some();
        let listen = Listen { hide: &hide, whole, on_text };
        let reply = if streamed { read_stream(response, listen) } else { read_whole(response, listen) };
        reply.map_err(|failure| self.redacted(failure).into())
    }

    /// The failure behind an error before the response status.
    fn unsent(&self, error: &reqwest::Error) -> Failed {
        let failure = if error.is_connect() {
            EndpointFailure::Connect(causes(error))
        } else if error.is_timeout() {
            EndpointFailure::Timeout(self.timeout)
        } else {
            EndpointFailure::Closed(causes(error))
        };
        self.redacted(failure).into()
    }

    /// The failure behind an error status.
    fn refused(&self, response: Response) -> Failed {
        let status = response.status();
        let retry_after =
            response.headers().get(RETRY_AFTER).and_then(|wait| retry_after(wait.to_str().ok()?, SystemTime::now()));
        let message = match response.headers().get(reqwest::header::LOCATION).and_then(|place| place.to_str().ok()) {
            Some(place) => format!("the address moved to {}", shortened(&self.hide(place))),
            None => error_message(response, &|text| self.hide(text)),
        };
        let failure = if status.is_server_error() || status == StatusCode::TOO_MANY_REQUESTS {
            EndpointFailure::Unavailable { status: status.as_u16(), message }
        } else {
            EndpointFailure::Refused { status: status.as_u16(), message }
        };
        Failed { failure: self.redacted(failure), retry_after }
    }

    /// A text of the server without the API key.
    fn hide(&self, text: &str) -> String {
        self.key.as_ref().map_or_else(|| text.to_owned(), |key| key.hide(text))
    }

    /// Sets the time limit of a failure and removes the API key from its text.
    fn redacted(&self, mut failure: EndpointFailure) -> EndpointFailure {
        match &mut failure {
            EndpointFailure::Timeout(limit) => *limit = self.timeout,
            EndpointFailure::Connect(text)
            | EndpointFailure::Closed(text)
            | EndpointFailure::InvalidReply(text)
            | EndpointFailure::Unavailable { message: text, .. }
            | EndpointFailure::Refused { message: text, .. } => {
                *text = self.hide(text);
            }
            EndpointFailure::Wait { .. } | EndpointFailure::TooLong(_) => {}
        }
        failure
    }

    fn error(&self, failure: EndpointFailure) -> MllmError {
        MllmError::Endpoint { endpoint: self.url.to_string(), failure }
    }
}

/// Whether a retry of the same request can succeed. A request that reached its time limit is not retried.
fn may_retry(failure: &EndpointFailure) -> bool {
    matches!(failure, EndpointFailure::Connect(_) | EndpointFailure::Closed(_) | EndpointFailure::Unavailable { .. })
}

/// Reads the header `Retry-After`: seconds, or a date (RFC 9110, 10.2.3).
fn retry_after(value: &str, now: SystemTime) -> Option<Duration> {
    let value = value.trim();
    if let Ok(seconds) = value.parse::<f64>() {
        return Duration::try_from_secs_f64(seconds).ok();
    }
    httpdate::parse_http_date(value).ok().map(|date| date.duration_since(now).unwrap_or_default())
}

/// The innermost cause of an error. The outer ones repeat the address, which the message has already.
fn causes(error: &reqwest::Error) -> String {
    let mut innermost: &dyn std::error::Error = error;
    while let Some(cause) = innermost.source() {
        innermost = cause;
    }
    innermost.to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn retry_after_is_read_in_both_forms() {
        let now = httpdate::parse_http_date("Sun, 06 Nov 1994 08:49:37 GMT").unwrap();
        assert_eq!(retry_after(" 7 ", now), Some(Duration::from_secs(7)));
        assert_eq!(retry_after("0.25", now), Some(Duration::from_millis(250)));
        assert_eq!(retry_after("Sun, 06 Nov 1994 08:49:40 GMT", now), Some(Duration::from_secs(3)));
        assert_eq!(retry_after("Sun, 06 Nov 1994 08:00:00 GMT", now), Some(Duration::ZERO));
        for wrong in ["", "-1", "soon", "inf"] {
            assert_eq!(retry_after(wrong, now), None, "{wrong}");
        }
    }
}
