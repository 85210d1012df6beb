//! `WORD~NAME` and `WORD~FILE.toml`: words of modified scenarios.

use super::error::ModifyError;
use super::file::Modification;
use super::twin::Twin;
use super::{kinds, modified};
use crate::interplan::InterPlanName;
use crate::reader::{OpenScenario, ReaderError, ScenarioRef, absolute_path};
use crate::{Contents, Scenario};
use planagent_files::path_of;
use planagent_world::InteractionKind;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Between the word of a scenario and its modification.
pub const MARK: char = '~';
/// Ending of files.
const ENDING: &str = ".toml";

/// A word without its modification.
pub fn without_modification(word: &str) -> &str {
    ModifiedName::in_word(word).map_or(word, |(base, _)| base)
}

/// What a word names behind [`MARK`]: a built-in kind, or a file, each with a seed of its own
/// behind a point.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ModifiedName {
    source: Source,
    seed: u64,
}

#[derive(Debug, Clone, PartialEq, Eq)]
enum Source {
    Kind(InteractionKind),
    /// A scene of interPlan's.
    InterPlan(InterPlanName),
    /// A part of a pair with one text.
    Twin(Twin),
    /// The word of a path.
    File(String),
}

impl ModifiedName {
    /// A built-in kind.
    pub fn for_kind(kind: InteractionKind) -> Self {
        Self {
            source: Source::Kind(kind),
            seed: 0,
        }
    }

    /// A part of a pair.
    pub fn of_twin(twin: Twin) -> Self {
        Self {
            source: Source::Twin(twin),
            seed: 0,
        }
    }

    /// `KIND`, `KIND.SEED`, `FILE.toml`, `FILE.toml.SEED`, or letters of interPlan's as `dhgloa`;
    /// `None` for other words.
    pub fn parse(word: &str) -> Option<Self> {
        let (name, seed) = match word.rsplit_once('.') {
            Some((name, seed))
                if !seed.is_empty() && seed.bytes().all(|byte| byte.is_ascii_digit()) =>
            {
                (name, seed.parse().ok()?)
            }
            _ => (word, 0),
        };
        // The letters of a scene of interPlan's; the empty name is none.
        let scene = || {
            InterPlanName::parse(word)
                .ok()
                .filter(|_| !word.is_empty())
                .map(Source::InterPlan)
        };
        if let Some(source) = scene() {
            return Some(Self { source, seed: 0 });
        }
        let kind = InteractionKind::named(name).map(Source::Kind);
        let twin = || Twin::named(name).map(Source::Twin);
        let file = || {
            (name.len() > ENDING.len() && name.ends_with(ENDING))
                .then(|| Source::File(name.to_owned()))
        };
        Some(Self {
            source: kind.or_else(twin).or_else(file)?,
            seed,
        })
    }

    /// The word before the mark and the modification behind it, unless the whole is the name of a
    /// file.
    pub fn in_word(word: &str) -> Option<(&str, Self)> {
        let (base, name) = word.rsplit_once(MARK)?;
        let parsed = Self::parse(name).filter(|_| !base.is_empty())?;
        (!path_of(word).exists()).then_some((base, parsed))
    }

    /// The same, independent of the working directory.
    #[must_use]
    pub fn absolute(self) -> Self {
        match self.source {
            Source::File(word) => Self {
                source: Source::File(absolute_path(&word)),
                ..self
            },
            Source::Kind(_) | Source::InterPlan(_) | Source::Twin(_) => self,
        }
    }

    /// A word with this modification.
    pub fn mark(&self, base: &str) -> String {
        let seed = if self.seed == 0 {
            String::new()
        } else {
            format!(".{}", self.seed)
        };
        match &self.source {
            Source::Kind(kind) => format!("{base}{MARK}{kind}{seed}"),
            Source::InterPlan(name) => format!("{base}{MARK}{name}"),
            Source::Twin(twin) => format!("{base}{MARK}{twin}{seed}"),
            Source::File(word) => format!("{base}{MARK}{word}{seed}"),
        }
    }

    /// Reads the modification.
    ///
    /// # Errors
    /// When the file cannot be read or says what no modification can be.
    pub fn read(&self) -> Result<ReadModification, ModifyError> {
        let modification = match &self.source {
            Source::Kind(kind) => kinds::modification(*kind)?,
            Source::InterPlan(name) => Arc::new(Modification::of_scene(name)?),
            Source::Twin(twin) => Arc::new(twin.modification()?),
            Source::File(word) => Arc::new(Modification::read(&path_of(word))?),
        };
        let file = match &self.source {
            Source::Kind(_) | Source::InterPlan(_) | Source::Twin(_) => None,
            Source::File(word) => Some(path_of(word)),
        };
        Ok(ReadModification {
            name: self.clone(),
            modification,
            file,
        })
    }
}

/// A modification that was read once, for many scenarios.
#[derive(Debug, Clone)]
pub struct ReadModification {
    name: ModifiedName,
    modification: Arc<Modification>,
    file: Option<PathBuf>,
}

impl ReadModification {
    /// The modified scenario of a reference: its word ends in the modification, its id in the name
    /// of that.
    pub fn modify(&self, source: ScenarioRef) -> ScenarioRef {
        let id = source.id().map(|id| self.id(id));
        let kind = self.modification.kind;
        let modified_source = ModifiedSource {
            base: source.clone(),
            own: self.clone(),
        };
        let mut modified = source.with_source(
            |part| self.name.mark(part),
            move |_| Arc::new(modified_source),
        );
        if let Some(id) = id {
            modified = modified.with_id(id);
        }
        match kind {
            Some(kind) => modified.modified_to(kind.name()),
            None => modified,
        }
    }

    fn id(&self, id: &str) -> String {
        let seed = if self.name.seed == 0 {
            String::new()
        } else {
            format!(".{}", self.name.seed)
        };
        format!("{id}{MARK}{}{seed}", self.modification.name)
    }

    /// The modified scenario.
    ///
    /// # Errors
    /// When the modification does not fit it.
    pub fn apply(&self, base: Scenario) -> Result<Scenario, ModifyError> {
        let id = self.id(&base.id);
        match modified(base, &self.modification, self.name.seed) {
            Ok(scenario) => Ok(Scenario { id, ..scenario }),
            Err(misfit) => Err(match self.name.source {
                Source::Kind(kind) => ModifyError::KindMisfit {
                    misfit: Box::new(misfit),
                    kind,
                },
                Source::InterPlan(_) | Source::Twin(_) | Source::File(_) => misfit,
            }),
        }
    }

    /// Its file.
    pub fn file(&self) -> Option<&Path> {
        self.file.as_deref()
    }
}

/// A scenario with a modification.
struct ModifiedSource {
    base: ScenarioRef,
    own: ReadModification,
}

impl OpenScenario for ModifiedSource {
    fn open(&self) -> Result<Scenario, ReaderError> {
        self.own.apply(self.base.open()?).map_err(ReaderError::new)
    }

    fn check(&self) -> Result<(), ReaderError> {
        self.base.check()
    }

    fn files(&self) -> Vec<PathBuf> {
        self.base
            .files()
            .into_iter()
            .chain(self.own.file.clone())
            .collect()
    }

    fn contents(&self) -> Result<Option<Contents>, ReaderError> {
        self.base.contents()
    }
}
