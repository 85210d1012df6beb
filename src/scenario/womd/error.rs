//! Why a recording cannot be opened.

use super::Pick;
use super::tfrecord::TfRecordError;
use crate::scenario::{LineFault, TimeFault};
use crate::world::MapError;
use std::io;
use std::path::PathBuf;

/// What is wrong with the content of a record whose bytes are sound.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RecordingFault {
    /// Its steps cannot be driven.
    #[error(transparent)]
    Time(#[from] TimeFault),
    /// The index of the recording car names no track.
    #[error("sdc_track_index is {index}, but there are {tracks} tracks")]
    NoEgoTrack {
        /// The index.
        index: i32,
        /// Number of tracks.
        tracks: usize,
    },
    /// The recording car was not seen (or not in finite numbers) for longer than is interpolated.
    #[error("the recording car has no valid state at step {step}, nor at {missing} steps in a row")]
    EgoMissing {
        /// First missing step.
        step: usize,
        /// How many steps in a row are missing.
        missing: usize,
    },
    /// A track does not have an entry a step.
    #[error("track {track} has {states} states for {steps} steps")]
    TrackLength {
        /// Id of the track.
        track: i32,
        /// Its states.
        states: usize,
        /// Steps of the recording.
        steps: usize,
    },
    /// Two tracks or two map features share an id.
    #[error("the {layer} id {id} occurs twice")]
    DuplicateId {
        /// Tracks or map features.
        layer: &'static str,
        /// The id.
        id: i64,
    },
    /// A line or outline of the map is unsound.
    #[error(transparent)]
    Line(#[from] LineFault),
    /// The map's relations do not hold.
    #[error("map: {0}")]
    Map(#[from] MapError),
}

/// Why a file of recordings cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum WomdError {
    /// The file cannot be opened.
    #[error("{}: cannot open: {source}", path.display())]
    Open {
        /// Which file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The file holds no record.
    #[error("{}: the file is empty", path.display())]
    Empty {
        /// Which file.
        path: PathBuf,
    },
    /// The container is broken.
    #[error("{}: {source}", path.display())]
    Framing {
        /// Which file.
        path: PathBuf,
        /// Where and why.
        source: TfRecordError,
    },
    /// A payload is no `Scenario` message.
    #[error("{}: record {record} at byte {offset} is not a Scenario message: {source}", path.display())]
    Decode {
        /// Which file.
        path: PathBuf,
        /// Number of the record, from 0.
        record: usize,
        /// Offset of its first byte.
        offset: u64,
        /// Why.
        source: prost::DecodeError,
    },
    /// A message that does not hold a drive.
    #[error("{}: record {record} at byte {offset}, scenario `{id}`: {fault}", path.display())]
    Content {
        /// Which file.
        path: PathBuf,
        /// Number of the record, from 0.
        record: usize,
        /// Offset of its first byte.
        offset: u64,
        /// Scenario id as read.
        id: String,
        /// What is wrong.
        #[source]
        fault: RecordingFault,
    },
    /// The asked recording is not in the file.
    #[error("{}: no recording {wanted} among the {records} of the file", path.display())]
    NotFound {
        /// Which file.
        path: PathBuf,
        /// What was asked for.
        wanted: Pick,
        /// Records of the file.
        records: usize,
    },
}
