//! What a bench leaves: a folder with its rows, and figures made of them.

mod figures;
mod folder;

pub use figures::{BenchFigures, Comparison, ModelFigures, Spread};
pub use folder::{BenchFolder, BenchMetadata};
