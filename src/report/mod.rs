//! Stage 10: what people and programs read of a run.

mod atomic;
mod bench;
mod call_record;
mod error;
mod figure;
mod finish;
mod manifest;
mod number;
pub mod page;
mod parquet;
pub mod render;
mod replay;
mod run_folder;
mod simulation_row;
mod stamp;
mod study;
mod summary;
mod table;
mod timing;
mod transcript;

pub use bench::{BenchFigures, BenchFolder, BenchMetadata, Comparison, ModelFigures, Spread};
pub use call_record::call_record;
pub use error::ReportError;
pub use finish::SUMMARY;
pub use manifest::{MANIFEST, Manifest, ScenarioList};
pub use number::{fixed, json_value};
pub use run_folder::{Recorded, RunFolder};
pub use simulation_row::{MetricScore, SimulationRow, SimulationTime};
pub use stamp::stamp;
pub use study::{
    ChallengeResults, ModelCost, Outcome, StudyFolder, StudyResults, SuiteResults, SuiteSimulations, TypeResults,
    VariantResults, VariantSimulations,
};
pub use summary::{Aggregate, ScenarioSummary, Summary};
pub use table::{bench_markdown, bench_table, failures, fill, main_table, study_markdown, study_table, token_table};
pub use timing::{CallTimes, PlannerTiming, Quantiles, Session, SimulationTiming, Timing};
pub use transcript::{attempt_markdown, decision_words, transcript};
