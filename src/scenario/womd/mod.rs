//! Waymo Open Motion recordings: `Scenario` messages in TFRecord files, as Waymo publishes them.
//!
//! [`contents`] counts what the recordings of a file hold, [`open_one`] opens one of them.
//!
//! * `convert`: time, coordinates, the simulated part; `tracks`: ego and objects of each step;
//! * `features`, `connectors`: the lanes, and which of them are connectors; `outline`: their areas;
//! * `drivable`, `signals`: the drivable area beside them, and the traffic lights.
//!
//! `scenario::recording` derives the rest (window, roadblocks, intersections, route) as for every
//! recording. Errors name file, record and offset; no content of a file makes this module panic.

mod connectors;
mod convert;
mod drivable;
mod error;
mod features;
mod map;
mod other_message;
mod outline;
mod proto;
mod reader;
mod signals;
mod source;
#[cfg(test)]
mod tests;
mod tfrecord;
mod tracks;

pub use error::{WomdError, WomdFault};
pub(crate) use reader::WomdReader;
pub use tfrecord::FramingFault;

use super::reader::MAX_NAME_BYTES;
use super::recording::window;
use super::{Contents, Scenario};
use features::lane_count;
use other_message::other_message;
use prost::Message;
use source::{Opened, Source};
use std::path::{Path, PathBuf};
use tfrecord::{Record, Records};

/// Opens a recording by its number in the file, from 0. Only its map is derived.
pub fn open_one(path: &Path, record: usize) -> Result<Scenario, WomdError> {
    let mut records = records(path)?;
    // Records before it are neither read nor decoded.
    let found = match records.skip_to(record) {
        Some(broken) => Some(broken),
        None => records.next(),
    };
    match found {
        Some(found) => decoded(path, found)?.scenario(&log_name(path)),
        None => Err(WomdError::at(path)(WomdFault::NotFound {
            wanted: record,
            records: records.number(),
        })),
    }
}

/// The scenario ids and contents of the recordings of a file, one after the other.
pub fn contents(
    path: &Path,
) -> Result<impl Iterator<Item = Result<(String, Contents), WomdError>>, WomdError> {
    Ok(messages(path)?.map(|message| message.map(Decoded::contents)))
}

/// Name of the log that a file counts as: the file's own.
pub fn log_name(path: &Path) -> String {
    path.file_stem()
        .map(|stem| stem.to_string_lossy().into_owned())
        .unwrap_or_default()
}

/// A decoded record and its place.
struct Decoded {
    path: PathBuf,
    record: usize,
    offset: u64,
    recording: proto::Scenario,
}

impl Decoded {
    fn scenario(self, log_name: &str) -> Result<Scenario, WomdError> {
        let part = format!(
            "{}, scenario `{}`",
            part(self.record, self.offset),
            self.recording.scenario_id
        );
        convert::scenario(&self.recording, log_name).map_err(WomdError::at_part(&self.path, part))
    }

    fn contents(self) -> (String, Contents) {
        let proto::Scenario {
            scenario_id,
            timestamps_seconds,
            tracks,
            map_features,
            ..
        } = self.recording;
        let contents =
            window::contents(&timestamps_seconds, tracks.len(), lane_count(&map_features));
        (
            scenario_id,
            Contents {
                record: Some(self.record),
                ..contents
            },
        )
    }
}

fn part(record: usize, offset: u64) -> String {
    format!("record {record} at byte {offset}")
}

fn messages(path: &Path) -> Result<impl Iterator<Item = Result<Decoded, WomdError>>, WomdError> {
    let records = records(path)?;
    let path = path.to_owned();
    Ok(records.map(move |record| decoded(&path, record)))
}

fn records(path: &Path) -> Result<Records<Source>, WomdError> {
    let opened = source::open(path).map_err(WomdError::at(path))?;
    let Opened { source, bytes } =
        opened.map_err(|kind| WomdError::at(path)(WomdFault::OtherFile(kind)))?;
    let mut records = Records::new(source, bytes);
    if records.has_ended() {
        return Err(WomdError::at(path)(WomdFault::Empty));
    }
    Ok(records)
}

fn decoded(
    path: &Path,
    Record {
        number,
        offset,
        payload,
    }: Record,
) -> Result<Decoded, WomdError> {
    let decoded = payload
        .map_err(WomdFault::from)
        .and_then(|bytes| match other_message(&bytes) {
            Some(other) => Err(WomdFault::OtherMessage(other)),
            None => Ok(proto::Scenario::decode(&bytes[..])?),
        })
        .and_then(checked_id);
    let recording = decoded.map_err(WomdError::at_part(path, part(number, offset)))?;
    Ok(Decoded {
        path: path.to_owned(),
        record: number,
        offset,
        recording,
    })
}

/// Refuses an id that the records of a run could not hold.
fn checked_id(recording: proto::Scenario) -> Result<proto::Scenario, WomdFault> {
    let bytes = recording.scenario_id.len();
    if bytes > MAX_NAME_BYTES {
        let most = MAX_NAME_BYTES;
        return Err(WomdFault::LongId { bytes, most });
    }
    Ok(recording)
}
