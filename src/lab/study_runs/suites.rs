//! The suites of studies.

use super::request::StudiesRequest;
use crate::study::{Quick, Starts};
use planagent_files::word_of;
use planagent_runs::report::{DataFile, ScenarioList};
use planagent_runs::runner::RunnerError;
use planagent_runs::runner::inputs::data_files;
use planagent_runs::runner::sample::Sample;
use planagent_runs::runner::selection::{Selected, absolute, scenario_list, select};
use planagent_runs::runner::{Event, Listener};
use planagent_runs::worker::suite::RECORDED;
use planagent_scenario::{DataRoots, RECORDINGS, Readers, ScenarioRef, absolute_path};
use planagent_world::STEP_S;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::rc::Rc;

/// Environment variable that names a folder of recordings.
const DATA: &str = "PLANAGENT_DATA";

/// The scenarios of a suite, found in the data of this machine.
pub(super) struct SelectedSuite {
    pub(super) name: String,
    pub(super) sources: Vec<ScenarioRef>,
    /// The same as a run's manifest lists them.
    pub(super) list: ScenarioList,
    /// Their files.
    pub(super) data: BTreeMap<String, DataFile>,
}

/// The suites of a session; each is searched once.
pub(super) struct Suites<'a> {
    request: &'a StudiesRequest,
    listener: &'a Listener,
    roots: DataRoots,
    readers: Readers,
    /// By name and start times.
    found: BTreeMap<String, Rc<SelectedSuite>>,
    /// Studies that lack recordings.
    lacking: Vec<String>,
    limit: Option<usize>,
}

impl<'a> Suites<'a> {
    pub(super) fn new(
        request: &'a StudiesRequest,
        listener: &'a Listener,
    ) -> Result<Self, RunnerError> {
        let roots = absolute(request.roots.clone())?;
        Ok(Self {
            request,
            listener,
            readers: Readers::new(&roots),
            roots,
            found: BTreeMap::new(),
            lacking: Vec::new(),
            limit: request.limit,
        })
    }

    /// The suites of a study: those of the request, else its own; recordings only where there
    /// are some.
    pub(super) fn select(
        &mut self,
        study: &str,
        own: &[impl AsRef<str>],
        starts: Option<Starts>,
    ) -> Result<Vec<Rc<SelectedSuite>>, RunnerError> {
        let request = self.request;
        if !request.suites.is_empty() {
            return request
                .suites
                .iter()
                .map(|name| self.named(name, starts))
                .collect();
        }
        let mut suites = Vec::new();
        for name in own {
            let name = name.as_ref();
            if name == RECORDED && self.recordings().is_empty() {
                self.lacking.push(study.to_owned());
            } else {
                suites.push(self.named(name, starts)?);
            }
        }
        Ok(suites)
    }

    /// Says which studies go on without recordings.
    pub(super) fn note_lacking(&mut self) {
        for study in self.lacking.drain(..) {
            let text = format!(
                "{study}: no recordings: neither --scenario nor ${DATA} names a folder that is there"
            );
            (self.listener)(Event::Note(text));
        }
    }

    fn named(
        &mut self,
        name: &str,
        starts: Option<Starts>,
    ) -> Result<Rc<SelectedSuite>, RunnerError> {
        let starts = starts.filter(|_| name == RECORDED);
        let key = format!("{name} {starts:?}");
        if let Some(suite) = self.found.get(&key) {
            return Ok(Rc::clone(suite));
        }
        let suite = self.find(name, starts);
        let suite = suite.map_err(|source| RunnerError::Suite {
            name: name.to_owned(),
            source: Box::new(source),
        })?;
        Ok(Rc::clone(self.found.entry(key).or_insert(Rc::new(suite))))
    }

    fn find(&self, name: &str, starts: Option<Starts>) -> Result<SelectedSuite, RunnerError> {
        let (mut words, splits) = if name == RECORDED {
            (self.recordings(), Vec::new())
        } else {
            (Vec::new(), vec![name.to_owned()])
        };
        if words.is_empty() && splits.is_empty() {
            return Err(no_recordings());
        }
        let Selected {
            mut sources,
            mut splits,
            missing,
        } = select(
            &words,
            &splits,
            &self.limit.map_or_else(Sample::default, Sample::limited),
            &self.readers,
            self.listener,
        )?;
        if self.request.quick {
            sources = Quick::DEFAULT.select(sources);
        }
        if self.request.quick || self.limit.is_some() {
            (words, splits) = (
                sources.iter().map(ToString::to_string).collect(),
                Vec::new(),
            );
        }
        if let Some(starts) = starts {
            sources = sources
                .iter()
                .flat_map(|source| from_every_start(source, starts))
                .collect();
            (words, splits) = (
                sources.iter().map(ToString::to_string).collect(),
                Vec::new(),
            );
        }
        let named = ScenarioList {
            words,
            splits,
            missing,
            ..ScenarioList::default()
        };
        let list = scenario_list(&sources, named, self.roots.clone())?;
        // A filter file goes by its name without the folder and the ending.
        let stem = Path::new(name)
            .file_stem()
            .map(|stem| stem.to_string_lossy().into_owned());
        let data = data_files(&sources, None);
        Ok(SelectedSuite {
            name: stem.unwrap_or_else(|| name.to_owned()),
            sources,
            list,
            data,
        })
    }

    /// The words that name recordings.
    fn recordings(&self) -> Vec<String> {
        if !self.request.scenarios.is_empty() {
            return self
                .request
                .scenarios
                .iter()
                .map(|word| self.readers.absolute_word(word))
                .collect();
        }
        let data = std::env::var_os(DATA)
            .filter(|folder| !folder.is_empty())
            .map(PathBuf::from);
        let folders = data
            .into_iter()
            .flat_map(|data| RECORDINGS.map(|folder| data.join(folder)));
        let words = folders
            .filter(|folder| folder.is_dir())
            .map(|folder| word_of(folder.as_os_str()));
        words.map(|word| absolute_path(&word)).collect()
    }
}

pub(super) fn no_recordings() -> RunnerError {
    RunnerError::NoRecordings {
        folders: RECORDINGS.join(", "),
        variable: DATA,
    }
}

/// A recording from each of its start times; a scenario whose length is not known before it is
/// opened, from its own.
fn from_every_start(source: &ScenarioRef, Starts { every_s, least_s }: Starts) -> Vec<ScenarioRef> {
    let steps = |seconds: f64| (seconds / STEP_S).round().max(1.0) as usize;
    let iterations = source
        .contents()
        .ok()
        .flatten()
        .map_or(0, |contents| contents.iterations);
    let last = iterations.saturating_sub(1 + steps(least_s));
    let later = (1..)
        .map(|i| i * steps(every_s))
        .take_while(|&start| start <= last);
    std::iter::once(source.clone())
        .chain(later.map(|start| source.clone().started_later(start)))
        .collect()
}
