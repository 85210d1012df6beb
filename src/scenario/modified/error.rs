//! Why a scenario cannot be modified.

use super::fault::Fault;
use planagent_world::InteractionKind;

/// Why a modification cannot be read, or does not fit a scenario.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message of a variant says what it is")]
#[non_exhaustive]
pub enum ModifyError {
    #[error("cannot read the modification {place}: {source}")]
    Read {
        place: String,
        source: std::io::Error,
    },
    #[error("in the modification {place}: {source}")]
    Parse {
        place: String,
        source: Box<toml::de::Error>,
    },
    #[error("in the modification {place}, line {line}: {key}.{fault}")]
    Value {
        place: String,
        line: usize,
        key: &'static str,
        fault: Fault,
    },
    #[error("in the modification {place}: {fault}")]
    Head { place: String, fault: Fault },
    #[error("the modification {place} does not fit {scenario}: line {line}: {change}.{fault}")]
    Misfit {
        place: String,
        line: usize,
        change: &'static str,
        scenario: String,
        fault: Fault,
    },
    #[error("the modification {place} does not fit {scenario}: {fault}")]
    Unfit {
        place: String,
        scenario: String,
        fault: String,
    },
    #[error(
        "{misfit}; the suite interactive-generated has scenarios for it, which --type {kind} takes"
    )]
    KindMisfit {
        misfit: Box<Self>,
        kind: InteractionKind,
    },
}
