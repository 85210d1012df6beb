//! The folder of a run: created, locked, resumed.
//!
//! A simulation gets its folder under `simulations/` when it is complete. A process that is killed
//! at any moment loses only the simulations in progress.

use super::atomic::{self, UNFINISHED};
use super::error::{ReportError, ReportFault};
use super::inputs::AcceptedChanges;
use super::layout::{CALLS, CONFIG, LOCK, MANIFEST, RECORD, RUNS, SIMULATIONS};
use super::manifest::{FORMAT_VERSION, Manifest};
use super::simulation_folder;
use super::simulation_row::SimulationRow;
use super::writable::check_writable;
use crate::worker::run::{SimulationRecord, SimulationTask};
use planagent_score::metrics::MetricResult;
use rayon::prelude::*;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};
use std::thread;
use std::time::Duration;

/// The folder of a run, locked against other processes as long as this lives.
#[derive(Debug)]
pub struct RunFolder {
    path: PathBuf,
    _lock: File,
}

/// The completed simulations of a run.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct CompletedSimulations {
    /// Their rows by number.
    pub rows: Vec<SimulationRow>,
    /// Folders with a damaged record or damaged results, for example after a power failure; they do
    /// not count as completed.
    pub damaged: Vec<PathBuf>,
}

/// What a run has before its first simulation.
const BEGUN: [&str; 3] = [MANIFEST, CONFIG, SIMULATIONS];

/// How often a locked folder is tried again, and the time between two tries.
const LOCK_TRIES: usize = 3;
const LOCK_PAUSE: Duration = Duration::from_millis(10);

/// The part of a manifest that every format has.
#[derive(Deserialize)]
struct AnyManifest {
    #[serde(default)]
    format_version: u32,
}

impl RunFolder {
    /// Creates the folder of a new run with its manifest; without a path, the next free
    /// `runs/NNNN`.
    ///
    /// # Errors
    /// When the folder cannot be written, is not empty, or holds a run. The first simulation has
    /// not started then.
    pub fn create(path: Option<&Path>, manifest: &Manifest) -> Result<Self, ReportError> {
        Self::check_new(path)?;
        let path = path.map_or_else(next_free, Path::to_owned);
        atomic::folder(&path)?;
        let folder = Self::locked(path)?;
        check_holds_no_run(&folder.path)?;
        // The manifest comes first: from then on the run can be resumed.
        folder.write_manifest(manifest)?;
        folder.write_config(manifest)?;
        atomic::folder(&folder.path.join(SIMULATIONS))?;
        Ok(folder)
    }

    /// Checks that a run can be created in a folder, without a path in the next free `runs/NNNN`.
    /// Leaves nothing behind.
    ///
    /// # Errors
    /// When the folder holds a run or other files, something else stands where it should be, or it
    /// cannot be written.
    pub(crate) fn check_new(path: Option<&Path>) -> Result<(), ReportError> {
        let path = &path.map_or_else(next_free, Path::to_owned);
        check_holds_no_run(path)?;
        check_writable(path)?;
        if !path.exists() {
            return Ok(());
        }
        let begun = path.join(MANIFEST).exists();
        for entry in fs::read_dir(path).map_err(ReportError::read(path))? {
            let name = entry.map_err(ReportError::read(path))?.file_name();
            let name = name.to_string_lossy();
            // A process that was killed before its manifest was whole left no results.
            let is_leftover =
                name == LOCK || name.starts_with(UNFINISHED) || begun && BEGUN.contains(&&*name);
            if !is_leftover {
                return Err(ReportError::at(path)(ReportFault::NotEmpty));
            }
        }
        Ok(())
    }

    /// Checks that the run in a folder can be resumed as far as the folder is concerned.
    ///
    /// # Errors
    /// When the folder cannot be written, or another process runs in it.
    pub(crate) fn check_resumable(path: &Path) -> Result<(), ReportError> {
        check_writable(path)?;
        Self::locked(path.to_owned()).map(|_| ())
    }

