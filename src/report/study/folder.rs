//! The folder of an experiment's results: `results.json`, `results.md` and its figures. Made anew of the runs each time.

use super::results::StudyResults;
use crate::experiment::study::Study;
use crate::report::atomic;
use crate::report::error::ReportError;
use crate::report::figure::figures;
use crate::report::number::json_value;
use crate::report::table::study_markdown;
use std::path::{Path, PathBuf};

/// The folder of an experiment's results.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StudyFolder {
    path: PathBuf,
}

impl StudyFolder {
    /// A folder; it need not be there.
    pub fn new(path: PathBuf) -> Self {
        Self { path }
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Writes the results of a study; `command` made them.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn write(&self, study: &Study, results: &StudyResults, command: &str) -> Result<(), ReportError> {
        atomic::folder(&self.path)?;
        let drawn = figures(study, results);
        for (name, svg) in &drawn {
            atomic::write(&self.path.join(name), svg.as_bytes())?;
        }
        let names: Vec<&str> = drawn.iter().map(|(name, _)| name.as_str()).collect();
        atomic::write(&self.path.join("results.md"), study_markdown(study, results, command, &names).as_bytes())?;
        let json = serde_json::to_string_pretty(&json_value(results)?)? + "\n";
        atomic::write(&self.path.join("results.json"), json.as_bytes())
    }
}
