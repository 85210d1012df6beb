//! One question to the server, with retries after transient failures.

use super::ahead::Ahead;
use super::forms::Forms;
use super::hints::{Refusal, names_address, other_protocol, other_route, without_version};
use super::key::ApiKey;
use super::models::{Offered, named, offered};
use super::packed::unpacked;
use super::reply::{Listen, MAX_BYTES, Reply, read, shortened, value};
use super::trouble::Trouble;
use super::waits::{Waits, asked};
use crate::{Deadline, EndpointFailure, EndpointSettings, MllmError};
use reqwest::Url;
use reqwest::blocking::{RequestBuilder, Response};
use reqwest::header::{AUTHORIZATION, LOCATION};
use reqwest::redirect::Policy;
use serde_json::Value;
use std::cell::Cell;
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};
use std::time::Duration;

/// Time limit of the list of models that explains a failure.
const MAX_EXPLAINING: Duration = Duration::from_secs(5);

/// A connection pool to one server.
#[derive(Debug)]
pub(super) struct Client {
    http: reqwest::blocking::Client,
    url: Url,
    key: Option<ApiKey>,
    timeout: Duration,
    /// Whether the server has answered a question.
    answered: AtomicBool,
    /// Whether a question waited in vain for a server that loads its model. Later ones do not wait
    /// again.
    waited: AtomicBool,
    /// The forms of requests that the server takes, as [`Forms`].
    forms: AtomicU8,
}

/// A request for a chat completion.
#[derive(Clone, Copy)]
pub(super) struct Question<'a> {
    pub(super) settings: &'a EndpointSettings,
    pub(super) body: &'a Value,
    /// Determines the random parts of the waits.
    pub(super) seed: u64,
    pub(super) deadline: Deadline,
    /// Hears once that the server loads its model, which takes long.
    pub(super) on_wait: &'a dyn Fn(&str),
    /// Whether a request that is refused for its form may be sent again in another one.
    pub(super) may_change: &'a dyn Fn() -> bool,
}

#[derive(Debug)]
struct Failed {
    failure: EndpointFailure,
    /// The wait that the server asks for.
    retry_after: Option<Duration>,
}

impl From<EndpointFailure> for Failed {
    fn from(failure: EndpointFailure) -> Self {
        Self {
            failure,
            retry_after: None,
        }
    }
}

impl Client {
    pub(super) fn new(
        settings: &EndpointSettings,
        url: Url,
        key: Option<ApiKey>,
    ) -> Result<Self, MllmError> {
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
        let timeout = Duration::from_millis(settings.timeout_ms);
        Ok(Self {
            http,
            url,
            key,
            timeout,
            answered: AtomicBool::new(false),
            waited: AtomicBool::new(false),
            forms: AtomicU8::default(),
        })
    }

    /// Sends a question, with retries as the settings allow. `on_text` gets the pieces of the
    /// answer; after the first, nothing is retried.
    ///
    /// # Errors
    /// The last failure, with what to do where that is known; [`MllmError::Deadline`] when the
    /// deadline passes, or would pass during a wait, and there is a server.
    pub(super) fn ask(
        &self,
        question: Question<'_>,
        mut on_text: Option<&mut dyn FnMut(&str)>,
    ) -> Result<Reply, MllmError> {
        let listens = on_text.is_some();
        let mut pass_on = |text: &str| {
            if let Some(on_text) = &mut on_text {
                on_text(text);
            }
        };
        let mut forms = Forms(self.forms.load(Ordering::Relaxed));
        // Each turn adds a form, and there are few.
        loop {
            let body = forms.applied(question.body);
            let question = Question {
                body: &body,
                ..question
            };
            let result = self.asked_with_retries(question, listens, &mut pass_on)?;
            let mut kept = forms;
            if let Err(EndpointFailure::Refused { status, message }) = &result {
                match forms.with_wanted(*status, message, &body) {
                    Some(wanted) if (question.may_change)() => {
                        forms = wanted;
                        continue;
                    }
                    Some(wanted) => kept = wanted,
                    // Remembered only once it worked: a request may be refused for another reason.
                    None => kept = Forms::default(),
                }
            }
            self.forms.store(kept.0, Ordering::Relaxed);
            return result.map_err(|failure| self.error(self.explained(failure, question)));
        }
    }

    /// The server's answer, or its last failure.
    fn asked_with_retries(
        &self,
        question: Question<'_>,
        listens: bool,
        pass_on: &mut dyn FnMut(&str),
    ) -> Result<Result<Reply, EndpointFailure>, MllmError> {
        let Question {
            settings,
            body,
            seed,
            deadline,
            on_wait,
            ..
        } = question;
        let told = Cell::new(false);
        let spoken = Cell::new(false);
        // A piece of an answer may end within the key, and nobody needs pieces who does not listen.
        let whole = self.key.is_some() || !listens;
        let mut once = || {
            let mut tell = |text: &str| {
                if listens {
                    spoken.set(true);
                    pass_on(text);
                }
            };
            let answer = self.ask_once(body, deadline, whole, &mut tell);
            if let Err(Failed {
                failure: EndpointFailure::Loading { message, .. },
                ..
            }) = &answer
                && !told.replace(true)
            {
                on_wait(&format!("the server says: {message}; waiting for it"));
            }
            answer
        };
        let waits = Waits::new(settings, seed, self.waited.load(Ordering::Relaxed));
        let result = patiently(waits, deadline, &spoken, &mut once)?;
        self.waited.store(
            matches!(result, Err(EndpointFailure::Loading { .. })),
            Ordering::Relaxed,
        );
        if result.is_ok() {
            self.answered.store(true, Ordering::Relaxed);
        }
        Ok(result)
    }

