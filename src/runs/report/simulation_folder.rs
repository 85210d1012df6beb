//! The folder of one simulation: record, metrics, replay, planning calls with transcript and BEV
//! maps.

use super::bounded::at_most;
use super::call_record::{CallRecord, calls_in};
use super::error::{ReportError, ReportFault};
use super::file_names::{NamePart, SimulationName};
use super::layout::{BEV, CALLS, METRICS, RECORD, REPLAY, TRANSCRIPT, bev_name, is_bev_name};
use super::limits::{
    MAX_CALLS_BYTES, MAX_IMAGE_BYTES, MAX_METRICS, MAX_METRICS_BYTES, MAX_RECORD_BYTES,
    MAX_REPLAY_BYTES, MAX_TRANSCRIPT_BYTES,
};
use super::number::without_negative_zeros;
use super::picture::is_picture;
use super::replay::Replay;
use super::run_files::{SimulationFolder, present_folder, read_present, read_toml, write_synced};
use super::simulation_row::SimulationRow;
use super::transcript::transcript;
use crate::worker::run::{SimulationOutcome, SimulationRecord};
use image::ImageFormat;
use planagent_files::{OpenFolder, UNFINISHED};
use planagent_score::metrics::MetricResult;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::{Cursor, Read};

/// The files of a simulation beside its BEV maps, with their largest sizes.
const FILES: [(&str, u64); 5] = [
    (METRICS, MAX_METRICS_BYTES),
    (CALLS, MAX_CALLS_BYTES),
    (TRANSCRIPT, MAX_TRANSCRIPT_BYTES),
    (REPLAY, MAX_REPLAY_BYTES),
    // The record comes last, as it is written.
    (RECORD, MAX_RECORD_BYTES),
];

/// The first bytes of a gzip file (RFC 1952).
const GZIP: [u8; 2] = [0x1f, 0x8b];

/// `metrics.toml`.
#[derive(Serialize, Deserialize)]
struct MetricsFile {
    #[serde(deserialize_with = "at_most::<_, _, MAX_METRICS>")]
    metrics: Vec<MetricResult>,
}

/// Writes the folder of a simulation into that of all: all of it, or nothing.
pub(super) fn write(
    simulations: &OpenFolder,
    number: usize,
    record: &SimulationRecord,
) -> Result<(), ReportError> {
    let at = ReportError::at(simulations.path());
    let planner = NamePart::parse(record.planner.as_str()).map_err(at)?;
    let challenge = record.challenge.short_name();
    let name = SimulationName::new(number, &record.scenario, &planner, challenge);
    whole_folder(simulations, name.as_str(), |folder| {
        if let Ok(outcome) = &record.outcome {
            write_calls(folder, record, outcome)?;
            let metrics = MetricsFile {
                metrics: outcome.metrics.iter().map(without_negative_zeros).collect(),
            };
            write_toml(folder, METRICS, &metrics)?;
            Replay::from_outcome(outcome).write(folder)?;
        }
        let row = SimulationRow {
            files: digests(folder)?,
            ..SimulationRow::new(number, record)
        };
        write_toml(folder, RECORD, &row)
    })
}

/// Fills a folder under a temporary name, and renames it: all of it appears, or nothing. The lock
/// of the run keeps other processes away.
fn whole_folder(
    simulations: &OpenFolder,
    name: &str,
    fill: impl FnOnce(&OpenFolder) -> Result<(), ReportError>,
) -> Result<(), ReportError> {
    let unfinished = &format!("{UNFINISHED}{name}");
    let place = simulations.path_of(unfinished);
    let failed = ReportError::write(&place);
    let made = simulations
        .remove(unfinished)
        .and_then(|()| simulations.make_subfolder(unfinished))
        .map_err(failed)?;
    let written = fill(&made).and_then(|()| {
        simulations
            .rename(unfinished, name)
            .map_err(ReportError::write(&simulations.path_of(name)))
    });
    if written.is_err() {
        // The first error is the one to report; what is left is swept when the run is resumed.
        let _ = simulations.remove(unfinished);
    }
    written
}

/// BLAKE3 of the files with results that exist, by name.
fn digests(folder: &OpenFolder) -> Result<BTreeMap<String, String>, ReportError> {
    let mut digests = BTreeMap::new();
    for name in [METRICS, CALLS] {
        if let Some(digest) = digest(folder, name)? {
            digests.insert(name.to_owned(), digest);
        }
    }
    Ok(digests)
}

/// BLAKE3 of a file; none if there is none.
fn digest(folder: &OpenFolder, name: &str) -> Result<Option<String>, ReportError> {
    let bytes = read_present(folder, name, MAX_METRICS_BYTES.max(MAX_CALLS_BYTES))?;
    Ok(bytes.map(|bytes| blake3::hash(&bytes).to_hex().to_string()))
}

