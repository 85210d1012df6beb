//! What a kind of change is.

use super::draft::Draft;
use std::fmt;

/// One change of a scenario, as a table of the file names it.
pub(super) trait Change: fmt::Debug + Send + Sync {
    /// Refuses values that fit no scenario.
    fn check(&self) -> Result<(), Fault>;

    /// Adds the change to a scenario.
    fn apply(&self, draft: &mut Draft) -> Result<(), Fault>;
}

/// Why a change cannot be made.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Fault {
    /// The field.
    pub field: &'static str,
    /// What is wrong, and what would be right.
    pub text: String,
}

impl Fault {
    pub(super) fn new(field: &'static str, text: impl Into<String>) -> Self {
        Self {
            field,
            text: text.into(),
        }
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.field, self.text)
    }
}