    /// The manifest of the run in a folder.
    ///
    /// # Errors
    /// When the folder holds no run, one of another format version, or the manifest is damaged.
    pub fn manifest(path: &Path) -> Result<Manifest, ReportError> {
        if !path.join(MANIFEST).is_file() {
            let fault = if path.is_dir() {
                ReportFault::NoRun
            } else {
                ReportFault::Absent
            };
            return Err(ReportError::at(path)(fault));
        }
        match read_manifest(path) {
            Err(error) if error.fault.is_damage() && !has_simulations(path) => {
                Err(ReportError::at(path)(ReportFault::NotBegun))
            }
            read => read,
        }
    }

    /// Opens the folder of a run to resume it; `now` is the manifest that a new run would have.
    /// With `accept_changes`, inputs may have changed: the manifest then says so. Gives the
    /// manifest and what was accepted now.
    ///
    /// # Errors
    /// When the folder holds no run, another process runs in it, the two manifests differ, or
    /// inputs changed.
    pub fn resume(
        path: &Path,
        now: &Manifest,
        accept_changes: bool,
    ) -> Result<(Self, Manifest, Vec<String>), ReportError> {
        let mut manifest = Self::manifest(path)?;
        let changes = manifest.changed_inputs(now);
        Self::check_inputs(path, &changes, accept_changes)?;
        // The digest of all prompts is that of the files in the changes.
        let prompts = if changes.is_empty() {
            now.prompts.clone()
        } else {
            manifest.prompts.clone()
        };
        let differences = manifest.differences(&Manifest {
            prompts,
            ..now.clone()
        });
        if !differences.is_empty() {
            return Err(ReportError::at(path)(ReportFault::Differs(differences)));
        }
        let folder = Self::locked(path.to_owned())?;
        atomic::folder(&folder.path.join(SIMULATIONS))?;
        atomic::sweep(&folder.path)?;
        atomic::sweep(&folder.path.join(SIMULATIONS))?;
        if !changes.is_empty() {
            manifest.accepted.push(AcceptedChanges {
                resumed: now.started.clone(),
                changes: changes.clone(),
            });
        }
        if !changes.is_empty() || manifest.inputs.is_none() {
            manifest.inputs.clone_from(&now.inputs);
            manifest.prompts.clone_from(&now.prompts);
            folder.write_manifest(&manifest)?;
        }
        Ok((folder, manifest, changes))
    }

    /// Refuses changed inputs, unless they are accepted.
    pub fn check_inputs(
        path: &Path,
        changes: &[String],
        accept_changes: bool,
    ) -> Result<(), ReportError> {
        if changes.is_empty() || accept_changes {
            return Ok(());
        }
        Err(ReportError::at(path)(ReportFault::InputsChanged(
            changes.to_vec(),
        )))
    }

    fn write_manifest(&self, manifest: &Manifest) -> Result<(), ReportError> {
        let text = toml::to_string_pretty(manifest).map_err(ReportError::at(&self.path))?;
        self.write(MANIFEST, text.as_bytes())
    }

    fn locked(path: PathBuf) -> Result<Self, ReportError> {
        let file = path.join(LOCK);
        let lock = File::options()
            .create(true)
            .append(true)
            .open(&file)
            .map_err(ReportError::write(&file))?;
        let mut locked = lock.try_lock();
        // A page that asks whether somebody works here holds the lock for an instant.
        for _ in 0..LOCK_TRIES {
            if !matches!(locked, Err(TryLockError::WouldBlock)) {
                break;
            }
            thread::sleep(LOCK_PAUSE);
            locked = lock.try_lock();
        }
        match locked {
            Ok(()) => Ok(Self { path, _lock: lock }),
            Err(TryLockError::WouldBlock) => Err(ReportError::at(&path)(ReportFault::Locked)),
            Err(TryLockError::Error(error)) => Err(ReportError::write(&file)(error)),
        }
    }

    /// Whether a process works in the folder of a run. It is asked by a lock that many may share,
    /// for an instant.
    pub(crate) fn is_running(path: &Path) -> bool {
        let lock = File::open(path.join(LOCK));
        lock.is_ok_and(|lock| matches!(lock.try_lock_shared(), Err(TryLockError::WouldBlock)))
    }

