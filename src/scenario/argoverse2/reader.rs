//! Argoverse 2 logs in the registry of readers.

use super::files::LogFiles;
use super::{contents, is_log, logs_in, name, open};
use crate::{Contents, OpenScenario, ReaderError, Scenario, ScenarioReader, ScenarioRef};
use planagent_files::{path_of, word_of};
use std::path::PathBuf;

/// Takes folders that hold a log.
pub(crate) struct Argoverse2Reader;

impl ScenarioReader for Argoverse2Reader {
    fn recognizes(&self, word: &str) -> bool {
        is_log(&path_of(word))
    }

    fn list(&self, word: &str) -> Result<Vec<ScenarioRef>, ReaderError> {
        let path = &path_of(word);
        let folders = if is_log(path) {
            vec![path.clone()]
        } else {
            logs_in(path).map_err(ReaderError::new)?
        };
        let reference = |folder: PathBuf| {
            let name = name(&folder);
            ScenarioRef::new(word_of(folder.as_os_str()), Log(folder.clone()))
                .with_id(name.clone())
                .with_log_name(name)
                .in_file(folder, "")
        };
        Ok(folders.into_iter().map(reference).collect())
    }

    fn looks_for(&self) -> Option<String> {
        Some("Argoverse 2 logs (down to two folders below)".to_owned())
    }
}

/// A log by its folder.
struct Log(PathBuf);

impl OpenScenario for Log {
    fn open(&self) -> Result<Scenario, ReaderError> {
        open(&self.0).map_err(ReaderError::new)
    }

    fn files(&self) -> Vec<PathBuf> {
        LogFiles::in_folder(&self.0)
            .map(LogFiles::paths)
            .unwrap_or_default()
    }

    fn contents(&self) -> Result<Option<Contents>, ReaderError> {
        contents(&self.0).map(Some).map_err(ReaderError::new)
    }
}