/// Whether the files of a completed simulation are those that were written. Records of earlier
/// versions have no digests: their metrics must be there.
///
/// # Errors
/// When a link or something else stands in the place of a file, or a file is too large.
pub(super) fn is_whole(folder: &OpenFolder, row: &SimulationRow) -> Result<bool, ReportError> {
    if row.files.is_empty() && row.score.is_some() {
        let found = match metrics(folder) {
            Ok(found) => found,
            Err(error) if error.fault.is_damaged_record() || error.is_absent() => {
                return Ok(false);
            }
            Err(error) => return Err(error),
        };
        let names = found.iter().map(|metric| &metric.name);
        return Ok(names.eq(row.metrics.iter().map(|metric| &metric.name)));
    }
    for (name, known) in &row.files {
        // The record may come from elsewhere: its names are those of this folder alone.
        let is_own = [METRICS, CALLS].contains(&name.as_str());
        if !is_own || digest(folder, name)?.as_ref() != Some(known) {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Whether the replay of a simulation is there, by the first bytes of a gzip file.
pub(super) fn has_replay(folder: &OpenFolder) -> bool {
    let mut first = [0; GZIP.len()];
    let read = folder
        .open_file(REPLAY)
        .and_then(|mut file| file.read_exact(&mut first));
    read.is_ok() && first == GZIP
}

/// Copies the known files of a simulation into the folder of all simulations: all of them, or
/// nothing.
///
/// # Errors
/// When one is a link, too large, or a BEV map is no picture.
pub(super) fn copy(
    simulation: &SimulationFolder,
    simulations: &OpenFolder,
) -> Result<(), ReportError> {
    let from = simulation.open()?;
    whole_folder(simulations, simulation.name(), |to| {
        if let Some(pictures) = present_folder(&from, BEV)? {
            copy_pictures(&pictures, &make_folder(to, BEV)?)?;
        }
        for (name, max_bytes) in FILES {
            if let Some(bytes) = read_present(&from, name, max_bytes)? {
                write_synced(to, name, &bytes)?;
            }
        }
        Ok(())
    })
}

/// Only files that a run writes are copied; whatever else lies there is left.
fn copy_pictures(pictures: &OpenFolder, copies: &OpenFolder) -> Result<(), ReportError> {
    let names = pictures.names();
    for name in names.map_err(ReportError::read(pictures.path()))? {
        let Some(name) = name.to_str().filter(|name| is_bev_name(name)) else {
            continue;
        };
        let place = pictures.path_of(name);
        let bytes = pictures
            .read(name, MAX_IMAGE_BYTES)
            .map_err(ReportError::read(&place))?;
        if !is_picture(&bytes) {
            return Err(ReportError::at(&place)(ReportFault::NoPicture));
        }
        write_new(copies, name, &bytes)?;
    }
    Ok(())
}

/// The metrics in the folder of a simulation.
///
/// # Errors
/// When the file cannot be read, is too large, or the name of a metric cannot be one of a file.
pub fn metrics_of(folder: &SimulationFolder) -> Result<Vec<MetricResult>, ReportError> {
    metrics(&folder.open()?)
}

/// The planning calls in the folder of a simulation; none for a planner that makes none.
///
/// # Errors
/// When the file cannot be read or is too large.
pub fn calls_of(folder: &SimulationFolder) -> Result<Vec<CallRecord>, ReportError> {
    calls_in(&folder.open()?)
}

pub(super) fn metrics(folder: &OpenFolder) -> Result<Vec<MetricResult>, ReportError> {
    let file: MetricsFile = read_toml(folder, METRICS, MAX_METRICS_BYTES)?;
    for metric in &file.metrics {
        NamePart::parse(&metric.name).map_err(ReportError::at(&folder.path_of(METRICS)))?;
    }
    Ok(file.metrics)
}

/// Deletes the folder of a simulation. A process that is killed meanwhile leaves an unfinished
/// folder.
pub(super) fn remove(simulations: &OpenFolder, name: &str) -> Result<(), ReportError> {
    let condemned = format!("{UNFINISHED}{name}");
    simulations
        .remove(&condemned)
        .and_then(|()| simulations.rename(name, &condemned))
        .and_then(|()| simulations.remove(&condemned))
        .map_err(ReportError::write(&simulations.path_of(name)))
}

fn make_folder(folder: &OpenFolder, name: &str) -> Result<OpenFolder, ReportError> {
    folder
        .make_subfolder(name)
        .map_err(ReportError::write(&folder.path_of(name)))
}

fn write_new(folder: &OpenFolder, name: &str, bytes: &[u8]) -> Result<(), ReportError> {
    folder
        .write_new(name, bytes)
        .map(|_| ())
        .map_err(ReportError::write(&folder.path_of(name)))
}

fn write_toml(folder: &OpenFolder, name: &str, value: &impl Serialize) -> Result<(), ReportError> {
    let text = toml::to_string(value).map_err(ReportError::at(&folder.path_of(name)))?;
    write_synced(folder, name, text.as_bytes())
}

/// Calls, transcript and BEV maps of a simulation with planning calls.
fn write_calls(
    folder: &OpenFolder,
    record: &SimulationRecord,
    outcome: &SimulationOutcome,
) -> Result<(), ReportError> {
    if outcome.calls.is_empty() {
        return Ok(());
    }
    write_call_lines(folder, record, outcome)?;
    // Pictures before the transcript, which links to them.
    write_pictures(&make_folder(folder, BEV)?, outcome)?;
    let text = transcript(record, outcome, |call| {
        let name = bev_name(call.iteration);
        call.image.as_ref().map(|_| format!("{BEV}/{name}"))
    });
    write_synced(folder, TRANSCRIPT, text.as_bytes())
}

fn write_call_lines(
    folder: &OpenFolder,
    record: &SimulationRecord,
    outcome: &SimulationOutcome,
) -> Result<(), ReportError> {
    let path = folder.path_of(CALLS);
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
    write_synced(folder, CALLS, lines.as_bytes())
}

fn write_pictures(pictures: &OpenFolder, outcome: &SimulationOutcome) -> Result<(), ReportError> {
    for call in &outcome.calls {
        if let Some(image) = &call.image {
            let name = bev_name(call.iteration);
            let mut png = Cursor::new(Vec::new());
            image
                .write_to(&mut png, ImageFormat::Png)
                .map_err(ReportError::at(&pictures.path_of(&name)))?;
            write_new(pictures, &name, png.get_ref())?;
        }
    }
    Ok(())
}
