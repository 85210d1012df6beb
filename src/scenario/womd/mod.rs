//! Waymo Open Motion recordings: `Scenario` messages in TFRecord files, as Waymo publishes them.
//!
//! [`open`] reads all recordings of a file, [`scenarios`] one after the other, [`open_one`] a chosen one; [`summaries`] only counts
//! what is there. Everything that is derived is derived by a documented rule:
//!
//! * `convert`: time, coordinates, the part that is driven; `tracks`: ego and objects of each step;
//! * `features`, `connectors`: which lanes there are and which of them are connectors; `outline`: their areas;
//! * `drivable`, `signals`: what is drivable beside them, and the lights.
//!
//! The rest (window, roadblocks, intersections, route) is derived as for every recording, in `scenario::recording`.
//!
//! Bytes that cannot be trusted are an error that names file, record and offset; nothing that a file holds makes this panic.

mod connectors;
mod convert;
mod drivable;
mod error;
mod features;
mod map;
mod outline;
mod proto;
mod reader;
mod signals;
#[cfg(test)]
mod tests;
mod tfrecord;
mod tracks;

pub use error::{RecordingFault, WomdError};
pub use reader::WomdReader;
pub use tfrecord::{FramingFault, Record, Records, TfRecordError};

use super::Scenario;
use super::recording::window::window;
use features::lane_count;
use prost::Message;
use std::fmt;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

/// Which recording of a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Pick {
    /// By its place, from 0.
    Index(usize),
    /// By its scenario id.
    Id(String),
}

impl fmt::Display for Pick {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Index(index) => write!(f, "number {index}"),
            Self::Id(id) => write!(f, "`{id}`"),
        }
    }
}

/// What a recording holds, without deriving anything.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Summary {
    /// Scenario id.
    pub id: String,
    /// Place in the file, from 0.
    pub record: usize,
    /// Recorded steps at 10 Hz.
    pub steps: usize,
    /// Iterations that a simulation drives.
    pub iterations: usize,
    /// Recorded objects, the recording car included.
    pub tracks: usize,
    /// Lanes for motor vehicles, lane connectors included: as many as the map of the opened scenario has.
    pub lanes: usize,
}

/// All recordings of a file.
///
/// # Errors
/// At the first recording that cannot be read, or when there is none.
pub fn open(path: &Path) -> Result<Vec<Scenario>, WomdError> {
    scenarios(path)?.collect()
}

/// The recordings of a file, one after the other. A recording whose content is unsound does not end the iteration; broken
/// framing does.
///
/// # Errors
/// When the file cannot be opened or is empty.
pub fn scenarios(path: &Path) -> Result<impl Iterator<Item = Result<Scenario, WomdError>>, WomdError> {
    let log_name = log_name(path);
    Ok(messages(path)?.map(move |message| message.and_then(|message| message.scenario(&log_name))))
}

/// One recording of a file; the map is derived for that one only.
///
/// # Errors
/// When the file cannot be read up to it, or does not hold it.
pub fn open_one(path: &Path, pick: &Pick) -> Result<Scenario, WomdError> {
    let mut records = 0;
    for message in messages(path)? {
        let message = message?;
        let wanted = match pick {
            Pick::Index(index) => message.record == *index,
            Pick::Id(id) => message.recording.scenario_id == *id,
        };
        if wanted {
            return message.scenario(&log_name(path));
        }
        records += 1;
    }
    Err(WomdError::NotFound { path: path.to_owned(), wanted: pick.clone(), records })
}

/// What the recordings of a file hold, one after the other.
///
/// # Errors
/// When the file cannot be opened or is empty.
pub fn summaries(path: &Path) -> Result<impl Iterator<Item = Result<Summary, WomdError>>, WomdError> {
    Ok(messages(path)?.map(|message| message.map(|message| message.summary())))
}

/// The name of the log that a file counts as: its own.
pub fn log_name(path: &Path) -> String {
    path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default()
}

/// A decoded record and where it came from.
struct Decoded {
    path: PathBuf,
    record: usize,
    offset: u64,
    recording: proto::Scenario,
}

impl Decoded {
    fn scenario(self, log_name: &str) -> Result<Scenario, WomdError> {
        convert::scenario(&self.recording, log_name).map_err(|fault| WomdError::Content {
            path: self.path,
            record: self.record,
            offset: self.offset,
            id: self.recording.scenario_id,
            fault,
        })
    }

    fn summary(&self) -> Summary {
        let seconds = &self.recording.timestamps_seconds;
        let first = seconds.first().copied().unwrap_or(0.0);
        let times_us: Vec<i64> =
            seconds.iter().map(|t| ((t - first) * crate::world::MICROS_PER_SECOND) as i64).collect();
        Summary {
            id: self.recording.scenario_id.clone(),
            record: self.record,
            steps: seconds.len(),
            iterations: window(&times_us).len(),
            tracks: self.recording.tracks.len(),
            lanes: lane_count(&self.recording.map_features),
        }
    }
}

/// The messages of a file.
fn messages(path: &Path) -> Result<Messages, WomdError> {
    let path = path.to_owned();
    match Records::open(&path) {
        Err(source) => Err(WomdError::Open { path, source }),
        Ok(records) if records.is_empty() => Err(WomdError::Empty { path }),
        Ok(records) => Ok(Messages { path, records }),
    }
}

struct Messages {
    path: PathBuf,
    records: Records<BufReader<File>>,
}

impl Iterator for Messages {
    type Item = Result<Decoded, WomdError>;

    fn next(&mut self) -> Option<Self::Item> {
        let path = self.path.clone();
        let Record { number: record, offset, payload } = match self.records.next()? {
            Ok(record) => record,
            Err(source) => return Some(Err(WomdError::Framing { path, source })),
        };
        Some(match proto::Scenario::decode(&payload[..]) {
            Ok(recording) => Ok(Decoded { path, record, offset, recording }),
            Err(source) => Err(WomdError::Decode { path, record, offset, source }),
        })
    }
}
