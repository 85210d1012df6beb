//! Results of the lab: their folders, tables and figures.

mod bench;
pub(crate) mod figure;
mod records;
mod study;
mod table;

pub use bench::{BenchFigures, BenchFolder, BenchMetadata, Comparison, ModelFigures};
pub use figure::realism_figure;
pub use records::Records;
pub use study::{
    Agreement, AskedFigures, CallShares, ChallengeResults, MetricLoss, ModelCost, Outcome,
    RecordingResults, RecordingScores, StudyFolder, StudyResults, SuiteResults, SuiteSimulations,
    TypeResults, VariantResults, VariantSimulations,
};
pub(crate) use study::{RESULTS, RESULTS_MARK, clusters};
pub use table::{
    bench_markdown, bench_table, realism_table, study_table, token_markdown, token_table,
    twin_table,
};
pub(crate) use table::{study_markdown, twin_markdown, twin_rows};

#[cfg(test)]
use bench::{DraftedCall, Shares};
