//! Stage 10: what people and programs read of a run.

mod call_record;
mod run_folder;
mod summary;
mod table;
mod timing;
mod transcript;

pub use call_record::call_record;
pub use run_folder::{ReportError, RunFolder};
pub use summary::{Aggregate, ScenarioRow, Summary};
pub use table::{failures, main_table};
pub use timing::{CallTimes, Timing};
pub use transcript::{attempt_markdown, decision_words, transcript};
