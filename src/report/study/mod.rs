//! What an experiment leaves: scores with paired differences and their intervals, as Markdown, JSON and figures.

mod folder;
mod results;
#[cfg(test)]
mod tests;

pub use folder::StudyFolder;
pub use results::{
    ChallengeResults, ModelCost, Outcome, StudyResults, SuiteResults, SuiteSimulations, TypeResults, VariantResults,
    VariantSimulations,
};
