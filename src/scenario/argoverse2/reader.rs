//! Argoverse 2 logs in the registry of readers.

use super::{contents, is_log, logs_in, name, open};
use crate::scenario::{Contents, OpenScenario, ReaderError, Recognition, Scenario, ScenarioReader, ScenarioRef};
use std::path::{Path, PathBuf};

/// Takes folders that hold a log.
pub struct Argoverse2Reader;

impl ScenarioReader for Argoverse2Reader {
    fn recognizes(&self, word: &str) -> Recognition {
        if is_log(Path::new(word)) { Recognition::Certain } else { Recognition::No }
    }

    fn list(&self, word: &str) -> Result<Vec<ScenarioRef>, ReaderError> {
        let path = Path::new(word);
        let folders = if is_log(path) { vec![path.to_owned()] } else { logs_in(path).map_err(ReaderError::new)? };
        let reference = |folder: PathBuf| {
            let name = name(&folder);
            ScenarioRef::new(folder.display().to_string(), Log(folder.clone()))
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

    fn contents(&self) -> Result<Option<Contents>, ReaderError> {
        contents(&self.0).map(Some).map_err(ReaderError::new)
    }
}
