//! What a kind of change is.

use super::draft::Draft;
use super::fault::Fault;
use std::fmt;
use toml::Spanned;

/// One change of a scenario, as a table of the file names it.
pub(super) trait Change: fmt::Debug + Send + Sync {
    /// Refuses values that fit no scenario.
    fn check(&self) -> Result<(), Fault>;

    /// Adds the change to a scenario.
    fn apply(&self, draft: &mut Draft) -> Result<(), Fault>;
}

/// A change with its place in the file.
#[derive(Debug)]
pub(super) struct PlacedChange {
    pub(super) key: &'static str,
    /// From 1.
    pub(super) line: usize,
    pub(super) change: Box<dyn Change>,
}

/// The head of the file; the tables beside it are the changes.
#[derive(Debug)]
pub(super) struct Head {
    pub(super) name: Option<Spanned<String>>,
    pub(super) kind: Option<Spanned<String>>,
    pub(super) seed: u64,
}
