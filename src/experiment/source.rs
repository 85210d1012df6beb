//! Where scenarios come from, by the words of the command line.

use super::nuplan_data::{NuPlanData, NuPlanDataError};
use crate::scenario::Scenario;
use crate::scenario::argoverse2::{self, Argoverse2Error};
use crate::scenario::generator::{self, GeneratorError, Spec};
use crate::scenario::nuplan::{self, LogScenario, MapStore, NuPlanError};
use crate::scenario::womd::{self, Pick, WomdError};
use std::collections::{BTreeMap, BTreeSet};
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
        found: LogScenario,
        /// The maps, shared by all scenarios.
        maps: Arc<MapStore>,
    },
    /// A file among others that cannot be read. What it holds is not known: it stands for one scenario, which fails.
    Unreadable {
        /// The file.
        path: PathBuf,
        /// Why, with the file.
        cause: String,
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
    #[error("there is no file or folder {}; a generated scenario is called generated/TYPE/SEED or \
        generated/TYPE/SEED.TRAFFIC", .0.display())]
    Missing(PathBuf),
    /// The folder cannot be listed.
    #[error("cannot list the folder {}: {source}", path.display())]
    Folder {
        /// Which folder.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A file among others cannot be read.
    #[error("{0}")]
    Unreadable(String),
    /// The folder holds no recordings.
    #[error(
        "the folder {} is no Argoverse 2 log and holds no such logs (down to two folders below), no *.{RECORDING} files (right in \
         it) and no nuPlan logs (*.db) down to {} folders below",
        .0.display(),
        nuplan::MAX_FOLDER_DEPTH
    )]
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
            let mut all = Vec::new();
            for file in recordings_in(path)? {
                match Self::records_of(&file) {
                    Ok(records) => all.extend(records),
                    Err(error) => all.push(Self::Unreadable { path: file, cause: error.to_string() }),
                }
            }
            all.extend(argoverse2::logs_in(path)?.into_iter().map(Self::Argoverse2));
            all.extend(Self::of_nuplan(word, data)?);
            return match all.first() {
                None => Err(SourceError::Empty(path.to_owned())),
                Some(Self::Unreadable { cause, .. }) if all.iter().all(Self::is_unreadable) => {
                    Err(SourceError::Unreadable(cause.clone()))
                }
                Some(_) => Ok(all),
            };
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

    /// Whether it only stands for a file that cannot be read.
    pub fn is_unreadable(&self) -> bool {
        matches!(self, Self::Unreadable { .. })
    }

    /// The word by which the same scenarios are found from any working directory.
    pub fn absolute_word(word: &str) -> String {
        let absolute = || std::path::absolute(word).ok()?.into_os_string().into_string().ok();
        if Self::names_generated(word) { word.to_owned() } else { absolute().unwrap_or_else(|| word.to_owned()) }
    }

    /// Each scenario once, in the order in which they first appear; then those that came again, by whatever path.
    pub fn distinct(sources: Vec<Self>) -> (Vec<Self>, Vec<Self>) {
        let mut files: BTreeMap<PathBuf, PathBuf> = BTreeMap::new();
        let mut seen = BTreeSet::new();
        sources.into_iter().partition(|source| {
            let (path, part) = source.place();
            // What cannot be resolved is not there, and its drive will say so.
            let file = path.map(|path| {
                files
                    .entry(path.to_owned())
                    .or_insert_with(|| path.canonicalize().unwrap_or_else(|_| path.to_owned()))
                    .clone()
            });
            seen.insert((file, part))
        })
    }

    /// The file or folder of the scenario, and its name there.
    fn place(&self) -> (Option<&Path>, String) {
        match self {
            Self::Generated(spec) => (None, spec.to_string()),
            Self::Recording { path, record } => (Some(path), record.to_string()),
            Self::Argoverse2(path) | Self::Unreadable { path, .. } => (Some(path), String::new()),
            Self::NuPlan { found, .. } => (Some(&found.log.path), found.token.to_string()),
        }
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

    /// Name of the scenario, as far as it is known before it is opened.
    pub fn id(&self) -> Option<String> {
        match self {
            Self::Generated(spec) => Some(spec.to_string()),
            Self::Argoverse2(folder) => Some(argoverse2::name(folder)),
            Self::NuPlan { found, .. } => Some(found.token.to_string()),
            Self::Recording { .. } | Self::Unreadable { .. } => None,
        }
    }

    /// nuPlan's scenario type, as far as it is known before the scenario is opened.
    pub fn scenario_type(&self) -> Option<&str> {
        match self {
            Self::Generated(spec) => Some(spec.scenario_type.name()),
            Self::NuPlan { found, .. } => Some(&found.scenario_type),
            Self::Recording { .. } | Self::Argoverse2(_) | Self::Unreadable { .. } => None,
        }
    }

    /// Name of the log.
    pub fn log_name(&self) -> String {
        match self {
            Self::Generated(spec) => spec.log_name(),
            Self::Recording { path, .. } | Self::Unreadable { path, .. } => womd::log_name(path),
            Self::Argoverse2(folder) => argoverse2::name(folder),
            Self::NuPlan { found, .. } => found.log.name.clone(),
        }
    }

    /// Checks that the maps which scenarios need are there, without reading them: better before the first drive than in each.
    ///
    /// # Errors
    /// When the maps folder, or a map in it, is missing.
    pub fn check_maps(sources: &[Self]) -> Result<(), NuPlanError> {
        let mut seen = BTreeSet::new();
        for source in sources {
            if let Self::NuPlan { found, maps } = source
                && seen.insert(&found.map_name)
            {
                maps.check(&found.map_name)?;
            }
        }
        Ok(())
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
            Self::Unreadable { cause, .. } => Err(SourceError::Unreadable(cause.clone())),
        }
    }
}

/// The recordings of a folder, by name.
///
/// # Errors
/// When it cannot be listed.
pub fn recordings_in(folder: &Path) -> Result<Vec<PathBuf>, SourceError> {
    let failed = |source| SourceError::Folder { path: folder.to_owned(), source };
    let entries = std::fs::read_dir(folder).map_err(failed)?;
    let mut files = entries.map(|entry| entry.map(|e| e.path())).collect::<Result<Vec<_>, _>>().map_err(failed)?;
    files.retain(|path| path.extension().is_some_and(|ending| ending == RECORDING));
    files.sort();
    Ok(files)
}

impl std::fmt::Display for ScenarioSource {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Generated(spec) => spec.fmt(f),
            Self::Recording { path, record: 0 } | Self::Argoverse2(path) | Self::Unreadable { path, .. } => {
                path.display().fmt(f)
            }
            Self::Recording { path, record } => write!(f, "{} record {record}", path.display()),
            Self::NuPlan { found, .. } => write!(f, "{}#{}", found.log.path.display(), found.token),
        }
    }
}
