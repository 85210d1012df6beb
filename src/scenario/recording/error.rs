//! Errors of recordings: where in which file, and what is wrong there.

use planagent_world::MapError;
use std::error::Error;
use std::fmt;
use std::path::{Path, PathBuf};

/// A file or folder, and a part of it where one is known.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FilePlace {
    pub path: PathBuf,
    /// For example `record 3 at byte 1024`.
    pub part: Option<String>,
}

impl fmt::Display for FilePlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.path.display())?;
        self.part
            .as_ref()
            .map_or(Ok(()), |part| write!(f, ": {part}"))
    }
}

/// A fault and its place.
#[derive(Debug, thiserror::Error)]
#[error("{place}: {fault}")]
pub struct FileError<F: Error + 'static> {
    pub place: FilePlace,
    #[source]
    pub fault: F,
}

impl<F: Error + 'static> FileError<F> {
    /// Places a fault in a file or folder; an argument of `map_err`.
    pub(crate) fn at<E: Into<F>>(path: &Path) -> impl FnOnce(E) -> Self {
        |fault| Self {
            place: FilePlace {
                path: path.to_owned(),
                part: None,
            },
            fault: fault.into(),
        }
    }

    /// Places a fault in a part of a file.
    pub(crate) fn at_part<E: Into<F>>(path: &Path, part: String) -> impl FnOnce(E) -> Self {
        |fault| Self {
            place: FilePlace {
                path: path.to_owned(),
                part: Some(part),
            },
            fault: fault.into(),
        }
    }
}

/// Faults of recordings from any source.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RecordingFault {
    #[error("the recording has {steps} steps; at least {needed} are needed")]
    TooShort { steps: usize, needed: usize },
    #[error("step {step} is {seconds} s after its predecessor; recordings have 10 Hz")]
    StepTime { step: usize, seconds: f64 },
    #[error("map feature {feature}: point {point} is NaN, infinite or too far from the ego")]
    NoPlace { feature: i64, point: usize },
    #[error("map feature {feature} is {length} m long, too long for a road")]
    EndlessLine { feature: i64, length: f64 },
    #[error("the {layer} id {id} occurs twice")]
    DuplicateId { layer: &'static str, id: i64 },
    #[error("map: {0}")]
    Map(#[from] MapError),
}
