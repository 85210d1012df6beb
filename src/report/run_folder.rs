//! The folder of a run. It grows drive by drive: a drive that has ended has a folder of its own under `drives/`, which gets
//! its name when it is complete, so that a kill at any moment loses no more than the drives under way.

use super::atomic::{self, UNFINISHED};
use super::call_record::call_record;
use super::error::ReportError;
use super::manifest::{MANIFEST, Manifest};
use super::number::unsigned_metric;
use super::replay::Replay;
use super::simulation_row::SimulationRow;
use super::transcript::transcript;
use crate::experiment::run::{SimulationOutcome, SimulationRecord, SimulationTask};
use crate::metrics::MetricResult;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File, TryLockError};
use std::path::{Path, PathBuf};

/// Parent of the folders that are numbered.
const RUNS: &str = "runs";
/// Folder of the drives.
const SIMULATIONS: &str = "simulations";
/// What a drive's folder holds: the row of the drive,
const RECORD: &str = "record.toml";
/// its metrics with statistics and time series,
const METRICS: &str = "metrics.toml";
/// and its planning calls.
pub(super) const CALLS: &str = "calls.jsonl";
/// File that a running process holds locked.
const LOCK: &str = ".lock";
/// Digits of a drive's number in the name of its folder.
const DIGITS: usize = 6;
/// Most characters of the scenario's name in the name of a folder; file systems end at 255 bytes.
const MOST_NAME: usize = 80;

/// The folder of a run, locked against other processes for as long as this lives.
#[derive(Debug)]
pub struct RunFolder {
    path: PathBuf,
    _lock: File,
}

/// The drives that a folder holds.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Recorded {
    /// What was read, by number.
    pub rows: Vec<SimulationRow>,
    /// Records that are damaged (a disk that lost power); they count as not driven.
    pub damaged: Vec<PathBuf>,
}

/// `metrics.toml`.
#[derive(Serialize, Deserialize)]
struct MetricsFile {
    metrics: Vec<MetricResult>,
}

impl RunFolder {
    /// Makes the folder of a new run with its manifest; without a name, the next free `runs/NNNN`. Called before the
    /// drives, so that hours of driving do not end at a folder that cannot be written.
    ///
    /// # Errors
    /// When it cannot be made or written, is not empty, or holds a run.
    pub fn create(path: Option<&Path>, manifest: &Manifest) -> Result<Self, ReportError> {
        let path = path.map_or_else(next_free, Path::to_owned);
        if path.join(MANIFEST).exists() {
            return Err(ReportError::AlreadyRun(path));
        }
        atomic::folder(&path)?;
        let entries = fs::read_dir(&path).map_err(ReportError::read(&path))?;
        for entry in entries {
            let name = entry.map_err(ReportError::read(&path))?.file_name();
            let name = name.to_string_lossy();
            // A process that was killed before its manifest was there left nothing of worth.
            if name != LOCK && !name.starts_with(UNFINISHED) {
                return Err(ReportError::NotEmpty(path));
            }
        }
        let folder = Self::locked(path)?;
        if folder.path.join(MANIFEST).exists() {
            return Err(ReportError::AlreadyRun(folder.path));
        }
        // The manifest comes first: from then on the folder is that of a run, which can be gone on with.
        folder.write(MANIFEST, toml::to_string_pretty(manifest)?.as_bytes())?;
        folder.write_config(manifest)?;
        atomic::folder(&folder.path.join(SIMULATIONS))?;
        Ok(folder)
    }

    /// The manifest of the run in a folder.
    ///
    /// # Errors
    /// When there is none, or it cannot be read.
    pub fn manifest(path: &Path) -> Result<Manifest, ReportError> {
        let file = path.join(MANIFEST);
        if !file.is_file() {
            return Err(ReportError::NoRun(path.to_owned()));
        }
        parse(&file)
    }

    /// Opens the folder of a run to go on with it; `now` is what it would be started with today.
    ///
    /// # Errors
    /// When there is none, another process is at it, or it was started otherwise.
    pub fn resume(path: &Path, now: &Manifest) -> Result<(Self, Manifest), ReportError> {
        let manifest = Self::manifest(path)?;
        let differences = manifest.differences(now);
        if !differences.is_empty() {
            return Err(ReportError::Differs { path: path.to_owned(), differences });
        }
        let folder = Self::locked(path.to_owned())?;
        atomic::folder(&folder.path.join(SIMULATIONS))?;
        atomic::sweep(&folder.path)?;
        atomic::sweep(&folder.path.join(SIMULATIONS))?;
        Ok((folder, manifest))
    }

