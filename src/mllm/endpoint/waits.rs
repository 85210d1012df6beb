//! How long to wait before a request is sent again.

use crate::{EndpointFailure, EndpointSettings};
use backon::{BackoffBuilder, ExponentialBackoff, ExponentialBuilder};
use reqwest::header::{HeaderMap, RETRY_AFTER};
use std::time::{Duration, Instant, SystemTime};

/// Maximum wait before a retry, unless the server asks for a longer one.
const MAX_WAIT: Duration = Duration::from_secs(30);
/// Maximum wait before a server that loads its model is asked again.
const MAX_LOADING_WAIT: Duration = Duration::from_secs(5);
/// Azure's and `OpenAI`'s header with milliseconds.
const RETRY_AFTER_MS: &str = "retry-after-ms";

/// The waits between the requests of one question.
pub(super) struct Waits {
    retries: ExponentialBackoff,
    /// For a server that loads its model. It is no retry: the server has not tried to answer yet.
    loading: ExponentialBackoff,
    began: Instant,
    /// Longest wait.
    limit: Duration,
    /// Longest time to load.
    loading_limit: Duration,
}

impl Waits {
    /// `seed` determines the random parts; `waited` says that the server had its time to load.
    pub(super) fn new(settings: &EndpointSettings, seed: u64, waited: bool) -> Self {
        let first = Duration::from_millis(settings.first_wait_ms);
        let limit = Duration::from_millis(settings.timeout_ms);
        let builder = ExponentialBuilder::default()
            .with_min_delay(first)
            .with_jitter()
            .with_jitter_seed(seed);
        Self {
            retries: builder
                .with_max_delay(MAX_WAIT)
                .with_max_times(settings.retries)
                .build(),
            loading: builder
                .with_max_delay(MAX_LOADING_WAIT)
                .without_max_times()
                .build(),
            began: Instant::now(),
            limit,
            loading_limit: if waited { Duration::ZERO } else { limit },
        }
    }

    /// The wait before the next request, or the failure to report. `asked` is the wait that the
    /// server asks for.
    pub(super) fn next(
        &mut self,
        failure: EndpointFailure,
        asked: Option<Duration>,
    ) -> Result<(Duration, EndpointFailure), EndpointFailure> {
        // Loading is no failure. It has a time limit of its own and uses up no retries.
        if let EndpointFailure::Loading {
            status, message, ..
        } = failure
        {
            let waited = self.began.elapsed();
            let wait = asked
                .or_else(|| self.loading.next())
                .unwrap_or(MAX_LOADING_WAIT)
                .min(MAX_LOADING_WAIT);
            let failure = EndpointFailure::Loading {
                status,
                message,
                waited,
            };
            return if waited.saturating_add(wait) > self.loading_limit {
                Err(failure)
            } else {
                Ok((wait, failure))
            };
        }
        let again = if may_retry(&failure) {
            self.retries.next()
        } else {
            None
        };
        let Some(wait) = again else {
            return Err(failure);
        };
        let wait = asked.unwrap_or(wait);
        match failure {
            EndpointFailure::Unavailable { status, .. } if wait > self.limit => {
                Err(EndpointFailure::Wait {
                    status,
                    seconds: wait.as_secs(),
                })
            }
            failure => Ok((wait, failure)),
        }
    }
}

/// Whether a retry of the same request can succeed. A request that reached its time limit is not
/// retried.
fn may_retry(failure: &EndpointFailure) -> bool {
    matches!(
        failure,
        EndpointFailure::Connect(_)
            | EndpointFailure::Closed(_)
            | EndpointFailure::Unavailable { .. }
    )
}

/// The wait that a server asks for.
pub(super) fn asked(headers: &HeaderMap) -> Option<Duration> {
    let text = |name: &str| headers.get(name).and_then(|wait| wait.to_str().ok());
    let milliseconds = text(RETRY_AFTER_MS).and_then(|wait| wait.trim().parse::<f64>().ok());
    let precise = milliseconds.and_then(|wait| Duration::try_from_secs_f64(wait / 1e3).ok());
    precise.or_else(|| retry_after(text(RETRY_AFTER.as_str())?, SystemTime::now()))
}

/// Reads the header `Retry-After`: seconds, or a date (RFC 9110, 10.2.3).
fn retry_after(value: &str, now: SystemTime) -> Option<Duration> {
    let value = value.trim();
    if let Ok(seconds) = value.parse::<f64>() {
        return Duration::try_from_secs_f64(seconds).ok();
    }
    httpdate::parse_http_date(value)
        .ok()
        .map(|date| date.duration_since(now).unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn retry_after_is_read_in_all_forms() {
        let now = httpdate::parse_http_date("Sun, 06 Nov 1994 08:49:37 GMT").unwrap();
        assert_eq!(retry_after(" 7 ", now), Some(Duration::from_secs(7)));
        assert_eq!(retry_after("0.25", now), Some(Duration::from_millis(250)));
        assert_eq!(
            retry_after("Sun, 06 Nov 1994 08:49:40 GMT", now),
            Some(Duration::from_secs(3))
        );
        assert_eq!(
            retry_after("Sun, 06 Nov 1994 08:00:00 GMT", now),
            Some(Duration::ZERO)
        );
        for wrong in ["", "-1", "soon", "inf"] {
            assert_eq!(retry_after(wrong, now), None, "{wrong}");
        }
        let mut headers = HeaderMap::new();
        assert_eq!(asked(&headers), None);
        headers.insert(RETRY_AFTER, "7".parse().unwrap());
        assert_eq!(asked(&headers), Some(Duration::from_secs(7)));
        headers.insert(RETRY_AFTER_MS, "1500".parse().unwrap());
        assert_eq!(asked(&headers), Some(Duration::from_millis(1500)));
    }
}
