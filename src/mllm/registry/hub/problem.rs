//! The hub's failures in words: the reason and the next step, each once.

use super::HubName;
use super::cache::MAIN;
use super::environment::PUBLIC_HUB;
use hf_hub::HFError;
use std::error::Error;

/// Longest message of a server that is shown, characters.
const MAX_SHOWN: usize = 200;
/// The status of what is not there.
const NOT_FOUND: u16 = 404;

/// What the hub lacks or refuses, by its code, else by the status.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Refusal {
    Gated,
    NoRepository,
    NoRevision,
}

impl Refusal {
    fn from_error(error: &HFError, revision: &str) -> Option<Self> {
        let context = match error {
            HFError::Http { context }
            | HFError::AuthRequired { context }
            | HFError::Forbidden { context }
            | HFError::RateLimited { context, .. } => Some(context),
            HFError::RepoNotFound { context, .. } | HFError::RevisionNotFound { context, .. } => {
                context.as_ref()
            }
            _ => None,
        }?;
        match context.error_code.as_deref() {
            Some("GatedRepo") => Some(Self::Gated),
            Some("RepoNotFound") => Some(Self::NoRepository),
            Some("RevisionNotFound") => Some(Self::NoRevision),
            // The client takes an unknown repository for an unknown revision.
            _ if context.status.as_u16() == NOT_FOUND => Some(if revision == MAIN {
                Self::NoRepository
            } else {
                Self::NoRevision
            }),
            _ => None,
        }
    }
}

/// Whether the hub was reached and knows the repository, but not the revision.
pub(super) fn is_about_the_revision(error: &HFError, name: &HubName) -> bool {
    let revision = name.revision.as_deref().unwrap_or(MAIN);
    Refusal::from_error(error, revision) == Some(Refusal::NoRevision)
}

/// Why the hub gave no files, and what to do.
pub(super) fn in_words(error: &HFError, name: &HubName, endpoint: &str) -> String {
    const OFFLINE: &str =
        "check the connection; without one, copy the repository into the cache or name a folder";
    const NAME: &str = "check the name; a private repository needs a token in HF_TOKEN";
    let revision = name.revision.as_deref().unwrap_or(MAIN);
    // The code of a refusal comes first: the client takes some statuses for other errors.
    match Refusal::from_error(error, revision) {
        Some(Refusal::Gated) => {
            return format!(
                "the repository is gated: accept its terms at {endpoint}/{}, and put a token in HF_TOKEN",
                name.id
            );
        }
        Some(Refusal::NoRepository) => {
            return format!("{endpoint} has no such repository; {NAME}");
        }
        Some(Refusal::NoRevision) => {
            return format!(
                "{endpoint} has no such repository, or no revision {revision} of it; name a branch, a tag or a commit"
            );
        }
        None => {}
    }
    match error {
        HFError::Request { source, .. } if source.is_timeout() => {
            format!("{endpoint} did not answer in time; {OFFLINE}")
        }
        HFError::Request { source, .. } if source.is_connect() => {
            format!("cannot connect to {endpoint}: {}; {OFFLINE}", root(source))
        }
        HFError::Request { source, .. } => {
            format!(
                "the download from {endpoint} failed: {}; try it again",
                root(source)
            )
        }
        HFError::AuthRequired { .. } => {
            format!("{endpoint} takes no request without a valid token; {NAME}")
        }
        HFError::Forbidden { .. } => format!(
            "the token in use may not read the repository; accept its terms at {endpoint}/{}, or take another token",
            name.id
        ),
        HFError::RateLimited { retry_after, .. } => {
            let wait = retry_after.map_or_else(
                || "later".to_owned(),
                |wait| format!("in {} s", wait.as_secs()),
            );
            format!(
                "{endpoint} had too many requests; try it again {wait}, or with a token in HF_TOKEN"
            )
        }
        HFError::Http { context } => {
            let said = context
                .server_message
                .as_deref()
                .map_or(String::new(), |message| {
                    let short: String = message.chars().take(MAX_SHOWN).collect();
                    format!(" ({})", short.escape_debug())
                });
            format!(
                "{endpoint} answered with status {}{said}; try it again",
                context.status.as_u16()
            )
        }
        HFError::Json(_) | HFError::MalformedResponse { .. } | HFError::Url(_) => {
            let place = if endpoint == PUBLIC_HUB {
                "a proxy or a login page may stand before it"
            } else {
                "check HF_ENDPOINT"
            };
            format!(
                "the answer of {endpoint} is not that of a hub ({}); {place}",
                root(error)
            )
        }
        HFError::Io(_) | HFError::CacheLockTimeout { .. } => {
            format!("cannot write to the cache: {}", root(error))
        }
        _ => root(error),
    }
}

/// The innermost cause, which has neither the address nor what was tried.
fn root(error: &dyn Error) -> String {
    let mut innermost = error;
    while let Some(source) = innermost.source() {
        innermost = source;
    }
    innermost.to_string()
}
