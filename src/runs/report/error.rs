//! Why results cannot be read or written.

use super::file_names::NoNamePart;
use super::layout::MANIFEST;
use super::limits::{MAX_CALL_BYTES, MAX_IMAGE_PIXELS, MAX_MANIFEST_BYTES};
use super::manifest::FORMAT_VERSION;
use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

/// Where reading or writing results failed, and why.
#[derive(Debug, thiserror::Error)]
#[error("{}: {fault}", place.display())]
pub struct ReportError {
    /// The file or folder.
    pub place: PathBuf,
    /// What is wrong there.
    pub fault: ReportFault,
}

/// What is wrong with a file or folder of results.
#[allow(missing_docs, reason = "the message of a variant says what it is")]
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReportFault {
    #[error("the folder is not empty; name a new one, so that no result is lost")]
    NotEmpty,
    #[error("this command did not write the file and would replace it; name another place")]
    NotOwn,
    #[error("the folder holds a run; resume it with --resume, or name a new folder")]
    AlreadyRun,
    #[error(
        "the folder holds a run of format version {found}, which this program (version {FORMAT_VERSION}) cannot resume; name \
         a new folder"
    )]
    OldRun { found: u32 },
    #[error("the folder holds no run: it has no {MANIFEST}")]
    NoRun,
    #[error("there is no such folder; name the folder of a run")]
    Absent,
    #[error(
        "{MANIFEST} is damaged, and the folder holds simulations; restore {MANIFEST} from a copy, or name a new folder"
    )]
    DamagedManifest,
    #[error(
        "the run did not begin: its {MANIFEST} is damaged and it has no simulation; start it again with --out"
    )]
    NotBegun,
    #[error("cannot write: {} is a file and no folder", .0.display())]
    NoFolder(PathBuf),
    #[error("there is no run in this folder; name the folder of a run")]
    NoRuns,
    #[error(
        "every simulation failed in each run of this folder; name one to see it all the same, for example {}",
        last.display()
    )]
    OnlyFailures {
        /// The run that started last.
        last: PathBuf,
    },
    #[error(
        "the run has format version {found}, this program reads version {FORMAT_VERSION}; start a new run, or use the \
         version of planagent that wrote it"
    )]
    FormatVersion { found: u32 },
    #[error("another process is running in the folder{0}")]
    Locked(Holder),
    #[error(
        "the folder of the run was moved or deleted, so the run ended; a folder that was moved holds all simulations that \
         were completed: resume it there with --resume"
    )]
    Gone,
    #[error(
        "'{first}' and '{second}' have the same number; delete the one that is not of this run"
    )]
    SameNumber { first: String, second: String },
    #[error("there are more than {limit} {what}, which is the limit")]
    TooMany { what: &'static str, limit: usize },
    #[error(
        "{MANIFEST} would have {bytes} bytes, at most {MAX_MANIFEST_BYTES} are read again; simulate fewer scenarios, or \
         shards of them with --shard"
    )]
    LargeManifest { bytes: usize },
    #[error("line {line} has {bytes} bytes; at most {MAX_CALL_BYTES} are read")]
    LongLine { line: usize, bytes: usize },
    #[error("it is no PNG of at most {MAX_IMAGE_PIXELS} pixels a side")]
    NoPicture,
    #[error(transparent)]
    Name(#[from] NoNamePart),
    #[error("the run cannot be resumed, because it was started with other settings:\n  {}", .0.join("\n  "))]
    Differs(Vec<String>),
    #[error(
        "the run cannot be resumed, because what it reads changed:\n  {}\nresume it with --accept-changes to mix both, which the \
         manifest then says, or start a new run", .0.join("\n  ")
    )]
    InputsChanged(Vec<String>),
    #[error("the record is of {found}, expected {expected}")]
    WrongRecord { found: String, expected: String },
    #[error("the run has no completed simulation; there is nothing to show")]
    NoSimulations,
    #[error("no scenario of the runs has '{part}' in its name")]
    NoScenario {
        part: String,
        /// The scenarios of the runs.
        known: Vec<String>,
    },
    #[error("the replay has format {0}, which this version cannot read")]
    ReplayFormat(u32),
    #[error("cannot read: {0}")]
    Read(io::Error),
    #[error("cannot write: {0}")]
    Write(io::Error),
    #[error("{0}")]
    Toml(#[from] Box<toml::de::Error>),
    #[error("cannot serialize: {0}")]
    SerializeToml(#[from] toml::ser::Error),
    #[error("{0}")]
    Json(#[from] serde_json::Error),
    #[error("cannot write: {0}")]
    Image(#[from] image::ImageError),
    #[error("cannot write: {0}")]
    Parquet(#[from] parquet::errors::ParquetError),
}

/// The process that holds the lock of a run, where the lock says which.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Holder(pub(super) Option<u32>);

impl fmt::Display for Holder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            Some(process) => write!(f, " (process {process})"),
            None => Ok(()),
        }
    }
}

impl ReportFault {
    /// Whether the content of a file is damaged.
    pub(super) fn is_damage(&self) -> bool {
        matches!(self, Self::Toml(_) | Self::DamagedManifest)
    }

    /// Whether the record of a simulation is damaged: the simulation is repeated.
    pub(super) fn is_damaged_record(&self) -> bool {
        matches!(self, Self::Toml(_))
    }
}

impl ReportError {
    /// Whether the file or folder does not exist.
    pub(super) fn is_absent(&self) -> bool {
        match &self.fault {
            ReportFault::Absent => true,
            ReportFault::Read(error) => error.kind() == io::ErrorKind::NotFound,
            _ => false,
        }
    }

    /// For `map_err`: a fault at `place`.
    pub fn at<F: Into<ReportFault>>(place: &Path) -> impl FnOnce(F) -> Self {
        let place = place.to_owned();
        move |fault| Self {
            place,
            fault: fault.into(),
        }
    }

    /// For `map_err`: `place` cannot be read.
    pub fn read(place: &Path) -> impl FnOnce(io::Error) -> Self {
        let at = Self::at(place);
        move |error| at(ReportFault::Read(error))
    }

    /// For `map_err`: `place` cannot be written.
    pub fn write(place: &Path) -> impl FnOnce(io::Error) -> Self {
        let at = Self::at(place);
        move |error| at(ReportFault::Write(error))
    }
}
