//! The folder of a study's results: `results.json`, `results.md` and figures. Each time it is
//! written from the runs.

use super::results::StudyResults;
use crate::report::figure::figures;
use crate::report::study_markdown;
use crate::study::Study;
use planagent_runs::report::{
    ReportError, ReportFault, atomic, check_own, check_writable, json_value,
};
use std::path::{Path, PathBuf};

/// The files of results, the first one with the command that made them.
pub(crate) const RESULTS: [&str; 2] = ["results.md", "results.json"];
/// What `results.md` of the program has at its beginning.
pub(crate) const RESULTS_MARK: &str = "$ planagent study";

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

    /// Checks that files can be written, and that none of others would be lost: the first of `files`
    /// has `mark` at its beginning where the program wrote them.
    pub(crate) fn check(&self, files: [&str; 2], mark: &str) -> Result<(), ReportError> {
        check_writable(&self.path)?;
        let [first, second] = files.map(|name| self.path.join(name));
        if second.exists() && !first.exists() {
            return Err(ReportError::at(&second)(ReportFault::NotOwn));
        }
        check_own(&first, &[mark])
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
