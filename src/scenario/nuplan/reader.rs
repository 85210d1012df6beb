//! nuPlan's logs in the registry of readers: words that name a log or one of its scenarios, and
//! splits.

use super::error::FileFault;
use super::logs::UnreadableLog;
use super::search::{SearchResult, search, tag_types};
use super::split::{self, SplitError};
use super::{
    Exclusion, Exclusions, LogScenario, Logs, MapStore, NuPlanError, ScenarioFilter, THRESHOLD_KEY,
    ThresholdScope, Token, TokenError, open,
};
use crate::reader::passed_over;
use crate::{
    DataRoots, OnProgress, OpenScenario, ReaderError, Scenario, ScenarioReader, ScenarioRef, Split,
};
use planagent_files::{path_of, word_of};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// Ending of nuPlan's logs.
const LOG_ENDING: &str = ".db";
/// Separates a log from the token of one of its scenarios.
const TOKEN_MARK: char = '#';
/// Minimum time between the starts of tagged scenarios of one type in one log, s: as in nuPlan's
/// challenge.
const MIN_SPACING_S: f64 = 15.0;

/// Takes words of the form `LOG.db` or `LOG.db#TOKEN`, folders of logs, published splits and filter
/// files.
#[derive(Debug)]
pub struct NuPlanReader {
    roots: DataRoots,
    maps: Arc<MapStore>,
    notes: Mutex<Vec<String>>,
}

/// Why a word names no scenario of a nuPlan log.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message of a variant says what it is")]
pub(crate) enum LogWordError {
    #[error(transparent)]
    Read(#[from] NuPlanError),
    #[error("there is no log {}; name it by its path: only splits are looked for in the data root", .0.display())]
    NoLog(PathBuf),
    #[error("{word}: {source}")]
    Token { word: String, source: TokenError },
    #[error("{}: no scenario {token}: the log does not hold it", path.display())]
    Absent { path: PathBuf, token: Token },
    #[error("{}: no scenario {token}: {exclusion}", path.display())]
    Excluded {
        path: PathBuf,
        token: Token,
        exclusion: Exclusion,
    },
    #[error("{}: no row has a scenario tag; name one as FILE.db{TOKEN_MARK}TOKEN", .0.display())]
    NoTags(PathBuf),
    #[error("{}: no scenario found: {exclusions}", path.display())]
    NothingFound {
        path: PathBuf,
        exclusions: Exclusions,
    },
}

impl NuPlanReader {
    /// The data below these folders; nothing is read yet.
    pub fn new(roots: DataRoots) -> Self {
        let maps = Arc::new(MapStore::new(roots.maps.clone()));
        Self {
            roots,
            maps,
            notes: Mutex::default(),
        }
    }

    /// The scenarios of a log: the named one, else the tagged ones.
    fn in_log(&self, word: &str) -> Result<Vec<ScenarioRef>, LogWordError> {
        let (file, token) = split_token(word);
        let path = &path_of(file);
        if !path.exists() {
            return Err(LogWordError::NoLog(path.to_owned()));
        }
        let Some(token) = token else {
            return self.tagged(&Logs::under(path)?, path);
        };
        let token: Token = token.parse().map_err(|source| LogWordError::Token {
            word: word.to_owned(),
            source,
        })?;
        let filter = ScenarioFilter {
            scenario_tokens: Some(vec![token]),
            ..ScenarioFilter::default()
        };
        let result = search(&Logs::under(path)?.logs, &filter, &self.maps, &|_, _| {})?;
        let path = path.to_owned();
        match result.excluded.first() {
            Some(&(token, exclusion)) => Err(LogWordError::Excluded {
                path,
                token,
                exclusion,
            }),
            None if result.scenarios.is_empty() => Err(LogWordError::Absent { path, token }),
            None => Ok(self.references(result.scenarios)),
        }
    }

    /// The tagged scenarios of all logs in a folder; none when it holds no log.
    fn in_folder(&self, folder: &Path) -> Result<Vec<ScenarioRef>, LogWordError> {
        match Logs::under(folder) {
            Err(NuPlanError::File { path, fault }) => match *fault {
                FileFault::NoLogs(passed_over) => {
                    self.note(passed_over);
                    Ok(Vec::new())
                }
                fault => Err(NuPlanError::file(&path, fault).into()),
            },
            logs => {
                let logs = logs?;
                let result = self.tagged(&logs, folder);
                // Other programs write databases too, beside recordings of other kinds.
                if result.is_err() && logs.logs.iter().all(|log| log.is_another_database()) {
                    let paths = logs.logs.iter().map(|log| log.path.display());
                    let others: Vec<String> =
                        paths.map(|path| format!("{path}: no nuPlan log")).collect();
                    self.note(passed_over(&others));
                    return Ok(Vec::new());
                }
                result
            }
        }
    }

