//! Why a log cannot be opened.

use crate::scenario::{LineFault, TimeFault};
use crate::world::MapError;
use arrow::error::ArrowError;
use parquet::errors::ParquetError;
use std::io;
use std::path::PathBuf;

/// Why a log folder is no drive.
#[derive(Debug, thiserror::Error)]
pub enum Argoverse2Error {
    /// The folder holds neither kind of log.
    #[error(
        "{}: neither city_SE3_egovehicle.feather (a sensor log) nor scenario_*.parquet (a motion-forecasting scenario)",
        folder.display()
    )]
    NoLog {
        /// Which folder.
        folder: PathBuf,
    },
    /// A file of the log is missing.
    #[error("{}: there is no {file}", folder.display())]
    Missing {
        /// Where it should be.
        folder: PathBuf,
        /// Its name or the pattern of its name.
        file: &'static str,
    },
    /// A file or folder cannot be read.
    #[error("{}: cannot read: {source}", path.display())]
    Read {
        /// Which one.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A file does not hold what it should.
    #[error("{}: {fault}", path.display())]
    Content {
        /// Which file.
        path: PathBuf,
        /// What is wrong.
        #[source]
        fault: LogFault,
    },
}

/// What is wrong with a file of a log. Rows count from 0.
#[derive(Debug, thiserror::Error)]
pub enum LogFault {
    /// The first version of Feather, which Argoverse never used.
    #[error("Feather version 1; version 2 (an Arrow IPC file) is needed")]
    OldFeather,
    /// No sound Arrow IPC file.
    #[error("not a sound Feather file: {0}")]
    Arrow(#[from] ArrowError),
    /// A part of an Arrow IPC file that cannot be, or reaches beyond the end.
    #[error("not a sound Feather file: damaged {part} {number}")]
    Damaged {
        /// File, footer or block of rows.
        part: &'static str,
        /// Which of them.
        number: usize,
    },
    /// The reader of the format stopped at what it found.
    #[error("not a sound file: its parts do not fit each other")]
    Unreadable,
    /// No sound Parquet file.
    #[error("not a sound Parquet file: {0}")]
    Parquet(#[from] ParquetError),
    /// A table without rows.
    #[error("the table has no rows")]
    Empty,
    /// A column is missing.
    #[error("there is no column `{column}`")]
    NoColumn {
        /// Its name.
        column: &'static str,
    },
    /// A column has another type.
    #[error("column `{column}` holds {found}, not {needed}")]
    WrongType {
        /// Its name.
        column: &'static str,
        /// The Arrow type that it has.
        found: String,
        /// What it should hold.
        needed: &'static str,
    },
    /// A cell is empty.
    #[error("column `{column}`, row {row}: no value")]
    NoValue {
        /// Name of the column.
        column: &'static str,
        /// Which row.
        row: usize,
    },
    /// A number that cannot be meant: NaN, infinite, or beyond what the column can hold.
    #[error("column `{column}`, row {row}: {value} is not to be believed")]
    Unbelievable {
        /// Name of the column.
        column: &'static str,
        /// Which row.
        row: usize,
        /// What stands there.
        value: f64,
    },
    /// A quaternion that is no rotation.
    #[error("columns `qw` to `qz`, row {row}: a quaternion of norm {norm} is no rotation")]
    NoRotation {
        /// Which row.
        row: usize,
        /// Its norm.
        norm: f64,
    },
    /// A category that Argoverse 2 does not have.
    #[error("column `{column}`, row {row}: no category is called `{word}`")]
    Category {
        /// Name of the column.
        column: &'static str,
        /// Which row.
        row: usize,
        /// What stands there.
        word: String,
    },
    /// A track is at two places at once.
    #[error("row {row}: track {track} stands there twice at one time")]
    Twice {
        /// The second of the two rows.
        row: usize,
        /// Which track.
        track: String,
    },
    /// The ego's pose at a sweep is not known.
    #[error("no ego pose at {timestamp_ns} ns, nor two around it within 0.15 s of each other")]
    NoPose {
        /// Time of the sweep.
        timestamp_ns: i64,
    },
    /// A motion-forecasting scenario without the recording car at a step.
    #[error("track `AV` is not there at step {step}")]
    NoEgo {
        /// Which step.
        step: usize,
    },
    /// The map is no JSON of the expected shape.
    #[error("not a map: {0}")]
    Json(#[from] serde_json::Error),
    /// Two lane segments share an id.
    #[error("the lane segment {id} occurs twice")]
    DuplicateId {
        /// The id.
        id: i64,
    },
    /// The boundaries of a lane segment are no lines or leave no area.
    #[error("lane segment {id}: its boundaries enclose nothing")]
    NoArea {
        /// Its id.
        id: i64,
    },
    /// A line or outline of the map is unsound.
    #[error(transparent)]
    Line(#[from] LineFault),
    /// The sweeps cannot be driven.
    #[error(transparent)]
    Time(#[from] TimeFault),
    /// The map's relations do not hold.
    #[error("map: {0}")]
    Map(#[from] MapError),
}
