//! Results of a benchmark: the folder with its rows, and statistics of them.

mod figures;
mod folder;

pub use figures::{BenchFigures, Comparison, ModelFigures};
pub use folder::{BenchFolder, BenchMetadata};
