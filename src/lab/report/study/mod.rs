//! Results of a study: scores and paired differences with intervals, as Markdown, JSON and
//! figures.

mod agreement;
mod asked;
mod folder;
mod lost;
mod recordings;
mod results;
#[cfg(test)]
mod tests;

pub use agreement::Agreement;
pub use asked::AskedFigures;
pub use folder::StudyFolder;
pub(crate) use folder::{RESULTS, RESULTS_MARK};
pub use lost::MetricLoss;
pub use recordings::{CallShares, RecordingResults, RecordingScores};
pub(crate) use results::clusters;
pub use results::{
    ChallengeResults, ModelCost, Outcome, StudyResults, SuiteResults, SuiteSimulations,
    TypeResults, VariantResults, VariantSimulations,
};
