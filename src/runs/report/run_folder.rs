//! The folder of a run: created, locked, resumed.
//!
//! A simulation gets its folder under `simulations/` when it is complete. A process that is killed
//! at any moment loses only the simulations in progress.

use super::error::{Holder, ReportError, ReportFault};
use super::inputs::AcceptedChanges;
use super::layout::{CALLS, CONFIG, LOCK, MANIFEST, RECORD, RUNS, SIMULATIONS, SUMMARY};
use super::limits::{MAX_CALLS_BYTES, MAX_RECORD_BYTES};
use super::manifest::Manifest;
use super::manifest_file::{self, check_holds_no_run, has_simulations};
use super::run_files::{RunFiles, SimulationFolder, read_present, read_toml};
use super::runs;
use super::simulation_folder;
use super::simulation_row::SimulationRow;
use super::writable::check_writable;
use crate::worker::run::{SimulationRecord, SimulationTask};
use planagent_files::{EntryKind, OpenFolder, UNFINISHED, WholeFile};
use planagent_score::metrics::MetricResult;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::fs::{File, TryLockError};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process;
use std::thread;
use std::time::Duration;

/// The folder of a run, locked against other processes as long as this lives. All is written by
/// its handle: a folder that was moved gets what was written, and none takes its place.
#[derive(Debug)]
pub struct RunFolder {
    files: RunFiles,
    simulations: OpenFolder,
    _lock: File,
}

/// A folder of a run that is not complete yet.
struct Locked {
    files: RunFiles,
    lock: File,
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

/// Largest lock that is read, bytes: the number of a process.
const MAX_LOCK_BYTES: u64 = 64;

/// What a run has before its first simulation.
const BEGUN: [&str; 3] = [MANIFEST, CONFIG, SIMULATIONS];

/// How often a locked folder is tried again, and the time between two tries.
const LOCK_TRIES: usize = 3;
const LOCK_PAUSE: Duration = Duration::from_millis(10);

impl RunFolder {
    /// Creates the folder of a new run with its manifest; without a path, the next free
    /// `runs/NNNN`.
    ///
    /// # Errors
    /// When the folder cannot be written, is not empty, or holds a run. The first simulation has
    /// not started then.
    pub fn create(path: Option<&Path>, manifest: &Manifest) -> Result<Self, ReportError> {
        let root = match path {
            Some(path) => {
                Self::check_new(Some(path))?;
                OpenFolder::create(path).map_err(ReportError::write(path))?
            }
            None => runs::next_free()?,
        };
        let locked = Locked::new(RunFiles::in_folder(root))?;
        check_holds_no_run(&locked.files)?;
        let text = manifest_file::text(locked.files.root().path(), manifest)?;
        // The manifest comes first: from then on the run can be resumed.
        locked.write(MANIFEST, &text)?;
        let folder = locked.with_simulations()?;
        folder.write_config(manifest)?;
        Ok(folder)
    }