    /// The path of the folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Writes the folder of a completed simulation: all of it, or nothing.
    pub fn commit(&self, number: usize, record: &SimulationRecord) -> Result<(), ReportError> {
        simulation_folder::write(&self.path.join(SIMULATIONS), number, record)
    }

    /// The completed simulations of the run in a folder, without a lock and without a look at the
    /// manifest.
    ///
    /// # Errors
    /// When a record cannot be read or is in the folder of another simulation.
    pub fn read_completed(path: &Path) -> Result<CompletedSimulations, ReportError> {
        let mut completed = CompletedSimulations::default();
        let folders: Vec<(usize, PathBuf)> = folders(path)?.into_iter().collect();
        let read = folders.into_par_iter().map(|(number, folder)| {
            let row = read_toml::<SimulationRow>(&folder.join(RECORD));
            let is_whole = row
                .as_ref()
                .is_ok_and(|row| simulation_folder::is_whole(&folder, row));
            (number, folder, row, is_whole)
        });
        for (number, folder, row, is_whole) in read.collect::<Vec<_>>() {
            let path = folder.join(RECORD);
            match row {
                Ok(row) if row.number == number && !is_whole => completed.damaged.push(folder),
                Ok(row) if row.number == number => completed.rows.push(row),
                Ok(row) => return Err(wrong_record(&path, &row, format!("simulation {number}"))),
                Err(ReportError {
                    fault: ReportFault::Toml(_),
                    ..
                }) => completed.damaged.push(folder),
                Err(error) => return Err(error),
            }
        }
        Ok(completed)
    }

    /// The completed simulations, checked against the tasks of the run. Damaged records are
    /// deleted.
    ///
    /// # Errors
    /// When a record cannot be read or belongs to another task.
    pub fn completed(&self, tasks: &[SimulationTask]) -> Result<CompletedSimulations, ReportError> {
        let completed = Self::read_completed(&self.path)?;
        for row in &completed.rows {
            let expected = tasks
                .get(row.number)
                .map_or_else(|| "nothing".to_owned(), SimulationTask::to_string);
            if row.identity() != expected {
                let folder = folders(&self.path)?
                    .remove(&row.number)
                    .unwrap_or_else(|| self.path.join(SIMULATIONS));
                return Err(wrong_record(&folder.join(RECORD), row, expected));
            }
        }
        completed
            .damaged
            .iter()
            .try_for_each(|folder| simulation_folder::remove(folder))?;
        Ok(completed)
    }

    /// Copies the folder of a completed simulation from another run: all of it, or nothing.
    pub(crate) fn adopt(&self, simulation: &Path) -> Result<(), ReportError> {
        simulation_folder::copy(simulation, &self.path.join(SIMULATIONS))
    }

    /// Deletes completed simulations, so that they run again.
    pub(crate) fn discard(&self, numbers: &BTreeSet<usize>) -> Result<(), ReportError> {
        let discarded = folders(&self.path)?
            .into_iter()
            .filter(|(number, _)| numbers.contains(number));
        discarded
            .map(|(_, folder)| folder)
            .try_for_each(|folder| simulation_folder::remove(&folder))
    }

    /// The metrics of simulations, in the order of `rows`.
    pub(super) fn metrics<'a>(
        &self,
        rows: impl Iterator<Item = &'a SimulationRow> + Clone,
    ) -> Result<
        impl Iterator<Item = Result<(&'a SimulationRow, Vec<MetricResult>), ReportError>> + Clone,
        ReportError,
    > {
        let folders = folders(&self.path)?;
        let of_row = move |row: &'a SimulationRow| {
            folders.get(&row.number).map(|folder| (row, folder.clone()))
        };
        Ok(rows
            .filter_map(of_row)
            .map(|(row, folder)| Ok((row, simulation_folder::metrics(&folder)?))))
    }

    /// Joins the planning calls of all simulations to one file.
    pub(super) fn join_calls(&self) -> Result<(), ReportError> {
        let path = self.path.join(CALLS);
        let temporary = atomic::unfinished(&path);
        let mut all = File::create(&temporary).map_err(ReportError::write(&temporary))?;
        for folder in folders(&self.path)?.values() {
            let part = folder.join(CALLS);
            if part.is_file() {
                let mut part = File::open(&part).map_err(ReportError::read(&part))?;
                io::copy(&mut part, &mut all).map_err(ReportError::write(&temporary))?;
            }
        }
        fs::rename(&temporary, &path).map_err(ReportError::write(&path))
    }

    /// Writes the configuration as a file for `--config`.
    pub(super) fn write_config(&self, manifest: &Manifest) -> Result<(), ReportError> {
        let text = toml::to_string_pretty(&manifest.config).map_err(ReportError::at(&self.path))?;
        self.write(CONFIG, text.as_bytes())
    }

    /// Writes a file of the folder: all of it, or nothing.
    pub(super) fn write(&self, name: &str, bytes: &[u8]) -> Result<(), ReportError> {
        atomic::write(&self.path.join(name), bytes)
    }
}

