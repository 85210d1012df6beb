//! What a scenario reader is, and a reference to a scenario that it can open.

use super::split::Split;
use super::{Contents, Scenario};
use planagent_files::{path_of, word_of};
use planagent_world::InteractionKind;
use std::collections::{BTreeMap, BTreeSet};
use std::error::Error;
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Depth to which folders are searched for recordings; nuPlan's own tree needs
/// `nuplan-v1.1/splits/mini`.
pub(crate) const MAX_FOLDER_DEPTH: usize = 5;

/// Longest name of a scenario or a scenario type, bytes: as a path of Linux. Records of a run hold
/// no longer ones.
pub(crate) const MAX_NAME_BYTES: usize = 4096;

/// Called with the number of finished steps and the number of all.
pub type OnProgress<'a> = &'a (dyn Fn(usize, usize) + Sync);

/// One source of scenarios.
pub trait ScenarioReader: Send + Sync {
    /// Whether this reader takes a word of the command line, judged without reading a file.
    fn recognizes(&self, word: &str) -> bool;

    /// All scenarios that a recognized word names. Of a folder, those that the reader finds in it,
    /// possibly none; a file among others that cannot be read is a [`ScenarioRef::unreadable`].
    fn list(&self, word: &str) -> Result<Vec<ScenarioRef>, ReaderError>;

    /// What [`Self::list`] looks for in a folder, for a folder without scenarios; `None` where it
    /// reads no folders.
    fn looks_for(&self) -> Option<String> {
        None
    }

    /// The same word, independent of the working directory.
    fn absolute_word(&self, word: &str) -> String {
        absolute_path(word)
    }

    /// Names of the splits that this reader knows.
    fn splits(&self) -> Vec<&'static str> {
        Vec::new()
    }

    /// The scenarios of a named split or a filter file; `None` when the name is none of this
    /// reader's.
    fn split(
        &self,
        _name: &str,
        _on_progress: OnProgress<'_>,
    ) -> Option<Result<Split, ReaderError>> {
        None
    }

    /// What a user should know about the data that was read since the last call.
    fn take_notes(&self) -> Vec<String> {
        Vec::new()
    }
}

/// How a reader opens one of its scenarios.
pub trait OpenScenario: Send + Sync {
    /// Reads the scenario.
    fn open(&self) -> Result<Scenario, ReaderError>;

    /// Checks, without reading, that the files which opening needs exist: before the first
    /// simulation rather than in each.
    fn check(&self) -> Result<(), ReaderError> {
        Ok(())
    }

    /// The files that opening reads, as far as they can be named. Without any, the scenario's own
    /// file stands for it.
    fn files(&self) -> Vec<PathBuf> {
        Vec::new()
    }

    /// What can be counted without building the scenario; `None` where that is nothing.
    fn contents(&self) -> Result<Option<Contents>, ReaderError> {
        Ok(None)
    }
}

impl<F: Fn() -> Result<Scenario, ReaderError> + Send + Sync> OpenScenario for F {
    fn open(&self) -> Result<Scenario, ReaderError> {
        self()
    }
}

/// A scenario that can be opened, with what is known before that. Displayed as the word of the
/// command line that names it.
#[derive(Clone)]
pub struct ScenarioRef {
    word: String,
    id: Option<String>,
    scenario_type: Option<String>,
    /// The type before a modification that has one of its own.
    unmodified_type: Option<String>,
    log_name: String,
    path: Option<PathBuf>,
    part: String,
    fault: Option<String>,
    source: Arc<dyn OpenScenario>,
}

impl ScenarioRef {
    /// A scenario by the word that names it.
    pub fn new(word: impl Into<String>, source: impl OpenScenario + 'static) -> Self {
        let word = word.into();
        Self {
            log_name: word.clone(),
            part: word.clone(),
            word,
            id: None,
            scenario_type: None,
            unmodified_type: None,
            path: None,
            fault: None,
            source: Arc::new(source),
        }
    }