    /// Tagged scenarios at least 15 s apart, log by log and type by type; then the logs that cannot
    /// be read.
    fn tagged(&self, logs: &Logs, path: &Path) -> Result<Vec<ScenarioRef>, LogWordError> {
        let types = tag_types(&logs.logs)?;
        if types.is_empty() {
            return Err(LogWordError::NoTags(path.to_owned()));
        }
        let filter = ScenarioFilter {
            scenario_types: Some(types),
            timestamp_threshold_s: Some(MIN_SPACING_S),
            threshold_scope: ThresholdScope::EachLog,
            ..ScenarioFilter::default()
        };
        let SearchResult {
            scenarios,
            exclusions,
            unreadable,
            ..
        } = search(&logs.logs, &filter, &self.maps, &|_, _| {})?;
        if scenarios.is_empty() {
            return Err(LogWordError::NothingFound {
                path: path.to_owned(),
                exclusions,
            });
        }
        self.note(
            logs.notes
                .iter()
                .map(|note| format!("{}: {note}", path.display())),
        );
        let close = exclusions.by(THRESHOLD_KEY);
        self.note((close > 0).then(|| {
            format!(
                "{}: {close} tagged scenarios are left out: they begin less than {MIN_SPACING_S} s after one of their type in the \
                 same log; name one as LOG.db{TOKEN_MARK}TOKEN to simulate it",
                path.display()
            )
        }));
        let mut references = self.references(scenarios);
        let (others, unreadable): (Vec<_>, Vec<_>) = unreadable
            .into_iter()
            .partition(|unreadable| unreadable.log.is_another_database());
        // A folder may hold databases of other programs: a note is enough for them, a broken log is
        // an error.
        let others: Vec<String> = others.into_iter().map(|other| other.cause).collect();
        self.note(passed_over(&others));
        references.extend(unreadable.into_iter().map(unreadable_reference));
        Ok(references)
    }

    fn split_named(
        &self,
        name: &str,
        on_progress: OnProgress<'_>,
    ) -> Option<Result<Split, SplitError>> {
        let list = match split::open(name)? {
            Ok(list) => list,
            Err(error) => return Some(Err(error)),
        };
        Some(
            Logs::of_root(&self.roots)
                .map_err(SplitError::from)
                .and_then(|Logs { logs, notes }| {
                    let mut result = search(&logs, &list.filter, &self.maps, on_progress)?;
                    let scenarios = self.references(std::mem::take(&mut result.scenarios));
                    let unreadable = std::mem::take(&mut result.unreadable)
                        .into_iter()
                        .map(unreadable_reference)
                        .collect();
                    list.noting(notes).split(result, scenarios, unreadable)
                }),
        )
    }

    fn note(&self, notes: impl IntoIterator<Item = String>) {
        self.notes
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .extend(notes);
    }

    fn references(&self, scenarios: Vec<LogScenario>) -> Vec<ScenarioRef> {
        let reference = |scenario: LogScenario| {
            let (log, token) = (scenario.log.clone(), scenario.token.to_string());
            let (word, scenario_type) = (
                format!("{}{TOKEN_MARK}{token}", word_of(log.path.as_os_str())),
                scenario.scenario_type.clone(),
            );
            ScenarioRef::new(
                word,
                InLog {
                    scenario,
                    maps: self.maps.clone(),
                },
            )
            .with_id(token.clone())
            .with_type(scenario_type)
            .with_log_name(log.name.clone())
            .in_file(log.path.clone(), token)
        };
        scenarios.into_iter().map(reference).collect()
    }
}

impl ScenarioReader for NuPlanReader {
    fn recognizes(&self, word: &str) -> bool {
        split_token(word).0.ends_with(LOG_ENDING)
    }

    fn list(&self, word: &str) -> Result<Vec<ScenarioRef>, ReaderError> {
        let listed = if self.recognizes(word) {
            self.in_log(word)
        } else {
            self.in_folder(&path_of(word))
        };
        listed.map_err(ReaderError::new)
    }

    fn looks_for(&self) -> Option<String> {
        Some(format!("nuPlan logs (*{LOG_ENDING})"))
    }

    fn splits(&self) -> Vec<&'static str> {
        split::names()
    }

    fn split(&self, name: &str, on_progress: OnProgress<'_>) -> Option<Result<Split, ReaderError>> {
        self.split_named(name, on_progress)
            .map(|split| split.map_err(ReaderError::new))
    }

    fn take_notes(&self) -> Vec<String> {
        let mut notes =
            std::mem::take(&mut *self.notes.lock().unwrap_or_else(PoisonError::into_inner));
        notes.extend(self.maps.take_notes());
        notes
    }
}

/// A scenario of a log, and the maps, which all scenarios share.
struct InLog {
    scenario: LogScenario,
    maps: Arc<MapStore>,
}

impl OpenScenario for InLog {
    fn open(&self) -> Result<Scenario, ReaderError> {
        open(&self.maps, &self.scenario).map_err(ReaderError::new)
    }

    fn check(&self) -> Result<(), ReaderError> {
        self.maps
            .check(&self.scenario.map_name)
            .map(|_| ())
            .map_err(ReaderError::new)
    }

    fn files(&self) -> Vec<PathBuf> {
        let map = self.maps.check(&self.scenario.map_name).ok();
        [self.scenario.log.path.clone()]
            .into_iter()
            .chain(map)
            .collect()
    }
}

fn unreadable_reference(unreadable: UnreadableLog) -> ScenarioRef {
    ScenarioRef::unreadable(&unreadable.log.path, unreadable.cause)
}

/// A word without its token, and the token.
fn split_token(word: &str) -> (&str, Option<&str>) {
    match word.rsplit_once(TOKEN_MARK) {
        Some((file, token)) if file.ends_with(LOG_ENDING) => (file, Some(token)),
        _ => (word, None),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn databases_of_other_programs_are_no_logs_of_a_folder() {
        let folder = tempfile::tempdir().unwrap();
        rusqlite::Connection::open(folder.path().join("photos.db"))
            .unwrap()
            .execute_batch("CREATE TABLE album (name TEXT)")
            .unwrap();
        let reader = NuPlanReader::new(DataRoots::default());
        assert!(reader.in_folder(folder.path()).unwrap().is_empty());
        let notes = reader.take_notes();
        assert!(notes[0].contains("photos.db: no nuPlan log"), "{notes:?}");
    }
}