    /// Checks that a run can be created in a folder, without a path in the next free `runs/NNNN`.
    /// Leaves nothing behind.
    ///
    /// # Errors
    /// When the folder holds a run or other files, something else stands where it should be, or it
    /// cannot be written.
    pub(crate) fn check_new(path: Option<&Path>) -> Result<(), ReportError> {
        let Some(path) = path else {
            return check_writable(Path::new(RUNS));
        };
        if !path.is_dir() {
            return check_writable(path);
        }
        let files = RunFiles::open(path)?;
        check_holds_no_run(&files)?;
        check_writable(path)?;
        let begun = files.has(MANIFEST)?;
        for name in files.root().names().map_err(ReportError::read(path))? {
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
        Locked::new(RunFiles::open(path)?).map(|_| ())
    }

    /// Whether a folder holds a run that began.
    ///
    /// # Errors
    /// When a link or something else stands in the place of its manifest.
    pub fn is_begun(path: &Path) -> Result<bool, ReportError> {
        has(path, MANIFEST)
    }

    /// Whether the run in a folder wrote its results.
    ///
    /// # Errors
    /// When a link or something else stands in the place of its summary.
    pub fn has_results(path: &Path) -> Result<bool, ReportError> {
        has(path, SUMMARY)
    }

    /// The manifest of the run in a folder.
    ///
    /// # Errors
    /// When the folder holds no run, one of another format version, or the manifest is damaged.
    pub fn manifest(path: &Path) -> Result<Manifest, ReportError> {
        Self::manifest_in(&RunFiles::open(path)?)
    }

    /// The manifest of the run in an open folder.
    pub(super) fn manifest_in(files: &RunFiles) -> Result<Manifest, ReportError> {
        let path = files.root().path();
        if !files.has(MANIFEST)? {
            return Err(ReportError::at(path)(ReportFault::NoRun));
        }
        match manifest_file::read(files) {
            Err(error) if error.fault.is_damage() && !has_simulations(files) => {
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
        let folder = Locked::new(RunFiles::open(path)?)?.with_simulations()?;
        sweep(folder.files.root())?;
        sweep(&folder.simulations)?;
        if !changes.is_empty() {
            manifest.accepted.push(AcceptedChanges {
                resumed: now.started.to_string(),
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
        self.write(MANIFEST, &manifest_file::text(self.path(), manifest)?)
    }

    /// Whether a process works in the folder of a run. It is asked by a lock that many may share,
    /// for an instant.
    pub(crate) fn is_running(path: &Path) -> bool {
        let lock = OpenFolder::open(path).and_then(|root| root.open_file(LOCK));
        lock.is_ok_and(|lock| matches!(lock.try_lock_shared(), Err(TryLockError::WouldBlock)))
    }

    /// The path of the folder.
    pub fn path(&self) -> &Path {
        self.files.root().path()
    }

    /// The open folder.
    pub(super) fn root(&self) -> &OpenFolder {
        self.files.root()
    }

    /// Whether the path still leads to this folder.
    pub fn is_in_place(&self) -> bool {
        self.simulations.is_in_place()
    }

    /// Fails once the folder was moved or deleted.
    pub(crate) fn check_in_place(&self) -> Result<(), ReportError> {
        if self.is_in_place() {
            return Ok(());
        }
        Err(ReportError::at(self.path())(ReportFault::Gone))
    }

    /// Whether the run wrote its results before.
    pub(crate) fn has_summary(&self) -> Result<bool, ReportError> {
        self.files.has(SUMMARY)
    }

    /// Writes the folder of a completed simulation: all of it, or nothing.
    ///
    /// # Errors
    /// When it cannot be written, and when the folder of the run was moved. A folder that was
    /// moved holds the simulation then.
    pub fn commit(&self, number: usize, record: &SimulationRecord) -> Result<(), ReportError> {
        let written = simulation_folder::write(&self.simulations, number, record);
        self.check_in_place()?;
        match written {
            // What was just written is missing: the folder is being deleted, file by file.
            Err(ReportError {
                fault: ReportFault::Write(error),
                ..
            }) if error.kind() == std::io::ErrorKind::NotFound => {
                Err(ReportError::at(self.path())(ReportFault::Gone))
            }
            written => written,
        }
    }

    /// The completed simulations of the run in a folder, without a lock and without a look at the
    /// manifest.
    ///
    /// # Errors
    /// When a record cannot be read or is in the folder of another simulation.
    pub fn read_completed(path: &Path) -> Result<CompletedSimulations, ReportError> {
        Self::completed_in(&RunFiles::open(path)?)
    }

    /// The completed simulations of the run in an open folder.
    pub(super) fn completed_in(files: &RunFiles) -> Result<CompletedSimulations, ReportError> {
        let mut completed = CompletedSimulations::default();
        let folders: Vec<(usize, SimulationFolder)> = files.folders()?.into_iter().collect();
        let read = folders.into_par_iter().map(|(number, folder)| {
            let read = folder.open().and_then(|open| {
                let row: SimulationRow = read_toml(&open, RECORD, MAX_RECORD_BYTES)?;
                let is_whole = simulation_folder::is_whole(&open, &row)?;
                Ok((row, is_whole))
            });
            (number, folder.path(), read)
        });
        for (number, folder, read) in read.collect::<Vec<_>>() {
            let path = folder.join(RECORD);
            match read {
                Ok((row, false)) if row.number == number => completed.damaged.push(folder),
                Ok((row, true)) if row.number == number => completed.rows.push(row),
                Ok((row, _)) => {
                    return Err(wrong_record(&path, &row, format!("simulation {number}")));
                }
                Err(error) if error.fault.is_damaged_record() => completed.damaged.push(folder),
                Err(error) => return Err(error),
            }
        }
        Ok(completed)
    }

    /// The completed simulations, checked against the tasks of the run. A simulation whose replay is
    /// lost or no gzip file counts as damaged. Damaged ones are deleted.
    ///
    /// # Errors
    /// When a record cannot be read or belongs to another task.
    pub fn completed(&self, tasks: &[SimulationTask]) -> Result<CompletedSimulations, ReportError> {
        let completed = self.with_replays(Self::completed_in(&self.files)?)?;
        for row in &completed.rows {
            let expected = tasks
                .get(row.number)
                .map_or_else(|| "nothing".to_owned(), SimulationTask::to_string);
            if row.identity() != expected {
                let folder = self.files.folders()?.remove(&row.number);
                let place = folder.map_or_else(
                    || self.root().path_of(SIMULATIONS),
                    |folder| folder.path().join(RECORD),
                );
                return Err(wrong_record(&place, row, expected));
            }
        }
        completed
            .damaged
            .iter()
            .filter_map(|folder| folder.file_name()?.to_str())
            .try_for_each(|name| simulation_folder::remove(&self.simulations, name))?;
        Ok(completed)
    }

    /// Counts simulations without their replay as damaged.
    fn with_replays(
        &self,
        mut completed: CompletedSimulations,
    ) -> Result<CompletedSimulations, ReportError> {
        let folders = self.files.folders()?;
        for row in std::mem::take(&mut completed.rows) {
            match folders.get(&row.number).filter(|_| row.error.is_none()) {
                Some(folder) if !simulation_folder::has_replay(&folder.open()?) => {
                    completed.damaged.push(folder.path());
                }
                _ => completed.rows.push(row),
            }
        }
        Ok(completed)
    }

    /// Copies the known files of a completed simulation from another run: all of them, or nothing.
    pub(crate) fn adopt(&self, simulation: &SimulationFolder) -> Result<(), ReportError> {
        simulation_folder::copy(simulation, &self.simulations)?;
        self.check_in_place()
    }

    /// Deletes completed simulations, so that they run again.
    pub(crate) fn discard(&self, numbers: &BTreeSet<usize>) -> Result<(), ReportError> {
        self.files
            .folders()?
            .into_iter()
            .filter(|(number, _)| numbers.contains(number))
            .try_for_each(|(_, folder)| simulation_folder::remove(&self.simulations, folder.name()))
    }

    /// The metrics of simulations, in the order of `rows`.
    pub(super) fn metrics<'a>(
        &self,
        rows: impl Iterator<Item = &'a SimulationRow> + Clone,
    ) -> Result<
        impl Iterator<Item = Result<(&'a SimulationRow, Vec<MetricResult>), ReportError>> + Clone,
        ReportError,
    > {
        let folders = self.files.folders()?;
        let of_row = move |row: &'a SimulationRow| {
            folders.get(&row.number).map(|folder| (row, folder.clone()))
        };
        Ok(rows
            .filter_map(of_row)
            .map(|(row, folder)| Ok((row, simulation_folder::metrics_of(&folder)?))))
    }

    /// Joins the planning calls of all simulations to one file.
    pub(super) fn join_calls(&self) -> Result<(), ReportError> {
        let path = self.root().path_of(CALLS);
        let mut all =
            WholeFile::create_in(self.root(), CALLS).map_err(ReportError::write(&path))?;
        for folder in self.files.folders()?.values() {
            if let Some(calls) = read_present(&folder.open()?, CALLS, MAX_CALLS_BYTES)? {
                all.write_all(&calls).map_err(ReportError::write(&path))?;
            }
        }
        all.finish().map_err(ReportError::write(&path))
    }

    /// Writes the configuration as a file for `--config`.
    pub(super) fn write_config(&self, manifest: &Manifest) -> Result<(), ReportError> {
        let text =
            toml::to_string_pretty(&manifest.config).map_err(ReportError::at(self.path()))?;
        self.write(CONFIG, text.as_bytes())
    }

    /// Writes a file of the folder: all of it, or nothing.
    pub(super) fn write(&self, name: &str, bytes: &[u8]) -> Result<(), ReportError> {
        write_in(self.root(), name, bytes)
    }
}

impl Locked {
    /// Locks a folder against other processes.
    ///
    /// # Errors
    /// When another process runs in it, or its lock is no regular file.
    fn new(files: RunFiles) -> Result<Self, ReportError> {
        let root = files.root();
        let place = root.path_of(LOCK);
        let lock = root.append_file(LOCK).map_err(ReportError::write(&place))?;
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
            Ok(()) => {
                // Who finds the lock can say who holds it. A full disk is no reason not to run.
                let _ = lock.set_len(0);
                let _ = writeln!(&lock, "{}", process::id());
            }
            Err(TryLockError::WouldBlock) => {
                let text = root.read_text(LOCK, MAX_LOCK_BYTES).ok();
                let process = text.and_then(|text| text.trim().parse().ok());
                return Err(ReportError::at(root.path())(ReportFault::Locked(Holder(
                    process,
                ))));
            }
            Err(TryLockError::Error(error)) => return Err(ReportError::write(&place)(error)),
        }
        Ok(Self { files, lock })
    }

    fn write(&self, name: &str, bytes: &[u8]) -> Result<(), ReportError> {
        write_in(self.files.root(), name, bytes)
    }

    /// The folder with that of its simulations.
    fn with_simulations(self) -> Result<RunFolder, ReportError> {
        let root = self.files.root();
        let simulations = root
            .make_subfolder(SIMULATIONS)
            .map_err(ReportError::write(&root.path_of(SIMULATIONS)))?;
        Ok(RunFolder {
            files: self.files,
            simulations,
            _lock: self.lock,
        })
    }
}

/// Writes a file of an open folder: all of it, or nothing.
pub(super) fn write_in(folder: &OpenFolder, name: &str, bytes: &[u8]) -> Result<(), ReportError> {
    folder
        .write(name, bytes)
        .map_err(ReportError::write(&folder.path_of(name)))
}

/// Deletes what a process that was killed left in a folder. A holder of the lock of the run may
/// delete all but the files that another process is writing, such as a page.
pub(super) fn sweep(folder: &OpenFolder) -> Result<(), ReportError> {
    let failed = |error| ReportError::write(folder.path())(error);
    folder.sweep_files().map_err(failed)?;
    for name in folder.names().map_err(failed)? {
        let Some(name) = name.to_str().filter(|name| name.starts_with(UNFINISHED)) else {
            continue;
        };
        let kind = folder.kind(name).map_err(failed)?;
        if kind.is_some_and(|kind| kind != EntryKind::File) {
            folder.remove(name).map_err(failed)?;
        }
    }
    Ok(())
}

fn has(path: &Path, name: &str) -> Result<bool, ReportError> {
    match RunFiles::open(path) {
        Ok(files) => files.has(name),
        Err(ReportError {
            fault: ReportFault::Absent,
            ..
        }) => Ok(false),
        Err(error) => Err(error),
    }
}

/// The folders of the completed simulations of a run, by number.
pub fn folders(run: &Path) -> Result<BTreeMap<usize, SimulationFolder>, ReportError> {
    RunFiles::open(run)?.folders()
}

fn wrong_record(path: &Path, row: &SimulationRow, expected: String) -> ReportError {
    ReportError::at(path)(ReportFault::WrongRecord {
        found: row.identity(),
        expected,
    })
}