    /// The models that the server offers.
    ///
    /// # Errors
    /// As [`Self::ask`].
    pub(super) fn models(&self, settings: &EndpointSettings) -> Result<Vec<Offered>, MllmError> {
        let mut once = || self.models_once(self.timeout);
        let waits = Waits::new(settings, 0, false);
        let listed = patiently(waits, Deadline::NONE, &Cell::new(false), &mut once)?;
        listed.map_err(|failure| MllmError::Endpoint {
            endpoint: self.list_url(),
            failure: self.elsewhere(failure),
        })
    }

    /// The failure of a list, with the address at which the server may have one.
    fn elsewhere(&self, failure: EndpointFailure) -> EndpointFailure {
        let with = |text: String| match other_route(&self.url) {
            Some(advice) => format!("{text}; {advice}"),
            None => text,
        };
        match failure {
            EndpointFailure::Refused {
                status: status @ (200 | 404 | 405),
                message,
            } => EndpointFailure::Refused {
                status,
                message: with(message),
            },
            EndpointFailure::InvalidReply(problem) => EndpointFailure::InvalidReply(with(problem)),
            failure => failure,
        }
    }

    fn ask_once(
        &self,
        body: &Value,
        deadline: Deadline,
        whole: bool,
        on_text: &mut dyn FnMut(&str),
    ) -> Result<Reply, Failed> {
        let limit = deadline
            .left()
            .map_or(self.timeout, |left| left.min(self.timeout));
        let response = self.sent(self.http.post(self.url.clone()).timeout(limit).json(body))?;
        let listen = Listen {
            hide: &|text: &str| self.hide(text),
            asked: self.url.as_str(),
            whole,
            on_text,
        };
        let body = unpacked(response).map_err(|failure| self.redacted(failure))?;
        read(Ahead::new(body), listen).map_err(|failure| self.redacted(failure).into())
    }

    fn models_once(&self, limit: Duration) -> Result<Vec<Offered>, Failed> {
        use std::io::Read;
        let response = self.sent(self.http.get(self.list_url()).timeout(limit))?;
        let mut bytes = Vec::new();
        let invalid = |problem: String| self.redacted(EndpointFailure::InvalidReply(problem));
        unpacked(response)
            .map_err(|failure| self.redacted(failure))?
            .take(MAX_BYTES)
            .read_to_end(&mut bytes)
            .map_err(|error| EndpointFailure::Closed(error.to_string()))?;
        let list = value(String::from_utf8_lossy(&bytes).trim_start_matches('\u{feff}'))
            .map_err(|error| invalid(format!("the list of models: {error}")))?;
        match Trouble::in_reply(&list) {
            Some(trouble) => Err(trouble.failure(&|text| self.hide(text)).into()),
            None => Ok(offered(&list)),
        }
    }

    /// The response to a request, if its status is one of success.
    fn sent(&self, mut request: RequestBuilder) -> Result<Response, Failed> {
        if let Some(key) = &self.key {
            request = request.header(AUTHORIZATION, key.header());
        }
        let response = request.send().map_err(|error| self.unsent(&error))?;
        if response.status().is_success() {
            Ok(response)
        } else {
            Err(self.refused(response))
        }
    }

    /// The failure behind an error before the response status.
    fn unsent(&self, error: &reqwest::Error) -> Failed {
        let causes = || {
            let text = causes(error);
            match other_protocol(self.url.scheme(), &text) {
                Some(advice) => format!("{text}; {advice}"),
                None => text,
            }
        };
        let failure = if error.is_connect() {
            EndpointFailure::Connect(causes())
        } else if error.is_timeout() {
            EndpointFailure::Timeout(self.timeout)
        } else {
            EndpointFailure::Closed(causes())
        };
        self.redacted(failure).into()
    }

    /// The failure behind an error status.
    fn refused(&self, response: Response) -> Failed {
        let (status, retry_after) = (response.status(), asked(response.headers()));
        let failure = match response
            .headers()
            .get(LOCATION)
            .and_then(|place| place.to_str().ok())
        {
            Some(place) => EndpointFailure::Refused {
                status: status.as_u16(),
                message: format!("the address moved to {}", shortened(&self.hide(place))),
            },
            None => match unpacked(response) {
                Ok(body) => Trouble::behind(status, body),
                Err(_) => Trouble::behind(status, std::io::empty()),
            }
            .failure(&|text| self.hide(text)),
        };
        Failed {
            failure: self.redacted(failure),
            retry_after,
        }
    }

