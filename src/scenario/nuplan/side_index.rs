//! Indices for logs that lack them, in files of their own.
//!
//! Official logs need not have an index on `lidar_box (lidar_pc_token)`; without one every frame
//! would read the whole table. The user's files are never written. An index is a small database in
//! the cache folder, named by path, size and modification time of the log, so that a changed log
//! gets a new one. It gets its name only when it is complete.

use super::database::{Database, harden, immutable_uri};
use super::error::{FileFault, NuPlanError};
use super::schema::{EGO_POSE, LIDAR_BOX, TRACK, TRAFFIC_LIGHT_STATUS, Table};
use rusqlite::{Connection, OpenFlags};
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, UNIX_EPOCH};

/// Incremented when the layout of the file changes.
const VERSION: u32 = 1;
/// Ending of the files.
const ENDING: &str = "index";
/// Ending of a file in progress.
const UNFINISHED: &str = ".tmp";
/// Age at which a file in progress has nobody who writes it. An index of a log of an hour takes a
/// minute.
const MAX_BUILD: Duration = Duration::from_hours(1);
/// The tables that each frame searches, and the column.
const SEARCHED: [(Table, &str); 4] = [
    (LIDAR_BOX, "lidar_pc_token"),
    (TRAFFIC_LIGHT_STATUS, "lidar_pc_token"),
    (EGO_POSE, "token"),
    (TRACK, "token"),
];

/// The folder of the indices.
#[derive(Debug)]
pub(super) struct SideIndices {
    /// `None` when the platform has no cache folder.
    folder: Option<PathBuf>,
    /// A lock for each log, so that two threads do not build the same index.
    building: Mutex<BTreeMap<PathBuf, Arc<Mutex<()>>>>,
}

/// How the rows of a log are found by a column.
#[derive(Debug, Default)]
pub(super) struct LogIndex {
    /// The tables that need our index.
    aside: Vec<&'static str>,
    /// Schema of our index: the attached file, or memory.
    schema: &'static str,
    /// Why the index is in memory, for the user.
    pub(super) note: Option<String>,
}

impl LogIndex {
    /// The query that finds the rows of a table by a column: with our index, else with the table's
    /// own.
    pub(super) fn search(&self, table: Table, column: &str) -> String {
        let (name, schema) = (table.name, self.schema);
        let select = table.select();
        if self.aside.contains(&name) {
            format!(
                "{select} FROM {schema}.{name}_{column} AS i CROSS JOIN {name} ON {name}.rowid = i.number \
                 WHERE i.key = ?1 ORDER BY i.number"
            )
        } else {
            format!("{select} FROM {name} WHERE {name}.\"{column}\" = ?1 ORDER BY {name}.rowid")
        }
    }
}

impl SideIndices {
    /// Indices in `$PLANAGENT_CACHE`, else in the cache folder of the platform.
    pub(super) fn new(folder: Option<PathBuf>) -> Self {
        Self {
            folder,
            building: Mutex::default(),
        }
    }

    /// Attaches a file with the indices that the log lacks. Where no file can be written, the rows
    /// between two times, µs, are indexed in memory.
    pub(super) fn attach(
        &self,
        log: &Database,
        times: (i64, i64),
    ) -> Result<LogIndex, NuPlanError> {
        let mut missing = Vec::new();
        for (table, column) in SEARCHED {
            if !log.is_indexed(table.name, column)? {
                missing.push((table.name, column));
            }
        }
        if missing.is_empty() {
            return Ok(LogIndex::default());
        }
        match self.file_for(log, &missing) {
            Ok(file) => {
                let attached = log
                    .connection
                    .execute("ATTACH DATABASE ?1 AS side", [immutable_uri(&file)]);
                attached.map_err(|source| log.failed("the attached index", source))?;
                Ok(LogIndex {
                    aside: missing.into_iter().map(|(table, _)| table).collect(),
                    schema: "side",
                    note: None,
                })
            }
            Err(IndexError::Log(error)) => Err(error),
            // A read-only cache must not stop a simulation; it only makes it slower.
            Err(IndexError::Cache(reason)) => {
                remember(log, &missing, times)?;
                Ok(LogIndex {
                    aside: missing.into_iter().map(|(table, _)| table).collect(),
                    schema: "temp",
                    note: Some(format!(
                        "no index of logs can be written ({reason}): each scenario reads its whole log; set PLANAGENT_CACHE to a \
                         writable folder"
                    )),
                })
            }
        }
    }

