//! Logs on disk.

use super::database::{Database, other_kind};
use super::error::{FileFault, NuPlanError};
use super::schema::LOG_TABLES;
use super::token::Token;
use crate::DataRoots;
use crate::folders::files_below;
use crate::reader::passed_over;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Ending of log databases.
const LOG_ENDING: &str = "db";

/// A log: one database file.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Log {
    /// Stem of the file.
    pub name: String,
    pub path: PathBuf,
}

impl Log {
    /// The log of a file, existing or not.
    pub fn at(path: impl Into<PathBuf>) -> Self {
        let path = path.into();
        let name = path
            .file_stem()
            .map(|stem| stem.to_string_lossy().into_owned())
            .unwrap_or_default();
        Self { name, path }
    }

    /// Whether the file is a sound database without a single table of a log, such as another
    /// program keeps.
    pub(super) fn is_another_database(&self) -> bool {
        Database::open(&self.path).is_ok_and(|database| {
            LOG_TABLES
                .into_iter()
                .all(|table| database.lacks(table.name))
        })
    }

    /// Opens the log and checks that it has every table and column that is read.
    pub(super) fn open(&self) -> Result<Database, NuPlanError> {
        let database = Database::open(&self.path)?;
        for table in LOG_TABLES
            .into_iter()
            .filter(|table| !table.read_columns().is_empty())
        {
            database.require(table, "a nuPlan log")?;
        }
        Ok(database)
    }
}

/// A scenario of a log.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LogScenario {
    pub log: Arc<Log>,
    /// Token of the tagged `lidar_pc` row.
    pub token: Token,
    /// Alphabetically last of the wanted tags; `unknown` without a tag.
    pub scenario_type: String,
    /// Time of the tagged row, µs.
    pub timestamp_us: i64,
    /// Name of the map (column `map_version` of table `log`).
    pub map_name: String,
}

/// A log that cannot be read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UnreadableLog {
    pub log: Arc<Log>,
    /// Why, with the path.
    pub cause: String,
}

/// The logs of a folder.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Logs {
    /// In order of names.
    pub logs: Vec<Arc<Log>>,
    /// For the user, for example that a log lies in two folders.
    pub notes: Vec<String>,
}

impl Logs {
    /// The logs of the data root.
    pub(super) fn of_root(roots: &DataRoots) -> Result<Self, NuPlanError> {
        let root = roots.data.as_deref().ok_or(NuPlanError::NoDataRoot)?;
        Self::under(root).map_err(|error| NuPlanError::DataRoot(Box::new(error)))
    }

    /// The log of a file, or all logs in a folder and the folders below. A log that lies in several
    /// folders (nuPlan's mini split repeats logs) counts once: the first path.
    pub fn under(path: &Path) -> Result<Self, NuPlanError> {
        let io = |source| NuPlanError::file(path, FileFault::Open(source));
        if !std::fs::metadata(path).map_err(io)?.is_dir() {
            return Ok(Self {
                logs: vec![Arc::new(Log::at(path))],
                notes: Vec::new(),
            });
        }
        let mut notes = Vec::new();
        let list = |source| NuPlanError::file(path, FileFault::List(source));
        // In order, so that the copy of a log that counts is always the same.
        let mut files = files_below(path, |_| true, &mut notes).map_err(list)?;
        files.retain(|file| file.extension().is_some_and(|ending| ending == LOG_ENDING));
        let mut others = Vec::new();
        files.retain(|file| match other_kind(file) {
            Some(kind) => {
                let fault = FileFault::NotADatabase(Some(kind));
                others.push(NuPlanError::file(file, fault).to_string());
                false
            }
            None => true,
        });
        let passed_over = passed_over(&others);
        let mut by_name: BTreeMap<String, Arc<Log>> = BTreeMap::new();
        let mut again = Vec::new();
        for file in files {
            let log = Log::at(file);
            match by_name.entry(log.name.clone()) {
                std::collections::btree_map::Entry::Vacant(free) => {
                    free.insert(Arc::new(log));
                }
                std::collections::btree_map::Entry::Occupied(_) => again.push(log),
            }
        }
        if by_name.is_empty() {
            return Err(NuPlanError::file(path, FileFault::NoLogs(passed_over)));
        }
        notes.extend(passed_over);
        notes.extend(again.first().map(|log| {
            format!(
                "{} log(s) lie in two folders and are read once, for example {}",
                again.len(),
                log.path.display()
            )
        }));
        Ok(Self {
            logs: by_name.into_values().collect(),
            notes,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_systems_leave_beside_logs_is_no_log() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, bytes: &[u8]| {
            let path = folder.path().join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, bytes).unwrap();
        };
        let none = |said: &str| {
            let error = Logs::under(folder.path()).unwrap_err().to_string();
            assert!(error.contains(said), "{error}");
        };
        write("._a.db", b"\x00\x05\x16\x07\x00\x02\x00\x00Mac OS X");
        write("__MACOSX/b.db", b"SQLite format 3\0");
        write(".cache/c.db", b"SQLite format 3\0");
        none("no *.db file");
        write("page.db", b"<html></html>");
        none("page.db: not an SQLite database: it is a web page");
        write("Thumbs.db", b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1");
        none("2 files are passed over");
        write("d/a.db", b"SQLite format 3\0");
        write("cut.db", b"\x01\x02\x03");
        let logs = Logs::under(folder.path()).unwrap();
        let names: Vec<&str> = logs.logs.iter().map(|log| log.name.as_str()).collect();
        assert_eq!(names, ["a", "cut"], "what is not known is not passed over");
        assert!(
            logs.notes[0].contains("2 files are passed over"),
            "{:?}",
            logs.notes
        );
    }

    #[test]
    fn a_database_of_another_program_is_no_log() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.db");
        let database = rusqlite::Connection::open(&path).unwrap();
        database
            .execute_batch("CREATE TABLE songs (name TEXT)")
            .unwrap();
        assert!(Log::at(&path).is_another_database());
        database
            .execute_batch("CREATE TABLE lidar_pc (token BLOB)")
            .unwrap();
        assert!(!Log::at(&path).is_another_database());
        assert!(!Log::at(folder.path().join("b.db")).is_another_database());
    }
}
