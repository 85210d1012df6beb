//! Waymo recordings in the registry of readers.

use super::{WomdError, contents, log_name, open_one};
use crate::folders::files_below;
use crate::reader::passed_over;
use crate::{Contents, OpenScenario, ReaderError, Scenario, ScenarioReader, ScenarioRef};
use planagent_files::{is_unfinished, path_of, word_of};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// What the names of recordings contain: Waymo's end in `.tfrecord-00000-of-01000`.
const MARK: &str = ".tfrecord";

/// Takes TFRecord files.
#[derive(Debug, Default)]
pub(crate) struct WomdReader {
    notes: Mutex<Vec<String>>,
}

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
        let (mut all, mut others, mut notes) = (Vec::new(), Vec::new(), Vec::new());
        for file in recordings_in(path, &mut notes)? {
            match records(&file) {
                Ok(records) => all.extend(records),
                Err(error) if error.fault.is_of_another_kind() => others.push(error.to_string()),
                Err(error) => all.push(ScenarioRef::unreadable(&file, error.to_string())),
            }
        }
        notes.extend(passed_over(&others));
        let mut kept = self.notes.lock().unwrap_or_else(PoisonError::into_inner);
        kept.extend(notes);
        Ok(all)
    }

    fn take_notes(&self) -> Vec<String> {
        std::mem::take(&mut *self.notes.lock().unwrap_or_else(PoisonError::into_inner))
    }

    fn looks_for(&self) -> Option<String> {
        Some(format!("*{MARK}* files"))
    }
}

fn is_recording(path: &Path) -> bool {
    path.file_name()
        .is_some_and(|name| name.to_string_lossy().contains(MARK))
}

/// The recordings in a folder and in the folders below, by path.
fn recordings_in(folder: &Path, notes: &mut Vec<String>) -> Result<Vec<PathBuf>, ReaderError> {
    let failed = |source| ReaderError::Folder {
        path: folder.to_owned(),
        source,
    };
    let mut files = files_below(folder, |_| true, notes).map_err(failed)?;
    // What browsers leave beside recordings is none.
    let is_left = |path: &Path| {
        path.file_name()
            .is_some_and(|name| is_unfinished(&name.to_string_lossy()))
    };
    files.retain(|path| is_recording(path) && !is_left(path));
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
    use super::super::tfrecord::frame;
    use super::*;
    use crate::reader::MAX_FOLDER_DEPTH;

    #[test]
    fn recordings_are_found_under_the_names_that_waymo_gives_them() {
        let folder = tempfile::tempdir().unwrap();
        for name in [
            "validation.tfrecord-00001-of-00150",
            "a.tfrecord",
            "notes.txt",
            "._a.tfrecord",
            "b.tfrecord.crdownload",
        ] {
            std::fs::write(folder.path().join(name), frame(b"no message")).unwrap();
        }
        std::fs::write(folder.path().join("page.tfrecord"), "<html></html>").unwrap();
        std::fs::create_dir(folder.path().join("c.tfrecord")).unwrap();
        let deep = |depth: usize| folder.path().join(vec!["deep"; depth].join("/"));
        std::fs::create_dir_all(deep(MAX_FOLDER_DEPTH + 1)).unwrap();
        std::fs::write(
            deep(MAX_FOLDER_DEPTH).join("d.tfrecord"),
            frame(b"no message"),
        )
        .unwrap();
        std::fs::write(
            deep(MAX_FOLDER_DEPTH + 1).join("e.tfrecord"),
            frame(b"no message"),
        )
        .unwrap();
        let word = |name: &str| word_of(folder.path().join(name).as_os_str());
        let reader = WomdReader::default();
        let found = reader.list(&word("")).unwrap();
        let names: Vec<_> = found
            .iter()
            .filter_map(|one| one.path()?.file_name()?.to_str())
            .collect();
        assert_eq!(
            names,
            [
                "a.tfrecord",
                "d.tfrecord",
                "validation.tfrecord-00001-of-00150"
            ]
        );
        let notes = reader.take_notes();
        assert!(
            matches!(&notes[..], [note] if note.contains("page.tfrecord") && note.contains("web page")),
            "{notes:?}"
        );
        let taken = [
            "a.tfrecord",
            "validation.tfrecord-00001-of-00150",
            "notes.txt",
            "b.tfrecord",
        ];
        assert_eq!(
            taken.map(|name| reader.recognizes(&word(name))),
            [true, true, false, false]
        );
    }
}
