//! Argoverse 2 logs in the registry of readers.

use super::files::LogFiles;
use super::{contents, is_log, logs_in, name, open};
use crate::{Contents, OpenScenario, ReaderError, Scenario, ScenarioReader, ScenarioRef};
use planagent_files::{path_of, word_of};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// Endings of the files right in the folder of a log.
const ENDINGS: [&str; 2] = ["parquet", "feather"];

/// Takes folders that hold a log, and a file right in one.
#[derive(Debug, Default)]
pub(crate) struct Argoverse2Reader {
    notes: Mutex<Vec<String>>,
}

/// The folder of the log that a path names: its own, or that of one of its files.
fn log_at(path: &Path) -> Option<&Path> {
    if is_log(path) {
        return Some(path);
    }
    let is_file = path
        .extension()
        .is_some_and(|own| ENDINGS.iter().any(|ending| own == *ending))
        && path.is_file();
    path.parent().filter(|folder| is_file && is_log(folder))
}

impl ScenarioReader for Argoverse2Reader {
    fn recognizes(&self, word: &str) -> bool {
        log_at(&path_of(word)).is_some()
    }

    fn list(&self, word: &str) -> Result<Vec<ScenarioRef>, ReaderError> {
        let path = &path_of(word);
        let folders = if let Some(folder) = log_at(path) {
            vec![folder.to_owned()]
        } else {
            let mut notes = self.notes.lock().unwrap_or_else(PoisonError::into_inner);
            logs_in(path, &mut notes).map_err(ReaderError::new)?
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
        Some("Argoverse 2 logs".to_owned())
    }

    fn take_notes(&self) -> Vec<String> {
        std::mem::take(&mut *self.notes.lock().unwrap_or_else(PoisonError::into_inner))
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_of_a_log_names_its_log() {
        let root = tempfile::tempdir().unwrap();
        let log = root.path().join("log");
        std::fs::create_dir(&log).unwrap();
        let file = log.join("scenario_1.parquet");
        std::fs::write(&file, "").unwrap();
        let other = root.path().join("other.parquet");
        std::fs::write(&other, "").unwrap();
        assert_eq!(log_at(&log), Some(log.as_path()));
        assert_eq!(log_at(&file), Some(log.as_path()));
        assert_eq!(log_at(&other), None);
        assert_eq!(log_at(&log.join("absent.parquet")), None);
        let listed = Argoverse2Reader::default()
            .list(&word_of(file.as_os_str()))
            .unwrap();
        assert_eq!(listed.len(), 1);
        assert_eq!(listed[0].to_string(), word_of(log.as_os_str()));
    }

    #[test]
    fn a_log_without_one_of_its_files_is_no_other_folder() {
        let root = tempfile::tempdir().unwrap();
        for (log, files, missing) in [
            (
                "csv",
                &["log_map_archive_1.json", "scenario_1.csv"][..],
                "scenario_*.parquet",
            ),
            (
                "unposed",
                &["annotations.feather", "map/log_map_archive_1.json"],
                "city_SE3_egovehicle.feather",
            ),
        ] {
            for file in files {
                let file = root.path().join(log).join(file);
                std::fs::create_dir_all(file.parent().unwrap()).unwrap();
                std::fs::write(file, "").unwrap();
            }
            let log = root.path().join(log);
            let [listed] = &Argoverse2Reader::default()
                .list(&word_of(log.as_os_str()))
                .unwrap()[..]
            else {
                panic!("one log")
            };
            let error = listed.open().unwrap_err().to_string();
            assert!(
                error.ends_with(&format!("there is no {missing}")),
                "{error}"
            );
        }
        let maps = root.path().join("unposed/map");
        assert_eq!(log_at(&maps), None, "the maps of a log are none");
        let all = Argoverse2Reader::default()
            .list(&word_of(root.path().as_os_str()))
            .unwrap();
        assert_eq!(all.len(), 2);
    }
}
