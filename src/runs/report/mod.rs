//! Stage 10: the results of a run as files, tables, figures and a page.

pub mod atomic;
mod call_record;
mod decision;
mod error;
mod escaped;
mod finish;
mod inputs;
mod judgement;
mod key;
mod last_run;
mod layout;
mod manifest;
mod nuboard;
mod number;
pub mod page;
mod paired;
mod parquet;
mod recorded;
mod renamed;
pub mod render;
mod repeats;
mod replay;
mod run_folder;
#[cfg(test)]
mod schema_tests;
pub mod serve;
mod simulation_folder;
mod simulation_row;
mod spread;
mod stamp;
mod summary;
pub mod table;
mod times;
mod timing;
mod transcript;
mod visible;
mod writable;

pub use call_record::{CallRecord, DecisionRecord};
pub use decision::decision_words;
pub use error::{ReportError, ReportFault};
pub use escaped::escaped;
pub use inputs::{AcceptedChanges, DataFile, Inputs};
pub use judgement::{JudgedMetric, Judgement};
pub use last_run::last_run;
pub use layout::{MANIFEST, SUMMARY, TRANSCRIPT};
pub(crate) use manifest::FORMAT_VERSION;
pub use manifest::{Manifest, PromptList, ScenarioList, ShardList};
pub use number::{fixed, json_value};
pub use paired::{ComparedScene, ComparedScores, NoPair, PlannerPair, RunComparison};
pub use renamed::RenamedSetting;
pub use run_folder::{CompletedSimulations, RunFolder, folders as simulation_folders};
pub use simulation_folder::metrics as simulation_metrics;
pub use simulation_row::{MetricScore, SimulationRow};
pub use spread::Spread;
pub use stamp::stamp;
pub use summary::{Aggregate, ScenarioSummary, Summary};
pub use table::{LineWidth, comparison_table, failures, fill, main_table};
pub use times::{CallTimes, Quantiles, SimulationTime};
pub use timing::{PlannerTiming, Session, SimulationTiming, Timing};
pub use transcript::{attempt_markdown, transcript};
pub use visible::{
    in_markdown, markdown_block, markdown_cell, markdown_line, visible, visible_line,
};
pub use writable::check_writable;
