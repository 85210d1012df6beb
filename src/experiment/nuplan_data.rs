//! Scenarios of nuPlan logs, by filter or by the words of the command line.

use super::source::ScenarioSource;
use crate::scenario::nuplan::{
    DataRoots, Exclusion, Exclusions, LogScenario, Logs, MapStore, NuPlanError, ScenarioFilter, SearchResult,
    THRESHOLD_KEY, ThresholdScope, Token, TokenError, UnreadableLog, find, tag_types,
};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// Ending of nuPlan's logs.
const LOG_ENDING: &str = ".db";
/// Separates a log from the token of one of its scenarios.
const TOKEN_MARK: char = '#';
/// Scenarios of a log that is named without a token begin so long after one another, s: as in nuPlan's challenge.
const MIN_SPACING_S: f64 = 15.0;

/// Where nuPlan's data lies, with the maps that were read from there.
#[derive(Debug)]
pub struct NuPlanData {
    roots: DataRoots,
    maps: Arc<MapStore>,
    notes: Mutex<Vec<String>>,
}

/// Why a word names no scenario of a nuPlan log.
#[derive(Debug, thiserror::Error)]
pub enum NuPlanDataError {
    /// A log or map cannot be read.
    #[error(transparent)]
    Read(#[from] NuPlanError),
    /// There is no such file.
    #[error("there is no log {}; name it by its path: only splits are looked for in the data root", .0.display())]
    NoLog(PathBuf),
    /// What follows the file is no token.
    #[error("{word}: {source}")]
    Token {
        /// The word.
        word: String,
        /// Why.
        source: TokenError,
    },
    /// The log does not hold the token.
    #[error("{}: no scenario {token}: the log does not hold it", path.display())]
    Absent {
        /// Which log.
        path: PathBuf,
        /// Which token.
        token: Token,
    },
    /// The token is no scenario.
    #[error("{}: no scenario {token}: {refusal}", path.display())]
    Refused {
        /// Which log.
        path: PathBuf,
        /// Which token.
        token: Token,
        /// Why.
        refusal: Exclusion,
    },
    /// No row is tagged.
    #[error("{}: no row has a scenario tag; name one as FILE.db{TOKEN_MARK}TOKEN", .0.display())]
    NoTags(PathBuf),
    /// No tagged row is a scenario.
    #[error("{}: no scenario found: {left_out}", path.display())]
    NothingFound {
        /// Which log or folder.
        path: PathBuf,
        /// What was looked at.
        left_out: Exclusions,
    },
}

/// What a search of the data root gives.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Searched {
    /// The scenarios.
    pub sources: Vec<ScenarioSource>,
    /// Tokens of the filter that no log holds.
    pub absent: Vec<Token>,
    /// Tokens of the filter that a log holds but that are no scenario of it.
    pub refused: Vec<(Token, Exclusion)>,
    /// What was looked at and not taken.
    pub left_out: Exclusions,
    /// Logs that cannot be read.
    pub unreadable: Vec<ScenarioSource>,
    /// What a user should know about the search.
    pub notes: Vec<String>,
}

impl NuPlanData {
    /// The data below these folders; nothing is read yet.
    pub fn new(roots: DataRoots) -> Self {
        let maps = Arc::new(MapStore::new(roots.maps.clone()));
        Self { roots, maps, notes: Mutex::default() }
    }

    /// What a user should know about the maps, logs and folders that were opened since this was asked last.
    pub fn take_notes(&self) -> Vec<String> {
        let mut notes = std::mem::take(&mut *self.notes.lock().unwrap_or_else(PoisonError::into_inner));
        notes.extend(self.maps.take_notes());
        notes
    }

    /// The scenarios of a filter among the logs of the data root. `progress` is told how many logs of how many are searched.
    ///
    /// # Errors
    /// When there is no data root, or none of its logs can be read.
    pub fn search(
        &self,
        filter: &ScenarioFilter,
        progress: &(dyn Fn(usize, usize) + Sync),
    ) -> Result<Searched, NuPlanError> {
        let Logs { logs, notes } = self.roots.logs()?;
        let SearchResult { found, absent, refused, left_out, unreadable } = find(&logs, filter, &self.maps, progress)?;
        let unreadable = unreadable.into_iter().map(unreadable_source).collect();
        Ok(Searched { sources: self.sources(found), absent, refused, left_out, unreadable, notes })
    }

