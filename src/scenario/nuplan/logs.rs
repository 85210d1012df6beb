//! Logs on disk.

use super::database::Database;
use super::error::{FileFault, NuPlanError};
use super::schema::LOG_TABLES;
use super::token::Token;
use crate::DataRoots;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Ending of log databases.
const LOG_ENDING: &str = "db";
/// Folders of a nuPlan tree that hold no logs, but very many files.
const WITHOUT_LOGS: [&str; 2] = ["sensor_blobs", "maps"];
/// Depth to which folders are searched for logs; nuPlan's own tree needs `nuplan-v1.1/splits/mini`.
pub(crate) const MAX_FOLDER_DEPTH: usize = 5;

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
        let mut files = Vec::new();
        let mut notes = Vec::new();
        walk(path, MAX_FOLDER_DEPTH, &mut files, &mut notes)?;
        files.sort();
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
            return Err(NuPlanError::file(path, FileFault::NoLogs));
        }
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

fn walk(
    folder: &Path,
    depth: usize,
    files: &mut Vec<PathBuf>,
    notes: &mut Vec<String>,
) -> Result<(), NuPlanError> {
    let io = |source| NuPlanError::file(folder, FileFault::List(source));
    for entry in std::fs::read_dir(folder).map_err(io)? {
        let entry = entry.map_err(io)?;
        let path = entry.path();
        if path.is_dir() {
            let name = entry.file_name();
            if depth > 0 && !WITHOUT_LOGS.iter().any(|skipped| name == *skipped) {
                // A folder below that cannot be listed hides no logs beside it.
                if let Err(error) = walk(&path, depth - 1, files, notes) {
                    notes.push(error.to_string());
                }
            }
        } else if path.extension().is_some_and(|ending| ending == LOG_ENDING) {
            files.push(path);
        }
    }
    Ok(())
}
