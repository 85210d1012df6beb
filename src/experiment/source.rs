//! Where scenarios come from, by the words of the command line.

use super::nuplan_data::{NuPlanData, NuPlanDataError};
use crate::scenario::Scenario;
use crate::scenario::argoverse2::{self, Argoverse2Error};
use crate::scenario::generator::{self, GeneratorError, Spec};
use crate::scenario::nuplan::{self, Found, MapStore, NuPlanError};
use crate::scenario::womd::{self, Pick, WomdError};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Prefix of the ids of generated scenarios.
const GENERATED: &str = "generated/";
/// Ending of recordings in a folder.
const RECORDING: &str = "tfrecord";

/// A scenario that can be opened.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ScenarioSource {
    /// One that is generated on the spot.
    Generated(Spec),
    /// A recording: its file and its place in it.
    Recording {
        /// The TFRecord file.
        path: PathBuf,
        /// Which record, from 0.
        record: usize,
    },
    /// An Argoverse 2 log: its folder.
    Argoverse2(PathBuf),
    /// A scenario of a nuPlan log, and the maps that it may need.
    NuPlan {
        /// Which scenario.
        found: Found,
        /// The maps, shared by all scenarios.
        maps: Arc<MapStore>,
    },
}

/// Why there is no scenario.
#[derive(Debug, thiserror::Error)]
pub enum SourceError {
    /// The recording cannot be read.
    #[error(transparent)]
    Recording(#[from] WomdError),
    /// The Argoverse 2 log cannot be read.
    #[error(transparent)]
    Argoverse2(#[from] Argoverse2Error),
    /// nuPlan's log or map cannot be read.
    #[error(transparent)]
    NuPlan(#[from] NuPlanError),
    /// The word names no scenario of a nuPlan log.
    #[error(transparent)]
    NuPlanData(#[from] NuPlanDataError),
    /// Not the id of a generated scenario, or the generator finds no scene for its seed.
    #[error(transparent)]
    Generator(#[from] GeneratorError),
    /// Nothing there.
    #[error("there is no file or folder {}; a generated scenario is called generated/TYPE/SEED", .0.display())]
    Missing(PathBuf),
    /// The folder cannot be listed.
    #[error("cannot list the folder {}: {source}", path.display())]
    Folder {
        /// Which folder.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The folder holds no recordings.
    #[error("the folder {} is no Argoverse 2 log and holds no such logs, no *.{RECORDING} files and no nuPlan logs (*.db)", .0.display())]
    Empty(PathBuf),
}

impl ScenarioSource {
    /// All scenarios that a word names: a generated one, the records of a file, an Argoverse 2 log, the scenarios of a nuPlan log
    /// (`LOG.db`, or one as `LOG.db#TOKEN`), or what a folder holds of these.
    ///
    /// # Errors
    /// When it names none, or a file is no sound recording.
    pub fn find(word: &str, data: &NuPlanData) -> Result<Vec<Self>, SourceError> {
        if Self::names_generated(word) {
            return Ok(vec![Self::Generated(word.parse()?)]);
        }
        if NuPlanData::names_log(word) {
            return Ok(data.in_log(word)?);
        }
        let path = Path::new(word);
        if argoverse2::is_log(path) {
            return Ok(vec![Self::Argoverse2(path.to_owned())]);
        }
        if path.is_dir() {
            let logs = argoverse2::logs_in(path)?;
            let of_nuplan = Self::of_nuplan(word, data)?;
            let files = match recordings_in(path) {
                Err(SourceError::Empty(_)) if !(logs.is_empty() && of_nuplan.is_empty()) => Vec::new(),
                files => files?,
            };
            let mut all = files.iter().map(|file| Self::records_of(file)).collect::<Result<Vec<_>, _>>()?.concat();
            all.extend(logs.into_iter().map(Self::Argoverse2));
            all.extend(of_nuplan);
            return Ok(all);
        }
        if !path.exists() {
            return Err(SourceError::Missing(path.to_owned()));
        }
        Self::records_of(path)
    }

    /// Whether a word has the form of a generated scenario's name.
    pub fn names_generated(word: &str) -> bool {
        word.starts_with(GENERATED)
    }

    fn records_of(path: &Path) -> Result<Vec<Self>, SourceError> {
        let summaries = womd::summaries(path)?.collect::<Result<Vec<_>, _>>()?;
        Ok(summaries.iter().map(|s| Self::Recording { path: path.to_owned(), record: s.record }).collect())
    }

    /// The scenarios of nuPlan logs among what a word names: all of a log, or those of the logs in a folder.
    ///
    /// # Errors
    /// When a log cannot be read.
    pub fn of_nuplan(word: &str, data: &NuPlanData) -> Result<Vec<Self>, SourceError> {
        if NuPlanData::names_log(word) {
            return Ok(data.in_log(word)?);
        }
        let path = Path::new(word);
        if path.is_dir() { Ok(data.in_folder(path)?) } else { Ok(Vec::new()) }
    }

    /// nuPlan's scenario type, as far as it is known before the scenario is opened.
    pub fn scenario_type(&self) -> Option<&str> {
        match self {
            Self::Generated(spec) => Some(spec.scenario_type.name()),
            Self::NuPlan { found, .. } => Some(&found.scenario_type),
            Self::Recording { .. } | Self::Argoverse2(_) => None,
        }
    }

    /// Opens the scenario.
    ///
    /// # Errors
    /// When the recording is broken or the generator finds no scene.
    pub fn open(&self) -> Result<Scenario, SourceError> {
        match self {
            Self::Generated(spec) => Ok(generator::generate(spec)?),
            Self::Recording { path, record } => Ok(womd::open_one(path, &Pick::Index(*record))?),
            Self::Argoverse2(folder) => Ok(argoverse2::open(folder)?),
            Self::NuPlan { found, maps } => Ok(nuplan::open(maps, found)?),
        }
    }
}

/// The recordings of a folder, by name.
///
/// # Errors
/// When it cannot be listed or holds none.
pub fn recordings_in(folder: &Path) -> Result<Vec<PathBuf>, SourceError> {
    let failed = |source| SourceError::Folder { path: folder.to_owned(), source };
    let entries = std::fs::read_dir(folder).map_err(failed)?;
    let mut files = entries.map(|entry| entry.map(|e| e.path())).collect::<Result<Vec<_>, _>>().map_err(failed)?;
    files.retain(|path| path.extension().is_some_and(|ending| ending == RECORDING));
    files.sort();
    if files.is_empty() { Err(SourceError::Empty(folder.to_owned())) } else { Ok(files) }
}

impl std::fmt::Display for ScenarioSource {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Generated(spec) => spec.fmt(f),
            Self::Recording { path, record: 0 } | Self::Argoverse2(path) => path.display().fmt(f),
            Self::Recording { path, record } => write!(f, "{} record {record}", path.display()),
            Self::NuPlan { found, .. } => write!(f, "{}#{}", found.log.path.display(), found.token),
        }
    }
}
