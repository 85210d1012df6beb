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
    #[error(transparent)]
    Framing(#[from] FramingFault),
    #[error("not a Scenario message: {0}")]
    Decode(#[from] prost::DecodeError),
    #[error(transparent)]
    Recording(#[from] RecordingFault),
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
