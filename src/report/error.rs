//! Why results cannot be written or gone on with.

use std::io;
use std::path::{Path, PathBuf};

/// Why results cannot be written or gone on with.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// The folder holds something that is no run.
    #[error("the folder {} is not empty; name a new one, so that no result is lost", .0.display())]
    NotEmpty(PathBuf),
    /// The folder holds a run already.
    #[error("the folder {} holds a run; go on with it by --resume, or name a new folder", .0.display())]
    AlreadyRun(PathBuf),
    /// The folder holds no run.
    #[error("the folder {} holds no run to go on with: it has no {}", .0.display(), super::manifest::MANIFEST)]
    NoRun(PathBuf),
    /// Another process writes to the folder.
    #[error("another process is running in the folder {}", .0.display())]
    Locked(PathBuf),
    /// What the run was started with is not what it should go on with.
    #[error("the run in {} was started otherwise and cannot be gone on with:\n  {}", path.display(), differences.join("\n  "))]
    Differs {
        /// Folder of the run.
        path: PathBuf,
        /// What differs: a line each, `what: then; now this`.
        differences: Vec<String>,
    },
    /// A record belongs to another drive than the manifest says.
    #[error("the record {} is of {found}, where {expected} belongs", path.display())]
    Foreign {
        /// The record.
        path: PathBuf,
        /// Which drive it is of.
        found: String,
        /// Which drive its number stands for.
        expected: String,
    },
    /// A file or folder cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// Which.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A file of the run is not what this program writes.
    #[error("{} cannot be understood: {source}", path.display())]
    Parse {
        /// Which.
        path: PathBuf,
        /// Why, with its place.
        source: Box<toml::de::Error>,
    },
    /// A JSON file is not what this program writes.
    #[error("{} cannot be understood: {source}", path.display())]
    ParseJson {
        /// Which file.
        path: PathBuf,
        /// Why, with its place.
        source: serde_json::Error,
    },
    /// A run has no drive that has ended.
    #[error("the run in {} has no completed simulation; there is nothing to show", .0.display())]
    NoSimulations(PathBuf),
    /// No scenario of the runs bears this in its name.
    #[error("no scenario of these runs has {0:?} in its name")]
    NoScenario(String),
    /// A replay has a form of another version.
    #[error("{} has form {form}, which this version does not know; it was written by another one", path.display())]
    ReplayForm {
        /// Which file.
        path: PathBuf,
        /// Its form.
        form: u32,
    },
    /// A file or folder cannot be written.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// Which.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A BEV map cannot be written.
    #[error("cannot write {}: {source}", path.display())]
    Image {
        /// Which.
        path: PathBuf,
        /// Why.
        source: image::ImageError,
    },
    /// A Parquet file cannot be written.
    #[error("cannot write {}: {source}", path.display())]
    Parquet {
        /// Which.
        path: PathBuf,
        /// Why.
        source: parquet::errors::ParquetError,
    },
    /// A value cannot be put into JSON.
    #[error("cannot serialise the results")]
    Json(#[from] serde_json::Error),
    /// A value cannot be put into TOML.
    #[error("cannot serialise the results")]
    Toml(#[from] toml::ser::Error),
}

impl ReportError {
    /// For `map_err`: `path` cannot be read.
    pub(super) fn read(path: &Path) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Read { path, source }
    }

    /// For `map_err`: `path` cannot be written.
    pub(super) fn write(path: &Path) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Write { path, source }
    }
}