    fn file_for(
        &self,
        log: &Database,
        missing: &[(&'static str, &'static str)],
    ) -> Result<PathBuf, IndexError> {
        let folder = self
            .folder
            .as_deref()
            .ok_or_else(|| IndexError::Cache("no cache folder is known".to_owned()))?;
        let (stem, name) = file_name(&log.path).map_err(IndexError::Log)?;
        let file = folder.join(&name);
        let lock = {
            let mut all = self.building.lock().unwrap_or_else(PoisonError::into_inner);
            all.entry(file.clone()).or_default().clone()
        };
        let _building = lock.lock().unwrap_or_else(PoisonError::into_inner);
        if !is_complete(&file, missing) {
            fs::create_dir_all(folder)
                .map_err(|e| IndexError::Cache(format!("{}: {e}", folder.display())))?;
            build(log, missing, &file)?;
            remove_stale(folder, &stem, &name);
        }
        Ok(file)
    }
}

/// Indexes in memory the rows between two times, µs.
fn remember(
    log: &Database,
    missing: &[(&'static str, &'static str)],
    times: (i64, i64),
) -> Result<(), NuPlanError> {
    let run = |query: &str| log.connection.execute_batch(query);
    run("PRAGMA temp_store = MEMORY")
        .map_err(|source| log.failed("the index in memory", source))?;
    for (table, column) in missing {
        let name = format!("{table}_{column}");
        let wanted = if *column == "lidar_pc_token" {
            let (from, to) = times;
            format!(
                "IN (SELECT token FROM lidar_pc WHERE timestamp >= {from} AND timestamp <= {to})"
            )
        } else {
            "IS NOT NULL".to_owned()
        };
        let filled = run(&created("temp", &name)).and_then(|()| {
            run(&format!(
                "INSERT INTO temp.{name} SELECT \"{column}\", rowid FROM main.{table} WHERE \"{column}\" {wanted}"
            ))
        });
        filled.map_err(|source| log.failed(table, source))?;
    }
    Ok(())
}

/// The query that creates an index.
fn created(schema: &str, name: &str) -> String {
    format!(
        "CREATE TABLE {schema}.{name} (key BLOB, number INTEGER, PRIMARY KEY (key, number)) WITHOUT ROWID"
    )
}

/// Why there is no index.
enum IndexError {
    /// The log itself cannot be read.
    Log(NuPlanError),
    /// The cache cannot be used.
    Cache(String),
}

/// The common part of the names of all indices of a log, and the name of the present one.
fn file_name(log: &Path) -> Result<(String, String), NuPlanError> {
    let io = |source| NuPlanError::file(log, FileFault::Open(source));
    let real = fs::canonicalize(log).map_err(io)?;
    let file = fs::metadata(&real).map_err(io)?;
    let modified = file
        .modified()
        .ok()
        .and_then(|time| time.duration_since(UNIX_EPOCH).ok())
        .unwrap_or_default();
    let stem = blake3::hash(real.as_os_str().as_encoded_bytes()).to_hex();
    let stem = stem
        .get(..24)
        .expect("a digest has 64 hexadecimal digits")
        .to_owned();
    let name = format!(
        "{stem}-{}-{}.{VERSION}.{ENDING}",
        file.len(),
        modified.as_nanos()
    );
    Ok((stem, name))
}

/// Whether a file is complete and holds all missing indices.
fn is_complete(file: &Path, missing: &[(&str, &str)]) -> bool {
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY
        | OpenFlags::SQLITE_OPEN_URI
        | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let Ok(index) = Connection::open_with_flags(immutable_uri(file), flags) else {
        return false;
    };
    let number = |query: &str, name: &str| {
        index
            .query_row(query, [name], |row| row.get::<_, i64>(0))
            .ok()
    };
    let length = number(
        "SELECT page_count * page_size FROM pragma_page_count, pragma_page_size WHERE ?1 = ''",
        "",
    );
    let holds = |(table, column): &(&str, &str)| {
        number(
            "SELECT 1 FROM complete WHERE name = ?1",
            &format!("{table}_{column}"),
        )
        .is_some()
    };
    length.is_some_and(|length| fs::metadata(file).is_ok_and(|found| found.len() as i64 == length))
        && missing.iter().all(holds)
}

