//! Waymo recordings in the registry of readers.

use super::{WomdError, contents, log_name, open_one};
use crate::{Contents, OpenScenario, ReaderError, Scenario, ScenarioReader, ScenarioRef};
use planagent_files::{path_of, word_of};
use std::path::{Path, PathBuf};

/// What the names of recordings contain: Waymo's end in `.tfrecord-00000-of-01000`.
const MARK: &str = ".tfrecord";

/// Takes TFRecord files.
pub(crate) struct WomdReader;

impl ScenarioReader for WomdReader {
    fn recognizes(&self, word: &str) -> bool {
        let path = path_of(word);
        is_recording(&path) && path.exists() && !path.is_dir()
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
        Some(format!("*{MARK}* files (right in it)"))
    }
}

fn is_recording(path: &Path) -> bool {
    path.file_name()
        .is_some_and(|name| name.to_string_lossy().contains(MARK))
}

/// The recordings of a folder, by name.
fn recordings_in(folder: &Path) -> Result<Vec<PathBuf>, ReaderError> {
    let failed = |source| ReaderError::Folder {
        path: folder.to_owned(),
        source,
    };
    let entries = std::fs::read_dir(folder).map_err(failed)?;
    let mut files = entries
        .map(|entry| entry.map(|e| e.path()))
        .collect::<Result<Vec<_>, _>>()
        .map_err(failed)?;
    files.retain(|path| is_recording(path));
    files.sort();
    Ok(files)
}

fn records(path: &Path) -> Result<Vec<ScenarioRef>, WomdError> {
    let reference = |(id, contents): (String, Contents)| {
        let record = contents
            .record
            .expect("contents of a file name their record");
        let own = word_of(path.as_os_str());
        let word = if record == 0 {
            own
        } else {
            format!("{own} record {record}")
        };
        ScenarioRef::new(
            word,
            Recording {
                path: path.to_owned(),
                record,
                contents,
            },
        )
        .with_id(id)
        .with_log_name(log_name(path))
        .in_file(path, record.to_string())
    };
    contents(path)?
        .map(|contents| contents.map(reference))
        .collect()
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recordings_are_found_under_the_names_that_waymo_gives_them() {
        let folder = tempfile::tempdir().unwrap();
        for name in [
            "validation.tfrecord-00001-of-00150",
            "a.tfrecord",
            "notes.txt",
        ] {
            std::fs::write(folder.path().join(name), "no record").unwrap();
        }
        let word = |name: &str| word_of(folder.path().join(name).as_os_str());
        let found = WomdReader.list(&word("")).unwrap();
        let names: Vec<_> = found
            .iter()
            .filter_map(|one| one.path()?.file_name()?.to_str())
            .collect();
        assert_eq!(names, ["a.tfrecord", "validation.tfrecord-00001-of-00150"]);
        let taken = [
            "a.tfrecord",
            "validation.tfrecord-00001-of-00150",
            "notes.txt",
            "b.tfrecord",
        ];
        assert_eq!(
            taken.map(|name| WomdReader.recognizes(&word(name))),
            [true, true, false, false]
        );
    }
}
