//! The folder of a study's results: `results.json`, `results.md` and figures. Each time it is
//! written from the runs.

use super::results::StudyResults;
use crate::report::figure::figures;
use crate::report::study_markdown;
use crate::study::Study;
use planagent_runs::report::ReportError;
use planagent_runs::report::atomic;
use planagent_runs::report::json_value;
use std::path::{Path, PathBuf};

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StudyFolder {
    path: PathBuf,
}

impl StudyFolder {
    /// A folder, which need not exist yet.
    pub fn new(path: PathBuf) -> Self {
        Self { path }
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Writes the results of a study and the `command` that reproduces them.
    pub fn write(
        &self,
        study: &Study,
        results: &StudyResults,
        command: &str,
    ) -> Result<(), ReportError> {
        let mut files = figures(study, results);
        let names: Vec<String> = files.iter().map(|(name, _)| name.clone()).collect();
        files.push((
            "results.md".to_owned(),
            study_markdown(study, results, command, &names),
        ));
        let json = json_value(results).and_then(|value| serde_json::to_string_pretty(&value));
        files.push((
            "results.json".to_owned(),
            json.map_err(ReportError::at(&self.path))? + "\n",
        ));
        self.write_files(&files)
    }

    /// Writes files of these names, each completely or not at all.
    pub(crate) fn write_files(
        &self,
        files: &[(impl AsRef<Path>, String)],
    ) -> Result<(), ReportError> {
        atomic::folder(&self.path)?;
        files.iter().try_for_each(|(name, text)| {
            atomic::write_within(&self.path.join(name), text.as_bytes())
        })
    }
}