    fn locked(path: PathBuf) -> Result<Self, ReportError> {
        let file = path.join(LOCK);
        let lock = File::options().create(true).append(true).open(&file).map_err(ReportError::write(&file))?;
        match lock.try_lock() {
            Ok(()) => Ok(Self { path, _lock: lock }),
            Err(TryLockError::WouldBlock) => Err(ReportError::Locked(path)),
            Err(TryLockError::Error(source)) => Err(ReportError::Write { path: file, source }),
        }
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Writes what is kept of a drive: its row, its metrics, its replay, its calls with transcript and BEV maps. All of it is there
    /// afterwards, or nothing.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn commit(&self, number: usize, record: &SimulationRecord) -> Result<(), ReportError> {
        let folder = self.path.join(SIMULATIONS).join(folder_name(number, record));
        let unfinished = atomic::unfinished(&folder);
        atomic::folder(&unfinished)?;
        if let Ok(driven) = &record.outcome {
            write_calls(&unfinished, record, driven)?;
            let metrics = MetricsFile { metrics: driven.metrics.iter().map(unsigned_metric).collect() };
            atomic::create(&unfinished.join(METRICS), toml::to_string(&metrics)?.as_bytes())?;
            Replay::of(driven).write(&unfinished)?;
        }
        let row = toml::to_string(&SimulationRow::new(number, record))?;
        atomic::create(&unfinished.join(RECORD), row.as_bytes())?;
        fs::rename(&unfinished, &folder).map_err(ReportError::write(&folder))
    }

    /// The folders of the drives that have ended, by number.
    fn folders(&self) -> Result<BTreeMap<usize, PathBuf>, ReportError> {
        folders(&self.path)
    }

    /// The drives that have ended in a folder. Nothing is locked or changed, and what the run is made of is not looked at.
    ///
    /// # Errors
    /// When a record cannot be read.
    pub fn ended(path: &Path) -> Result<Recorded, ReportError> {
        let mut recorded = Recorded::default();
        for (number, folder) in folders(path)? {
            let path = folder.join(RECORD);
            match parse::<SimulationRow>(&path) {
                Ok(row) if row.number == number => recorded.rows.push(row),
                Ok(row) => {
                    let (found, expected) = (row.identity(), format!("simulation {number}"));
                    return Err(ReportError::Foreign { path, found, expected });
                }
                Err(ReportError::Parse { .. }) => recorded.damaged.push(folder),
                Err(error) => return Err(error),
            }
        }
        Ok(recorded)
    }

    /// The drives that have ended, checked against what the run is made of. Records that are damaged are removed.
    ///
    /// # Errors
    /// When a record cannot be read or belongs to another drive.
    pub fn recorded(&self, tasks: &[SimulationTask]) -> Result<Recorded, ReportError> {
        let recorded = Self::ended(&self.path)?;
        for row in &recorded.rows {
            let expected = tasks.get(row.number).map_or_else(|| "nothing".to_owned(), SimulationTask::to_string);
            if row.identity() != expected {
                let folder = self.folders()?.remove(&row.number).unwrap_or_default();
                return Err(ReportError::Foreign { path: folder.join(RECORD), found: row.identity(), expected });
            }
        }
        for folder in &recorded.damaged {
            remove(folder)?;
        }
        Ok(recorded)
    }

    /// Takes back drives that have ended, so that they can be made again.
    ///
    /// # Errors
    /// When a folder cannot be removed.
    pub fn discard(&self, numbers: &BTreeSet<usize>) -> Result<(), ReportError> {
        let folders = self.folders()?;
        folders.iter().filter(|(number, _)| numbers.contains(number)).try_for_each(|(_, folder)| remove(folder))
    }