fn build(
    log: &Database,
    missing: &[(&'static str, &'static str)],
    file: &Path,
) -> Result<(), IndexError> {
    /// Distinguishes the files that threads of this process write.
    static NUMBER: AtomicU64 = AtomicU64::new(0);
    let number = NUMBER.fetch_add(1, Ordering::Relaxed);
    let unfinished = file.with_extension(format!("{}-{number}{UNFINISHED}", std::process::id()));
    let written = write(log, missing, &unfinished).and_then(|()| {
        fs::rename(&unfinished, file)
            .map_err(|e| IndexError::Cache(format!("{}: {e}", file.display())))
    });
    if written.is_err() {
        // Should the removal fail as well, the first error matters.
        let _ = fs::remove_file(&unfinished);
    }
    written
}

fn write(
    log: &Database,
    missing: &[(&'static str, &'static str)],
    file: &Path,
) -> Result<(), IndexError> {
    let cache =
        |source: rusqlite::Error| IndexError::Cache(format!("{}: {source}", file.display()));
    let mut index = Connection::open(file).map_err(cache)?;
    index
        .execute_batch(
            "PRAGMA journal_mode = OFF; PRAGMA synchronous = OFF; PRAGMA temp_store = MEMORY;",
        )
        .map_err(cache)?;
    index
        .execute("ATTACH DATABASE ?1 AS log", [immutable_uri(&log.path)])
        .map_err(cache)?;
    index
        .execute_batch("CREATE TABLE complete (name TEXT PRIMARY KEY)")
        .map_err(cache)?;
    let bytes = fs::metadata(&log.path)
        .map_err(|source| IndexError::Log(NuPlanError::file(&log.path, FileFault::Open(source))))?;
    harden(&mut index, bytes.len()).map_err(cache)?;
    for (table, column) in missing {
        let name = format!("{table}_{column}");
        index
            .execute_batch(&created("main", &name))
            .map_err(cache)?;
        // A row with NULL in the column belongs to no frame.
        let filled = format!(
            "INSERT INTO {name} SELECT \"{column}\", rowid FROM log.{table} WHERE \"{column}\" IS NOT NULL ORDER BY 1, 2"
        );
        index
            .execute(&filled, [])
            .map_err(|source| match source.sqlite_error_code() {
                Some(
                    rusqlite::ErrorCode::DatabaseCorrupt
                    | rusqlite::ErrorCode::OperationInterrupted,
                ) => IndexError::Log(log.failed(table, source)),
                _ => cache(source),
            })?;
        index
            .execute("INSERT INTO complete VALUES (?1)", [name])
            .map_err(cache)?;
    }
    index.close().map_err(|(_, source)| cache(source))
}

/// Removes the indices of former states of a log, and what dead processes left of any index, as far
/// as possible.
fn remove_stale(folder: &Path, stem: &str, current: &str) {
    let Ok(entries) = fs::read_dir(folder) else {
        return;
    };
    for entry in entries.flatten() {
        let name = entry.file_name();
        let name = name.to_string_lossy();
        let is_former =
            name.starts_with(stem) && name.ends_with(&format!(".{ENDING}")) && name != current;
        let is_left = || {
            let written = entry.metadata().and_then(|entry| entry.modified());
            let age = written.ok().and_then(|written| written.elapsed().ok());
            name.ends_with(UNFINISHED) && age.is_some_and(|age| age > MAX_BUILD)
        };
        if is_former || is_left() {
            let _ = fs::remove_file(entry.path());
        }
    }
}

/// A folder in that of what can be made again.
pub(super) fn default_folder() -> Option<PathBuf> {
    planagent_files::cache_folder().map(|folder| folder.join("nuplan"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_dead_processes_left_is_deleted() {
        let cache = tempfile::tempdir().unwrap();
        let [former, now, left, alive, other] = [
            "ab-1.1.index",
            "ab-2.1.index",
            "cd-1.1.7-0.tmp",
            "cd-1.1.8-0.tmp",
            "cd-1.1.index",
        ];
        for name in [former, now, left, alive, other] {
            fs::write(cache.path().join(name), "").unwrap();
        }
        let file = fs::File::options()
            .append(true)
            .open(cache.path().join(left))
            .unwrap();
        let long_ago = std::time::SystemTime::now() - 2 * MAX_BUILD;
        file.set_modified(long_ago).unwrap();
        remove_stale(cache.path(), "ab", now);
        let names = fs::read_dir(cache.path()).unwrap();
        let mut names: Vec<_> = names.map(|entry| entry.unwrap().file_name()).collect();
        names.sort();
        assert_eq!(names, [now, alive, other]);
    }
}
