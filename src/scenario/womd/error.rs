//! Faults of Waymo recordings.

use super::tfrecord::FramingFault;
use crate::recording::error::{FileError, RecordingFault};
use std::io;

/// Why a file of recordings cannot be read, with file, record and byte offset.
pub type WomdError = FileError<WomdFault>;

/// What is wrong with a file of recordings.
#[derive(Debug, thiserror::Error)]
pub enum WomdFault {
    #[error("cannot open: {0}")]
    Open(#[from] io::Error),
    #[error("the file is empty")]
    Empty,
    /// What it is instead.
    #[error("no file of records (TFRecord): it is {0}")]
    OtherFile(&'static str),
    /// What it is instead.
    #[error("no Scenario message: it is {0}")]
    OtherMessage(String),
    #[error(transparent)]
    Framing(#[from] FramingFault),
    #[error("not a Scenario message: {0}")]
    Decode(#[from] prost::DecodeError),
    #[error("scenario_id has {bytes} bytes; it may have {most}")]
    LongId { bytes: usize, most: usize },
    #[error(transparent)]
    Recording(#[from] RecordingFault),
    #[error(
        "sdc_track_index is absent, so the ego's track is not known; write the field, also where the index is 0"
    )]
    NoEgoIndex,
    /// The fields that no valid state of the ego's track has.
    #[error(
        "no valid state of the ego's track {track} has {fields}; write the fields, also where they are 0"
    )]
    NoEgoField { track: i32, fields: &'static str },
    #[error("sdc_track_index is {index}, but there are {tracks} tracks")]
    NoEgoTrack { index: i32, tracks: usize },
    #[error("the recording car has no valid state at step {step}, nor at {missing} steps in a row")]
    EgoMissing { step: usize, missing: usize },
    #[error("track {track} has {states} states for {steps} steps")]
    TrackLength {
        track: i32,
        states: usize,
        steps: usize,
    },
    #[error("no recording number {wanted} among the {records} of the file")]
    NotFound { wanted: usize, records: usize },
}

impl WomdFault {
    /// Whether the file is sound and of another kind, so that a folder passes it over.
    pub(super) fn is_of_another_kind(&self) -> bool {
        matches!(self, Self::OtherFile(_) | Self::OtherMessage(_))
    }
}
