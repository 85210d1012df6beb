//! Waymo recordings in the registry of readers.

use super::{WomdError, contents, log_name, open_one};
use crate::files::{path_of, word_of};
use crate::scenario::{Contents, OpenScenario, ReaderError, Recognition, Scenario, ScenarioReader, ScenarioRef};
use std::path::{Path, PathBuf};

/// Ending of recordings in a folder.
const ENDING: &str = "tfrecord";

/// Takes TFRecord files. A file of any name may be one: Waymo's end in `.tfrecord-00000-of-01000`.
pub struct WomdReader;

impl ScenarioReader for WomdReader {
    fn recognizes(&self, word: &str) -> Recognition {
        if path_of(word).exists() && !path_of(word).is_dir() { Recognition::Possible } else { Recognition::No }
    }

    fn list(&self, word: &str) -> Result<Vec<ScenarioRef>, ReaderError> {
        let path = &path_of(word);
        if !path.is_dir() {
            return records(path).map_err(ReaderError::new);
        }
        let mut all = Vec::new();
        for file in recordings_in(path)? {
            match records(&file) {
                Ok(records) => all.extend(records),
                Err(error) => all.push(ScenarioRef::unreadable(&file, error.to_string())),
            }
        }
        Ok(all)
    }

    fn looks_for(&self) -> Option<String> {
        Some(format!("*.{ENDING} files (right in it)"))
    }
}

/// The recordings of a folder, by name.
fn recordings_in(folder: &Path) -> Result<Vec<PathBuf>, ReaderError> {
    let failed = |source| ReaderError::Folder { path: folder.to_owned(), source };
    let entries = std::fs::read_dir(folder).map_err(failed)?;
    let mut files = entries.map(|entry| entry.map(|e| e.path())).collect::<Result<Vec<_>, _>>().map_err(failed)?;
    files.retain(|path| path.extension().is_some_and(|ending| ending == ENDING));
    files.sort();
    Ok(files)
}

fn records(path: &Path) -> Result<Vec<ScenarioRef>, WomdError> {
    let reference = |(id, contents): (String, Contents)| {
        let record = contents.record.unwrap_or_default();
        let own = word_of(path.as_os_str());
        let word = if record == 0 { own } else { format!("{own} record {record}") };
        ScenarioRef::new(word, Recording { path: path.to_owned(), record, contents })
            .with_id(id)
            .with_log_name(log_name(path))
            .in_file(path, record.to_string())
    };
    contents(path)?.map(|contents| contents.map(reference)).collect()
}

struct Recording {
    path: PathBuf,
    record: usize,
    contents: Contents,
}

impl OpenScenario for Recording {
    fn open(&self) -> Result<Scenario, ReaderError> {
        open_one(&self.path, self.record).map_err(ReaderError::new)
    }

    fn contents(&self) -> Result<Option<Contents>, ReaderError> {
        Ok(Some(self.contents))
    }
}