/// Fails if a folder holds a run, with what can be done about it. A damaged manifest without
/// simulations is no run: a process that died while it started left it.
fn check_holds_no_run(path: &Path) -> Result<(), ReportError> {
    let file = path.join(MANIFEST);
    if !file.exists() {
        return Ok(());
    }
    let fault = match read_manifest(path) {
        Ok(_) => ReportFault::AlreadyRun,
        Err(ReportError {
            fault: ReportFault::FormatVersion { found },
            ..
        }) => ReportFault::OldRun { found },
        Err(error) if error.fault.is_damage() && !has_simulations(path) => return Ok(()),
        Err(error) if error.fault.is_damage() => ReportFault::DamagedManifest,
        Err(error) => return Err(error),
    };
    Err(ReportError::at(path)(fault))
}

/// The manifest of this format version.
fn read_manifest(run: &Path) -> Result<Manifest, ReportError> {
    let file = run.join(MANIFEST);
    match read_toml(&file)? {
        AnyManifest {
            format_version: FORMAT_VERSION,
        } => read_toml(&file),
        // The first formats had no number.
        AnyManifest { format_version: 0 } if is_blank(&file) => {
            Err(ReportError::at(run)(ReportFault::DamagedManifest))
        }
        AnyManifest {
            format_version: found,
        } => Err(ReportError::at(run)(ReportFault::FormatVersion { found })),
    }
}

/// Whether a file was cut off before its first line.
fn is_blank(file: &Path) -> bool {
    planagent_files::read_text(file, planagent_files::MAX_LIST_BYTES)
        .is_ok_and(|text| text.trim().is_empty())
}

/// Whether a run has simulations, as far as that can be seen.
fn has_simulations(run: &Path) -> bool {
    folders(run).map_or_else(
        |_| run.join(SIMULATIONS).exists(),
        |simulations| !simulations.is_empty(),
    )
}

/// The folders of the completed simulations of a run, by number.
pub fn folders(run: &Path) -> Result<BTreeMap<usize, PathBuf>, ReportError> {
    let simulations = run.join(SIMULATIONS);
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(&simulations).map_err(ReportError::read(&simulations))? {
        let path = entry.map_err(ReportError::read(&simulations))?.path();
        let name = path
            .file_name()
            .expect("an entry of a folder has a name")
            .to_string_lossy();
        let number = name
            .split_once('-')
            .and_then(|(digits, _)| digits.parse().ok());
        if let Some(number) = number {
            found.insert(number, path);
        }
    }
    Ok(found)
}

fn wrong_record(path: &Path, row: &SimulationRow, expected: String) -> ReportError {
    ReportError::at(path)(ReportFault::WrongRecord {
        found: row.identity(),
        expected,
    })
}

/// Reads a TOML file.
pub(super) fn read_toml<T: DeserializeOwned>(path: &Path) -> Result<T, ReportError> {
    let text = planagent_files::read_text(path, planagent_files::MAX_LIST_BYTES)
        .map_err(ReportError::read(path))?;
    toml::from_str(&text).map_err(|error| ReportError::at(path)(Box::new(error)))
}

/// The first `runs/NNNN` that does not exist.
fn next_free() -> PathBuf {
    let path = |number: u32| Path::new(RUNS).join(format!("{number:04}"));
    (1..u32::MAX)
        .map(path)
        .find(|path| !path.exists())
        .unwrap_or_else(|| path(u32::MAX))
}
