//! Results of a benchmark: the folder with its rows, and statistics of them.

mod figures;
mod folder;

#[cfg(test)]
pub(super) use figures::DraftedCall;
#[cfg(test)]
pub(super) use figures::Shares;
pub use figures::{BenchFigures, Comparison, ModelFigures};
pub use folder::{BenchFolder, BenchMetadata};
