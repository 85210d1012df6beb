//! Scenarios of nuPlan logs, by filter or by the words of the command line.

use super::source::ScenarioSource;
use crate::scenario::nuplan::{
    DataRoots, Findings, Found, Logs, MapStore, NuPlanError, Refusal, ScenarioFilter, Token, TokenError, find,
    tag_types,
};
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Ending of nuPlan's logs.
const LOG_ENDING: &str = ".db";
/// Separates a log from the token of one of its scenarios.
const TOKEN_MARK: char = '#';
/// Scenarios of a log that is named without a token begin so long after one another, s: as in nuPlan's challenge.
const APART_S: f64 = 15.0;

/// Where nuPlan's data lies, with the maps that were read from there.
#[derive(Debug)]
pub struct NuPlanData {
    roots: DataRoots,
    maps: Arc<MapStore>,
}

/// Why a word names no scenario of a nuPlan log.
#[derive(Debug, thiserror::Error)]
pub enum NuPlanDataError {
    /// A log or map cannot be read.
    #[error(transparent)]
    Read(#[from] NuPlanError),
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
        refusal: Refusal,
    },
    /// No row is tagged.
    #[error("{}: no row has a scenario tag; name one as FILE.db{TOKEN_MARK}TOKEN", .0.display())]
    NoTags(PathBuf),
}

/// Tokens of a list that give no scenario.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct MissingTokens {
    /// How many tokens the list has.
    pub wanted: usize,
    /// Those that no log holds.
    pub absent: Vec<Token>,
    /// Those that a log holds but that are no scenario, each with the reason.
    pub refused: Vec<(Token, Refusal)>,
}

impl MissingTokens {
    /// Whether every token gives a scenario.
    pub fn is_empty(&self) -> bool {
        self.absent.is_empty() && self.refused.is_empty()
    }
}

impl fmt::Display for MissingTokens {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        /// So many tokens are named.
        const NAMED: usize = 5;
        let missing = self.absent.len() + self.refused.len();
        write!(f, "{missing} of {} scenarios are missing", self.wanted)?;
        if !self.absent.is_empty() {
            let first: Vec<String> = self.absent.iter().take(NAMED).map(ToString::to_string).collect();
            let more = if self.absent.len() > NAMED { ", ..." } else { "" };
            write!(f, "; {} in no log: {}{more}", self.absent.len(), first.join(", "))?;
        }
        if !self.refused.is_empty() {
            let first = self.refused.iter().take(NAMED).map(|(token, refusal)| format!("{token} ({refusal})"));
            let first: Vec<String> = first.collect();
            let more = if self.refused.len() > NAMED { ", ..." } else { "" };
            write!(f, "; {} that are no scenario: {}{more}", self.refused.len(), first.join(", "))?;
        }
        Ok(())
    }
}

impl NuPlanData {
    /// The data below these folders; nothing is read yet.
    pub fn new(roots: DataRoots) -> Self {
        let maps = Arc::new(MapStore::new(roots.maps.clone()));
        Self { roots, maps }
    }

    /// What a user should know about the maps and logs that were opened so far.
    pub fn notes(&self) -> Vec<String> {
        self.maps.notes()
    }

    /// The scenarios of a filter among the logs of the data root; also what a user should know about the search, and the tokens
    /// that give no scenario. `progress` is told how many logs of how many are searched.
    ///
    /// # Errors
    /// When there is no data root, or a log cannot be read.
    pub fn search(
        &self,
        filter: &ScenarioFilter,
        progress: &(dyn Fn(usize, usize) + Sync),
    ) -> Result<(Vec<ScenarioSource>, Vec<String>, MissingTokens), NuPlanError> {
        let Logs { logs, notes } = self.roots.logs()?;
        let Findings { found, absent, refused } = find(&logs, filter, &self.maps, progress)?;
        let wanted = filter.scenario_tokens.as_ref().map_or(0, Vec::len);
        Ok((self.sources(found), notes, MissingTokens { wanted, absent, refused }))
    }

    /// Whether a word has the form `LOG.db` or `LOG.db#TOKEN`.
    pub fn names_log(word: &str) -> bool {
        split_token(word).0.ends_with(LOG_ENDING)
    }

    /// The scenarios of a log: the named one, else all tagged ones that begin 15 s after one another, type by type.
    pub(super) fn in_log(&self, word: &str) -> Result<Vec<ScenarioSource>, NuPlanDataError> {
        let (file, token) = split_token(word);
        let path = Path::new(file);
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

    fn tagged(&self, logs: &Logs, path: &Path) -> Result<Vec<ScenarioSource>, NuPlanDataError> {
        let types = tag_types(&logs.logs)?;
        if types.is_empty() {
            return Err(NuPlanDataError::NoTags(path.to_owned()));
        }
        let filter = ScenarioFilter {
            scenario_types: Some(types),
            timestamp_threshold_s: Some(APART_S),
            ..ScenarioFilter::default()
        };
        Ok(self.sources(find(&logs.logs, &filter, &self.maps, &|_, _| {})?.found))
    }

    fn sources(&self, found: Vec<Found>) -> Vec<ScenarioSource> {
        found.into_iter().map(|found| ScenarioSource::NuPlan { found, maps: self.maps.clone() }).collect()
    }
}

/// A word without its token, and the token.
fn split_token(word: &str) -> (&str, Option<&str>) {
    match word.rsplit_once(TOKEN_MARK) {
        Some((file, token)) if file.ends_with(LOG_ENDING) => (file, Some(token)),
        _ => (word, None),
    }
}