    /// The metrics of drives, in the order of their numbers.
    pub(super) fn metrics<'a>(
        &self,
        rows: impl Iterator<Item = &'a SimulationRow> + Clone,
    ) -> Result<impl Iterator<Item = Result<(&'a SimulationRow, Vec<MetricResult>), ReportError>> + Clone, ReportError>
    {
        let folders = self.folders()?;
        let of_row = move |row: &'a SimulationRow| folders.get(&row.number).map(|folder| (row, folder.clone()));
        Ok(rows.filter_map(of_row).map(|(row, folder)| Ok((row, Self::metrics_in(&folder)?))))
    }

    /// The metrics in a drive's folder.
    ///
    /// # Errors
    /// When they cannot be read.
    pub(super) fn metrics_in(folder: &Path) -> Result<Vec<MetricResult>, ReportError> {
        parse::<MetricsFile>(&folder.join(METRICS)).map(|file| file.metrics)
    }

    /// Joins the planning calls of all drives to one file.
    pub(super) fn join_calls(&self) -> Result<(), ReportError> {
        let path = self.path.join(CALLS);
        let temporary = atomic::unfinished(&path);
        let mut all = File::create(&temporary).map_err(ReportError::write(&temporary))?;
        for folder in self.folders()?.values() {
            let part = folder.join(CALLS);
            if part.is_file() {
                let mut part = File::open(&part).map_err(ReportError::read(&part))?;
                std::io::copy(&mut part, &mut all).map_err(ReportError::write(&temporary))?;
            }
        }
        fs::rename(&temporary, &path).map_err(ReportError::write(&path))
    }

    /// Writes the configuration as a file that `--config` takes.
    pub(super) fn write_config(&self, manifest: &Manifest) -> Result<(), ReportError> {
        self.write("config.toml", toml::to_string_pretty(&manifest.config)?.as_bytes())
    }

    /// Writes a file of the folder, whole or not at all.
    pub(super) fn write(&self, name: &str, bytes: &[u8]) -> Result<(), ReportError> {
        atomic::write(&self.path.join(name), bytes)
    }
}

/// The folders of the drives that have ended in a run's folder, by number.
pub(super) fn folders(run: &Path) -> Result<BTreeMap<usize, PathBuf>, ReportError> {
    let simulations = run.join(SIMULATIONS);
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(&simulations).map_err(ReportError::read(&simulations))? {
        let path = entry.map_err(ReportError::read(&simulations))?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let number = name.split_once('-').and_then(|(digits, _)| digits.parse().ok());
        if let Some(number) = number {
            found.insert(number, path);
        }
    }
    Ok(found)
}

/// Calls, transcript and BEV maps of a drive with planning calls.
fn write_calls(folder: &Path, record: &SimulationRecord, driven: &SimulationOutcome) -> Result<(), ReportError> {
    if driven.calls.is_empty() {
        return Ok(());
    }
    let mut lines = String::new();
    let planner = record.planner.as_str();
    for call in &driven.calls {
        let value = call_record(&record.scenario, planner, Some(record.challenge), call);
        lines.push_str(&serde_json::to_string(&value)?);
        lines.push('\n');
    }
    atomic::create(&folder.join(CALLS), lines.as_bytes())?;
    atomic::folder(&folder.join("bev"))?;
    for call in &driven.calls {
        if let Some(image) = &call.image {
            let path = folder.join(bev_name(call.iteration));
            image.save(&path).map_err(|source| ReportError::Image { path, source })?;
        }
    }
    let text = transcript(record, driven, |call| call.image.as_ref().map(|_| bev_name(call.iteration)));
    atomic::create(&folder.join("transcript.md"), text.as_bytes())
}

/// Where the BEV map of a planning call lies in a drive's folder.
pub(super) fn bev_name(iteration: usize) -> String {
    format!("bev/{iteration:03}.png")
}

/// Removes a drive's folder; a kill in between leaves nothing that looks whole.
fn remove(folder: &Path) -> Result<(), ReportError> {
    let condemned = atomic::unfinished(folder);
    fs::rename(folder, &condemned).map_err(ReportError::write(folder))?;
    fs::remove_dir_all(&condemned).map_err(ReportError::write(&condemned))
}

/// `NNNNNN-SCENARIO-PLANNER-CHALLENGE`, in characters that every file system takes.
fn folder_name(number: usize, record: &SimulationRecord) -> String {
    let safe = |c: char| if c.is_ascii_alphanumeric() || "-_.".contains(c) { c } else { '_' };
    let scenario: String = record.scenario.chars().map(safe).take(MOST_NAME).collect();
    format!("{number:0DIGITS$}-{scenario}-{}-{}", record.planner, record.challenge.short_name())
}

fn parse<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T, ReportError> {
    let text = fs::read_to_string(path).map_err(ReportError::read(path))?;
    toml::from_str(&text).map_err(|source| ReportError::Parse { path: path.to_owned(), source: Box::new(source) })
}

/// The first `runs/NNNN` that does not exist.
fn next_free() -> PathBuf {
    let runs = Path::new(RUNS);
    let mut number = 1u32;
    loop {
        let path = runs.join(format!("{number:04}"));
        if !path.exists() {
            return path;
        }
        number += 1;
    }
}