    /// A file among others that cannot be read. Its contents are unknown: it stands for one
    /// scenario, which fails.
    pub fn unreadable(path: &Path, fault: String) -> Self {
        let cause = fault.clone();
        let unopened = Self::new(word_of(path.as_os_str()), move || {
            Err(ReaderError::Unreadable(cause.clone()))
        });
        let log_name = path
            .file_stem()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        Self {
            log_name,
            fault: Some(fault),
            ..unopened.in_file(path, "")
        }
    }

    /// With the id that the opened scenario will have.
    #[must_use]
    pub fn with_id(mut self, id: impl Into<String>) -> Self {
        self.id = Some(id.into());
        self
    }

    /// With nuPlan's scenario type.
    #[must_use]
    pub fn with_type(mut self, scenario_type: impl Into<String>) -> Self {
        self.scenario_type = Some(scenario_type.into());
        self
    }

    /// With the type of its modification in place of its own.
    #[must_use]
    pub(super) fn modified_to(mut self, scenario_type: &str) -> Self {
        let own = self.scenario_type.replace(scenario_type.to_owned());
        self.unmodified_type = self.unmodified_type.or(own);
        self
    }

    /// With the name of the log.
    #[must_use]
    pub fn with_log_name(mut self, log_name: impl Into<String>) -> Self {
        self.log_name = log_name.into();
        self
    }

    /// With its file or folder, and its name in that where there are several. Two words that lead
    /// to one file and part are one scenario.
    #[must_use]
    pub fn in_file(mut self, path: impl Into<PathBuf>, part: impl Into<String>) -> Self {
        self.path = Some(path.into());
        self.part = part.into();
        self
    }

    /// The same with another source; `rename` gives word, id and part their new form.
    pub(super) fn with_source(
        self,
        rename: impl Fn(&str) -> String,
        wrap: impl FnOnce(Arc<dyn OpenScenario>) -> Arc<dyn OpenScenario>,
    ) -> Self {
        let (word, part) = (rename(&self.word), rename(&self.part));
        Self {
            word,
            part,
            id: self.id.as_deref().map(rename),
            source: wrap(self.source),
            ..self
        }
    }

    /// Id of the scenario, as far as it is known before opening.
    pub fn id(&self) -> Option<&str> {
        self.id.as_deref()
    }

    /// nuPlan's scenario type, as far as it is known before opening.
    pub fn scenario_type(&self) -> Option<&str> {
        self.scenario_type.as_deref()
    }

    /// The type of the scenario that a modification changed into one of its own type.
    pub fn unmodified_type(&self) -> Option<&str> {
        self.unmodified_type.as_deref()
    }

    /// Name of its log.
    pub fn log_name(&self) -> &str {
        &self.log_name
    }

    /// Its file or folder; `None` for a generated scenario.
    pub fn path(&self) -> Option<&Path> {
        self.path.as_deref()
    }

    /// Why its file cannot be read, for a file among others.
    pub fn fault(&self) -> Option<&str> {
        self.fault.as_deref()
    }

    /// Reads the scenario.
    pub fn open(&self) -> Result<Scenario, ReaderError> {
        self.source.open()
    }

    /// As [`OpenScenario::check`].
    pub fn check(&self) -> Result<(), ReaderError> {
        self.source.check()
    }

    /// As [`OpenScenario::files`]; the file that names the scenario, where the reader names none.
    pub fn files(&self) -> Vec<PathBuf> {
        let files = self.source.files();
        if files.is_empty() {
            self.path
                .clone()
                .filter(|path| path.is_file())
                .into_iter()
                .collect()
        } else {
            files
        }
    }

    /// As [`OpenScenario::contents`].
    pub fn contents(&self) -> Result<Option<Contents>, ReaderError> {
        self.source.contents()
    }

    /// Each scenario once, in the order in which they first appear; then the repeated ones, by
    /// whatever path.
    pub fn distinct(scenarios: Vec<Self>) -> (Vec<Self>, Vec<Self>) {
        let mut resolved: BTreeMap<PathBuf, PathBuf> = BTreeMap::new();
        let mut seen = BTreeSet::new();
        scenarios.into_iter().partition(|scenario| {
            let path = scenario.path.as_ref().map(|path| {
                // A path that cannot be resolved does not exist; opening the scenario will say so.
                let resolve = || path.canonicalize().unwrap_or_else(|_| path.clone());
                resolved.entry(path.clone()).or_insert_with(resolve).clone()
            });
            seen.insert((path, scenario.part.clone()))
        })
    }
}

