//! Results of the lab: their folders, tables and figures.

mod bench;
mod figure;
mod study;
mod table;
mod twins;

pub use bench::{BenchFigures, BenchFolder, BenchMetadata, Comparison, ModelFigures};
pub use figure::realism_figure;
pub use study::{
    Agreement, AskedFigures, CallShares, ChallengeResults, ModelCost, Outcome, RecordingResults,
    RecordingScores, StudyFolder, StudyResults, SuiteResults, SuiteSimulations, TypeResults,
    VariantResults, VariantSimulations,
};
pub use table::{
    bench_markdown, bench_table, realism_table, study_table, token_markdown, token_table,
    twin_table,
};
pub(crate) use table::{study_markdown, twin_markdown};
pub use twins::TwinRecords;

#[cfg(test)]
use bench::{DraftedCall, Shares};
