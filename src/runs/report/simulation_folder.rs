//! The folder of one simulation: record, metrics, replay, planning calls with transcript and BEV
//! maps.

use super::atomic;
use super::call_record::CallRecord;
use super::error::ReportError;
use super::layout::{BEV, CALLS, METRICS, RECORD, TRANSCRIPT, bev_name};
use super::number::without_negative_zeros;
use super::replay::Replay;
use super::run_folder::read_toml;
use super::simulation_row::SimulationRow;
use super::transcript::transcript;
use crate::worker::run::{SimulationOutcome, SimulationRecord};
use planagent_score::metrics::MetricResult;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

/// Digits of the number in the folder's name.
const DIGITS: usize = 6;
/// Maximum length of the scenario in the folder's name; file systems allow 255 bytes for all of it.
const MAX_SCENARIO_CHARS: usize = 80;

/// `metrics.toml`.
#[derive(Serialize, Deserialize)]
struct MetricsFile {
    metrics: Vec<MetricResult>,
}

/// Writes the folder of a simulation below `parent`: all of it, or nothing.
pub(super) fn write(
    parent: &Path,
    number: usize,
    record: &SimulationRecord,
) -> Result<(), ReportError> {
    let folder = parent.join(folder_name(number, record));
    let unfinished = atomic::unfinished(&folder);
    atomic::folder(&unfinished)?;
    if let Ok(outcome) = &record.outcome {
        write_calls(&unfinished, record, outcome)?;
        let metrics = MetricsFile {
            metrics: outcome.metrics.iter().map(without_negative_zeros).collect(),
        };
        write_toml(&unfinished.join(METRICS), &metrics)?;
        Replay::from_outcome(outcome).write(&unfinished)?;
    }
    let row = SimulationRow {
        files: digests(&unfinished)?,
        ..SimulationRow::new(number, record)
    };
    write_toml(&unfinished.join(RECORD), &row)?;
    fs::rename(&unfinished, &folder).map_err(ReportError::write(&folder))
}

/// BLAKE3 of the files with results that exist, by name.
fn digests(folder: &Path) -> Result<BTreeMap<String, String>, ReportError> {
    let mut digests = BTreeMap::new();
    for name in [METRICS, CALLS] {
        let path = folder.join(name);
        if path.is_file() {
            digests.insert(name.to_owned(), digest(&path)?);
        }
    }
    Ok(digests)
}

fn digest(path: &Path) -> Result<String, ReportError> {
    let mut hasher = blake3::Hasher::new();
    let hashed =
        planagent_files::open(path).and_then(|file| hasher.update_reader(file).map(|_| ()));
    hashed.map_err(ReportError::read(path))?;
    Ok(hasher.finalize().to_hex().to_string())
}

/// Whether the files of a completed simulation are those that were written. Records of earlier
/// versions have no digests: their metrics must be there.
pub(super) fn is_whole(folder: &Path, row: &SimulationRow) -> bool {
    if row.files.is_empty() && row.score.is_some() {
        let names = |metrics: Vec<MetricResult>| {
            metrics
                .into_iter()
                .map(|metric| metric.name)
                .collect::<Vec<_>>()
        };
        return metrics(folder).is_ok_and(|found| {
            names(found)
                .iter()
                .eq(row.metrics.iter().map(|metric| &metric.name))
        });
    }
    // The record may come from elsewhere: its names are those of this folder alone.
    let is_own = |name: &String| [METRICS, CALLS].contains(&name.as_str());
    row.files.iter().all(|(name, known)| {
        is_own(name) && digest(&folder.join(name)).is_ok_and(|found| found == *known)
    })
}

/// Copies the folder of a simulation below `parent`: all of it, or nothing.
pub(super) fn copy(simulation: &Path, parent: &Path) -> Result<(), ReportError> {
    let folder = parent.join(
        simulation
            .file_name()
            .expect("the folder of a simulation has a name"),
    );
    let unfinished = atomic::unfinished(&folder);
    copy_all(simulation, &unfinished)?;
    fs::rename(&unfinished, &folder).map_err(ReportError::write(&folder))
}

/// Copies a folder with all that is in it.
fn copy_all(from: &Path, to: &Path) -> Result<(), ReportError> {
    atomic::folder(to)?;
    for entry in fs::read_dir(from).map_err(ReportError::read(from))? {
        let path = entry.map_err(ReportError::read(from))?.path();
        let target = to.join(path.file_name().expect("an entry of a folder has a name"));
        if path.is_dir() {
            copy_all(&path, &target)?;
        } else {
            fs::copy(&path, &target).map_err(ReportError::write(&target))?;
        }
    }
    Ok(())
}

/// The metrics of a simulation.
pub fn metrics(folder: &Path) -> Result<Vec<MetricResult>, ReportError> {
    read_toml::<MetricsFile>(&folder.join(METRICS)).map(|file| file.metrics)
}

/// Deletes the folder of a simulation. A process that is killed meanwhile leaves an unfinished
/// folder.
pub(super) fn remove(folder: &Path) -> Result<(), ReportError> {
    let condemned = atomic::unfinished(folder);
    fs::rename(folder, &condemned).map_err(ReportError::write(folder))?;
    fs::remove_dir_all(&condemned).map_err(ReportError::write(&condemned))
}

fn write_toml(path: &Path, value: &impl Serialize) -> Result<(), ReportError> {
    atomic::create(
        path,
        toml::to_string(value)
            .map_err(ReportError::at(path))?
            .as_bytes(),
    )
}

/// Calls, transcript and BEV maps of a simulation with planning calls.
fn write_calls(
    folder: &Path,
    record: &SimulationRecord,
    outcome: &SimulationOutcome,
) -> Result<(), ReportError> {
    if outcome.calls.is_empty() {
        return Ok(());
    }
    let path = folder.join(CALLS);
    let mut lines = String::new();
    for call in &outcome.calls {
        let value = CallRecord::from_call(
            &record.scenario,
            record.planner.as_str(),
            Some(record.challenge),
            call,
        );
        let value = value.to_json().map_err(ReportError::at(&path))?;
        lines.push_str(&serde_json::to_string(&value).map_err(ReportError::at(&path))?);
        lines.push('\n');
    }
    atomic::create(&path, lines.as_bytes())?;
    atomic::folder(&folder.join(BEV))?;
    for call in &outcome.calls {
        if let Some(image) = &call.image {
            let path = folder.join(bev_name(call.iteration));
            image.save(&path).map_err(ReportError::at(&path))?;
        }
    }
    let text = transcript(record, outcome, |call| {
        call.image.as_ref().map(|_| bev_name(call.iteration))
    });
    atomic::create(&folder.join(TRANSCRIPT), text.as_bytes())
}

/// `NNNNNN-SCENARIO-PLANNER-CHALLENGE`, in characters that every file system allows.
fn folder_name(number: usize, record: &SimulationRecord) -> String {
    let safe = |c: char| {
        if c.is_ascii_alphanumeric() || "-_.".contains(c) {
            c
        } else {
            '_'
        }
    };
    let scenario: String = record
        .scenario
        .chars()
        .map(safe)
        .take(MAX_SCENARIO_CHARS)
        .collect();
    format!(
        "{number:0DIGITS$}-{scenario}-{}-{}",
        record.planner,
        record.challenge.short_name()
    )
}