impl fmt::Display for ScenarioRef {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.word)
    }
}

impl fmt::Debug for ScenarioRef {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "ScenarioRef({})", self.word)
    }
}

/// Equal by the word.
impl PartialEq for ScenarioRef {
    fn eq(&self, other: &Self) -> bool {
        self.word == other.word
    }
}

impl Eq for ScenarioRef {}

/// Why a word names no scenario, or a scenario cannot be opened.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message of a variant says what it is")]
#[non_exhaustive]
pub enum ReaderError {
    /// What a reader says.
    #[error(transparent)]
    Source(Box<dyn Error + Send + Sync>),
    #[error("there is no file or folder {}; a generated scenario is called generated/TYPE/SEED or \
        generated/TYPE/SEED.TRAFFIC", .0.display())]
    Missing(PathBuf),
    #[error(
        "{}: no kind of recording has such a name{}; Waymo's files are named *.tfrecord*, nuPlan's logs *.db, and Argoverse 2's \
         logs are folders",
        path.display(),
        kind.map_or(String::new(), |kind| format!(" (the file is {kind})"))
    )]
    UnknownFile {
        path: PathBuf,
        /// What the file is, by its first bytes.
        kind: Option<&'static str>,
    },
    #[error("cannot list the folder {}: {source}", path.display())]
    Folder {
        path: PathBuf,
        source: std::io::Error,
    },
    #[error(
        "'{name}' in '{word}' is no modification; name one of {}, or a file whose name ends in .toml (docs/modified.md)",
        InteractionKind::ALL.map(InteractionKind::name).join(", ")
    )]
    UnknownModification { word: String, name: String },
    #[error("'{start}' in '{word}' is no start; name seconds behind the '@', as {base}@3")]
    UnknownStart {
        word: String,
        base: String,
        start: String,
    },
    /// A file among others.
    #[error("{0}")]
    Unreadable(String),
    /// A start behind the end of the scenario.
    #[error(
        "the scenario ends at {end_s:.1} s and cannot start at {start_s:.1} s; name an earlier start behind the '@'"
    )]
    StartsTooLate { start_s: f64, end_s: f64 },
    #[error("the folder {} holds no scenarios: {}", path.display(), looked_for.join(", "))]
    Empty {
        path: PathBuf,
        looked_for: Vec<String>,
    },
}

impl ReaderError {
    /// The error of a reader.
    pub fn new(error: impl Into<Box<dyn Error + Send + Sync>>) -> Self {
        Self::Source(error.into())
    }
}

/// A note about files of a folder that are of another kind than their names say. `others` are the
/// errors of these files.
#[cfg(any(feature = "nuplan", feature = "womd"))]
pub(crate) fn passed_over(others: &[String]) -> Option<String> {
    match others {
        [] => None,
        [one] => Some(format!("passed over: {one}")),
        [first, rest @ ..] => Some(format!(
            "{} files are passed over, for example {first}",
            rest.len() + 1
        )),
    }
}

/// A path independent of the working directory; a word that is no path stays.
pub fn absolute_path(word: &str) -> String {
    std::path::absolute(path_of(word))
        .map_or_else(|_| word.to_owned(), |path| word_of(path.as_os_str()))
}

/// The two folders of nuPlan's data, as nuPlan's environment variables name them.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct DataRoots {
    /// `NUPLAN_DATA_ROOT`: the logs lie in it or in the folders below.
    pub data: Option<PathBuf>,
    /// `NUPLAN_MAPS_ROOT`: holds `nuplan-maps-v1.0.json` and a folder for each location.
    pub maps: Option<PathBuf>,
}

impl DataRoots {
    /// The folders that the environment names.
    pub fn from_environment() -> Self {
        let folder = |name: &str| {
            std::env::var_os(name)
                .filter(|value| !value.is_empty())
                .map(PathBuf::from)
        };
        Self {
            data: folder("NUPLAN_DATA_ROOT"),
            maps: folder("NUPLAN_MAPS_ROOT"),
        }
    }
}
