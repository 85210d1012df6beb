//! Faults of Argoverse 2 logs.

use crate::recording::error::{FileError, RecordingFault};
use arrow_schema::ArrowError;
use parquet::errors::ParquetError;
use std::io;

/// Why a log cannot be opened, with its folder or file.
pub type Argoverse2Error = FileError<LogFault>;

/// What is wrong with a log or a file of it. Rows count from 0.
#[derive(Debug, thiserror::Error)]
pub enum LogFault {
    #[error(
        "neither city_SE3_egovehicle.feather (a sensor log) nor scenario_*.parquet (a motion-forecasting scenario)"
    )]
    NoLog,
    #[error("there is no {0}")]
    Missing(&'static str),
    #[error("cannot read: {0}")]
    Read(#[from] io::Error),
    #[error("Feather version 1; version 2 (an Arrow IPC file) is needed")]
    OldFeather,
    #[error(
        "a stream of Arrow; a Feather file (an Arrow IPC file) is needed: write it by `write_feather`"
    )]
    Stream,
    #[error("not a valid Feather file: {0}")]
    Arrow(#[from] ArrowError),
    #[error("not a valid Feather file: damaged {part} {number}")]
    Damaged { part: &'static str, number: usize },
    #[error("not a valid file: its parts contradict each other")]
    Unreadable,
    #[error("not a valid Parquet file: {0}")]
    Parquet(#[from] ParquetError),
    /// A Parquet file whose values Arrow cannot take.
    #[error("not a valid Parquet file: {0}")]
    ParquetValues(ArrowError),
    /// What the file is instead.
    #[error("no {needed} file: it is {kind}")]
    OtherFile {
        needed: &'static str,
        kind: &'static str,
    },
    #[error("the table has more than {rows} rows or {mebibytes} MiB; no log is so long")]
    TooLarge { rows: usize, mebibytes: usize },
    #[error("the table has no rows")]
    Empty,
    #[error("there is no column '{column}'")]
    NoColumn { column: &'static str },
    #[error("column '{column}' holds {found}, not {needed}")]
    WrongType {
        column: &'static str,
        found: String,
        needed: &'static str,
    },
    #[error("column '{column}', row {row}: no value")]
    NoValue { column: &'static str, row: usize },
    #[error("column '{column}', row {row}: {value} is out of range")]
    OutOfRange {
        column: &'static str,
        row: usize,
        value: f64,
    },
    #[error("columns `qw` to `qz`, row {row}: a quaternion of norm {norm} is no rotation")]
    NoRotation { row: usize, norm: f64 },
    #[error("column '{column}', row {row}: unknown category '{word}'")]
    Category {
        column: &'static str,
        row: usize,
        word: String,
    },
    #[error("row {row}: a second row of track {track} at the same time")]
    Twice { row: usize, track: String },
    #[error("no ego pose at {timestamp_ns} ns, nor two around it within 0.15 s of each other")]
    NoPose { timestamp_ns: i64 },
    #[error("track 'AV' is missing at step {step}")]
    NoEgo { step: usize },
    #[error("not a map: {0}")]
    Json(#[from] serde_json::Error),
    #[error("lane segment {id}: its boundaries enclose no area")]
    NoArea { id: i64 },
    #[error(transparent)]
    Recording(#[from] RecordingFault),
}
