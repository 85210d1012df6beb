//! Stage 10: the results of a run as files, tables, figures and a page.

mod atomic;
mod bench;
mod call_record;
mod decision;
mod error;
mod figure;
mod finish;
mod inputs;
mod judgement;
mod key;
mod layout;
mod manifest;
mod nuboard;
mod number;
pub mod page;
mod paired;
mod parquet;
pub mod render;
mod repeats;
mod replay;
mod run_folder;
#[cfg(test)]
mod schema_tests;
pub mod serve;
mod simulation_folder;
mod simulation_row;
mod stamp;
mod study;
mod summary;
mod table;
mod times;
mod timing;
mod transcript;
mod twins;
mod visible;
mod writable;

pub use bench::{BenchFigures, BenchFolder, BenchMetadata, Comparison, ModelFigures, Spread};
pub use call_record::{CallRecord, DecisionRecord};
pub use decision::decision_words;
pub use error::{ReportError, ReportFault};
pub use figure::realism_figure;
pub use inputs::{AcceptedChanges, DataFile, Inputs};
pub use judgement::{JudgedMetric, Judgement};
pub use layout::{MANIFEST, SUMMARY};
pub use manifest::{FORMAT_VERSION, Manifest, PromptList, ScenarioList, ShardList};
pub use number::{fixed, json_value};
pub use paired::{ComparedScene, ComparedScores, NoPair, PlannerPair, RunComparison};
pub use run_folder::{CompletedSimulations, RunFolder, folders as simulation_folders, last_run};
pub use simulation_folder::metrics as simulation_metrics;
pub use simulation_row::{MetricScore, SimulationRow};
pub use stamp::stamp;
pub use study::{
    Agreement, CallShares, ChallengeResults, ModelCost, Outcome, RecordingResults, RecordingScores, StudyFolder,
    StudyResults, SuiteResults, SuiteSimulations, TypeResults, VariantResults, VariantSimulations,
};
pub use summary::{Aggregate, ScenarioSummary, Summary};
pub use table::{
    bench_markdown, bench_table, comparison_table, failures, fill, main_table, realism_table, study_markdown,
    study_table, token_markdown, token_table, twin_markdown, twin_table,
};
pub use times::{CallTimes, Quantiles, SimulationTime};
pub use timing::{PlannerTiming, Session, SimulationTiming, Timing};
pub use transcript::{attempt_markdown, transcript};
pub use twins::TwinRecords;
pub use visible::{visible, visible_line};
pub use writable::check_writable;
