//! Why a card cannot be made.

use crate::dataset::DatasetError;
use crate::twins::TwinError;
use planagent_agent::environment::BevError;
use planagent_agent::reasoning::PromptError;
use planagent_runs::runner::RunnerError;
use std::path::PathBuf;

/// Why a card cannot be made.
#[derive(Debug, thiserror::Error)]
pub(super) enum CardError {
    #[error("--limit is 0; it must be at least 1")]
    LimitZero,
    #[error("{key} is set, and a card {why}; leave the setting out")]
    Setting {
        key: &'static str,
        why: &'static str,
    },
    #[error(
        "--latency-of {}: cannot read it: {source}; name the folder or the card.json of an earlier card",
        path.display()
    )]
    ReadCard {
        path: PathBuf,
        source: std::io::Error,
    },
    #[error(
        "--latency-of {}: {fault}; name the folder or the card.json of an earlier card",
        path.display()
    )]
    NoTimes { path: PathBuf, fault: String },
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    #[error(transparent)]
    Prompt(#[from] PromptError),
    #[error(transparent)]
    View(#[from] BevError),
    #[error(transparent)]
    Twin(#[from] TwinError),
    #[error("{state}: the planning call failed: {fault}")]
    Call { state: String, fault: String },
}

impl From<CardError> for RunnerError {
    fn from(error: CardError) -> Self {
        Self::Lab(Box::new(error))
    }
}