    /// A failure with what to do. A first reply that is no answer lasts: the address, the model or
    /// the settings are wrong.
    fn explained(&self, failure: EndpointFailure, question: Question<'_>) -> EndpointFailure {
        let with = |text: String, advice: Option<String>| match advice {
            Some(advice) => format!("{text}; {advice}"),
            None => text,
        };
        let is_first = !self.answered.load(Ordering::Relaxed);
        match failure {
            EndpointFailure::Refused { status, message } => {
                let Question {
                    settings,
                    body,
                    deadline,
                    ..
                } = question;
                let refusal = Refusal {
                    status,
                    message: &message,
                    settings,
                    url: &self.url,
                    body,
                };
                let advice = if refusal.is_of_the_model() {
                    self.offer(deadline)
                } else {
                    refusal.advice()
                };
                EndpointFailure::Refused {
                    status,
                    message: with(message, advice),
                }
            }
            EndpointFailure::InvalidReply(_) if is_first => {
                let text = failure.to_string();
                let advice = without_version(&self.url).filter(|_| !names_address(&text));
                EndpointFailure::Unusable(with(text, advice))
            }
            // One that answered before loads another model between, and will answer again.
            EndpointFailure::Loading {
                status, message, ..
            } if !is_first => EndpointFailure::Unavailable { status, message },
            EndpointFailure::NoAnswer(_) if is_first => {
                EndpointFailure::Unusable(failure.to_string())
            }
            failure => failure,
        }
    }

    /// The names that the server has in place of one that it has not. A list that cannot be had
    /// explains nothing.
    fn offer(&self, deadline: Deadline) -> Option<String> {
        let limit = deadline
            .left()
            .map_or(MAX_EXPLAINING, |left| left.min(MAX_EXPLAINING));
        let models = self
            .models_once(limit)
            .ok()
            .filter(|models| !models.is_empty())?;
        Some(format!(
            "the server offers {}",
            named(&models, &|text| self.hide(text))
        ))
    }

    /// The names of models for a message.
    pub(super) fn named(&self, models: &[Offered]) -> String {
        named(models, &|text| self.hide(text))
    }

    fn list_url(&self) -> String {
        let url = self.url.as_str();
        format!(
            "{}/models",
            url.strip_suffix("/chat/completions").unwrap_or(url)
        )
    }

    /// A text of the server without the API key.
    fn hide(&self, text: &str) -> String {
        self.key
            .as_ref()
            .map_or_else(|| text.to_owned(), |key| key.hide(text))
    }

    /// Sets the time limit of a failure and removes the API key from its text.
    fn redacted(&self, mut failure: EndpointFailure) -> EndpointFailure {
        match &mut failure {
            EndpointFailure::Timeout(limit) => *limit = self.timeout,
            EndpointFailure::Connect(text)
            | EndpointFailure::Closed(text)
            | EndpointFailure::InvalidReply(text)
            | EndpointFailure::Withheld(text)
            | EndpointFailure::NoAnswer(text)
            | EndpointFailure::Unusable(text)
            | EndpointFailure::Loading { message: text, .. }
            | EndpointFailure::Unavailable { message: text, .. }
            | EndpointFailure::Refused { message: text, .. } => {
                *text = self.hide(text);
            }
            EndpointFailure::Wait { .. } | EndpointFailure::TooLong(_) => {}
        }
        failure
    }

    fn error(&self, failure: EndpointFailure) -> MllmError {
        MllmError::Endpoint {
            endpoint: self.url.to_string(),
            failure,
        }
    }
}

/// Sends a request again after failures that pass. The inner failure is the server's.
fn patiently<T>(
    mut waits: Waits,
    deadline: Deadline,
    spoken: &Cell<bool>,
    once: &mut dyn FnMut() -> Result<T, Failed>,
) -> Result<Result<T, EndpointFailure>, MllmError> {
    loop {
        deadline.check()?;
        let Failed {
            failure,
            retry_after,
        } = match once() {
            Ok(reply) => return Ok(Ok(reply)),
            Err(failed) => failed,
        };
        // A server that is not there fails, however much time is left.
        let is_absent = matches!(failure, EndpointFailure::Connect(_));
        if !is_absent {
            deadline.check()?;
        }
        if spoken.get() {
            return Ok(Err(failure));
        }
        let (wait, failure) = match waits.next(failure, retry_after) {
            Ok(again) => again,
            Err(failure) => return Ok(Err(failure)),
        };
        if deadline.left().is_some_and(|left| wait >= left) {
            return if is_absent {
                Ok(Err(failure))
            } else {
                Err(MllmError::Deadline)
            };
        }
        std::thread::sleep(wait);
    }
}

/// The innermost cause of an error. The outer ones repeat the address, which the message has
/// already.
fn causes(error: &reqwest::Error) -> String {
    let mut innermost: &dyn std::error::Error = error;
    while let Some(cause) = innermost.source() {
        innermost = cause;
    }
    innermost.to_string()
}