    /// Whether a word has the form `LOG.db` or `LOG.db#TOKEN`.
    pub fn names_log(word: &str) -> bool {
        split_token(word).0.ends_with(LOG_ENDING)
    }

    /// The scenarios of a log: the named one, else the tagged ones.
    pub(super) fn in_log(&self, word: &str) -> Result<Vec<ScenarioSource>, NuPlanDataError> {
        let (file, token) = split_token(word);
        let path = Path::new(file);
        if !path.exists() {
            return Err(NuPlanDataError::NoLog(path.to_owned()));
        }
        let Some(token) = token else { return self.tagged(&Logs::under(path)?, path) };
        let token: Token = token.parse().map_err(|source| NuPlanDataError::Token { word: word.to_owned(), source })?;
        let filter = ScenarioFilter { scenario_tokens: Some(vec![token]), ..ScenarioFilter::default() };
        let findings = find(&Logs::under(path)?.logs, &filter, &self.maps, &|_, _| {})?;
        let path = path.to_owned();
        match findings.refused.first() {
            Some(&(token, refusal)) => Err(NuPlanDataError::Refused { path, token, refusal }),
            None if findings.found.is_empty() => Err(NuPlanDataError::Absent { path, token }),
            None => Ok(self.sources(findings.found)),
        }
    }

    /// The tagged scenarios of all logs in a folder; none when it holds no log.
    pub(super) fn in_folder(&self, folder: &Path) -> Result<Vec<ScenarioSource>, NuPlanDataError> {
        match Logs::under(folder) {
            Err(NuPlanError::NoLogs(_)) => Ok(Vec::new()),
            logs => self.tagged(&logs?, folder),
        }
    }

    /// All tagged scenarios that begin 15 s after one another, log by log and type by type; then the logs that cannot be read.
    fn tagged(&self, logs: &Logs, path: &Path) -> Result<Vec<ScenarioSource>, NuPlanDataError> {
        let types = tag_types(&logs.logs)?;
        if types.is_empty() {
            return Err(NuPlanDataError::NoTags(path.to_owned()));
        }
        let filter = ScenarioFilter {
            scenario_types: Some(types),
            timestamp_threshold_s: Some(MIN_SPACING_S),
            threshold_scope: ThresholdScope::EachLog,
            ..ScenarioFilter::default()
        };
        let SearchResult { found, left_out, unreadable, .. } = find(&logs.logs, &filter, &self.maps, &|_, _| {})?;
        if found.is_empty() {
            return Err(NuPlanDataError::NothingFound { path: path.to_owned(), left_out });
        }
        self.note(logs.notes.iter().map(|note| format!("{}: {note}", path.display())));
        let close = left_out.by(THRESHOLD_KEY);
        self.note((close > 0).then(|| {
            format!(
                "{}: {close} tagged scenarios are left out: they begin less than {MIN_SPACING_S} s after one of their type in the same \
                 log; name one as LOG.db{TOKEN_MARK}TOKEN to drive it",
                path.display()
            )
        }));
        let mut sources = self.sources(found);
        sources.extend(unreadable.into_iter().map(unreadable_source));
        Ok(sources)
    }

    fn note(&self, notes: impl IntoIterator<Item = String>) {
        self.notes.lock().unwrap_or_else(PoisonError::into_inner).extend(notes);
    }

    fn sources(&self, found: Vec<LogScenario>) -> Vec<ScenarioSource> {
        found.into_iter().map(|found| ScenarioSource::NuPlan { found, maps: self.maps.clone() }).collect()
    }
}

fn unreadable_source(unreadable: UnreadableLog) -> ScenarioSource {
    ScenarioSource::Unreadable { path: unreadable.log.path.clone(), cause: unreadable.cause }
}

/// A word without its token, and the token.
fn split_token(word: &str) -> (&str, Option<&str>) {
    match word.rsplit_once(TOKEN_MARK) {
        Some((file, token)) if file.ends_with(LOG_ENDING) => (file, Some(token)),
        _ => (word, None),
    }
}
