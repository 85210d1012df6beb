//! The runs of studies, and what their comparison gives.

mod request;
mod runs;
mod suites;
mod tokens;
mod twins;

pub use request::StudiesRequest;
pub use tokens::{SuiteTokens, TITLE as TOKENS_TITLE};
pub(crate) use twins::{answers_folder, judge as judge_twins};

use crate::report::{
    BenchFigures, BenchFolder, ModelFigures, Outcome, RESULTS, RESULTS_MARK, StudyFolder,
    StudyResults, SuiteSimulations, VariantSimulations,
};
use crate::study::{Quick, Study, StudyError, find, names};
use crate::twins::{TwinError, TwinResults};
use planagent_files::quoted;
use planagent_runs::report::{SimulationRow, check_writable};
use planagent_runs::runner::Config;
use planagent_runs::runner::RunnerError;
use planagent_runs::runner::{Event, Listener};
use planagent_scenario::MissingTokens;
use runs::{PlannedRuns, RunName};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::rc::Rc;
use std::time::Instant;
use suites::{SelectedSuite, Suites};

/// Name of the study that counts tokens and simulates nothing.
pub const TOKENS: &str = "tokens";
/// Name of the study that asks the model in text twins.
pub const TWINS: &str = "twins";
/// Folder of the runs, beside those of the results.
const RUNS: &str = "runs";

/// A session of studies, which share their suites and runs.
pub struct Studies<'a> {
    request: &'a StudiesRequest,
    config: &'a Config,
    listener: &'a Listener,
    suites: Suites<'a>,
}

/// What studies came to.
#[derive(Debug, Clone, PartialEq)]
pub struct StudyOutcome {
    /// The studies with their results and the folders of these.
    pub studies: Vec<(Study, StudyResults, PathBuf)>,
    /// The simulations that failed.
    pub failed: Vec<SimulationRow>,
    /// Planning calls without an answer.
    pub failed_calls: usize,
    /// Simulations with planning calls of which none gave a plan.
    pub without_plan: usize,
    /// Scenarios that the suites name and the data does not hold.
    pub missing: Vec<MissingTokens>,
}

/// A study with its suites, and for each of them the names of its variants' runs.
struct Planned {
    study: Study,
    suites: Vec<(Rc<SelectedSuite>, Vec<RunName>)>,
}

impl<'a> Studies<'a> {
    /// Starts a session.
    pub fn new(
        request: &'a StudiesRequest,
        config: &'a Config,
        listener: &'a Listener,
    ) -> Result<Self, RunnerError> {
        Ok(Self {
            request,
            config,
            listener,
            suites: Suites::new(request, listener)?,
        })
    }

    /// Counts the tokens of scene descriptions and writes the results; gives the folder of these.
    pub fn count_tokens(&mut self) -> Result<(Vec<SuiteTokens>, PathBuf), RunnerError> {
        self.check_folder(TOKENS)?;
        let suites = self.suites.select(TOKENS, tokens::SUITES, None)?;
        self.suites.note_lacking();
        let counted = tokens::count_all(&suites, self.config, self.listener)?;
        let folder = StudyFolder::new(self.folder(TOKENS));
        tokens::write(&folder, &counted, &self.command(TOKENS)?)?;
        Ok((counted, folder.path().to_owned()))
    }

    /// Asks the model in the text twins that are left, and writes the results; gives the folder of
    /// these.
    pub fn ask_twins(&mut self) -> Result<(Vec<TwinResults>, PathBuf), RunnerError> {
        let (runs, folder) = (
            self.request.out.join(RUNS),
            StudyFolder::new(self.folder(TWINS)),
        );
        check_writable(&runs)?;
        self.check_folder(TWINS)?;
        let lists = twins::lists(self.request)?;
        let results = lists
            .iter()
            .map(|list| twins::judge(list, self.config, &runs, self.listener));
        let results = results.collect::<Result<Vec<_>, _>>()?;
        twins::write(&folder, &results, &self.command(TWINS)?)?;
        Ok((results, folder.path().to_owned()))
    }

    /// Simulates what is left of the studies' runs, and writes the results. A word is the name of a
    /// study or the path of its file.
    pub fn simulate<'w>(
        &mut self,
        words: impl IntoIterator<Item = &'w str>,
    ) -> Result<StudyOutcome, RunnerError> {
        let started = Instant::now();
        let studies = words.into_iter().map(find).collect::<Result<Vec<_>, _>>()?;
        studies.iter().try_for_each(check_name)?;
        let bench = self.bench()?;
        // Planning loads the models, which takes long: what is wrong with a folder is said before.
        check_writable(&self.request.out.join(RUNS))?;
        studies
            .iter()
            .try_for_each(|study| self.check_folder(&study.name))?;
        let (planned, runs) = self.plan(studies)?;
        let parameters = runs.parameters();
        let rows = self.complete(runs, started)?;

        let mut results = Vec::new();
        let mut missing: Vec<MissingTokens> = Vec::new();
        for Planned { study, suites } in planned {
            for list in suites.iter().flat_map(|(suite, _)| &suite.list.missing) {
                if !missing.contains(list) {
                    missing.push(list.clone());
                }
            }
            let simulated: Vec<SuiteSimulations> = suites
                .iter()
                .map(|(suite, names)| simulations(suite, names, &rows, &parameters))
                .collect();
            let quick = self.request.quick.then_some(Quick::DEFAULT);
            let of_study = StudyResults::new(&study, &simulated, quick, self.config.seed, &bench);
            let folder = StudyFolder::new(self.folder(&study.name));
            folder.write(&study, &of_study, &self.command(&study.word)?)?;
            results.push((study, of_study, folder.path().to_owned()));
        }
        let all = || rows.values().flatten();
        Ok(StudyOutcome {
            studies: results,
            failed: all().filter(|row| row.error.is_some()).cloned().collect(),
            failed_calls: all().map(|row| row.failed_calls).sum(),
            without_plan: all().filter(|row| row.is_without_plan()).count(),
            missing,
        })
    }

    /// The runs of studies on their suites.
    fn plan(
        &mut self,
        studies: Vec<Study>,
    ) -> Result<(Vec<Planned>, PlannedRuns<'a>), RunnerError> {
        let mut runs = PlannedRuns::new(self.config, &self.request.registry, self.listener);
        studies.iter().try_for_each(|study| runs.check(study))?;
        let mut planned = Vec::new();
        for study in studies {
            let mut suites = Vec::new();
            for suite in self
                .suites
                .select(&study.name, &study.suites, study.starts)?
            {
                let names = study
                    .variants
                    .iter()
                    .map(|variant| runs.add(&suite, variant));
                let names = names.collect::<Result<_, RunnerError>>()?;
                suites.push((suite, names));
            }
            planned.push(Planned { study, suites });
        }
        if planned.iter().all(|planned| planned.suites.is_empty()) {
            return Err(suites::no_recordings());
        }
        self.suites.note_lacking();
        Ok((planned, runs))
    }

    /// Simulates what is left of runs; gives the simulations of each.
    fn complete(
        &self,
        runs: PlannedRuns<'a>,
        started: Instant,
    ) -> Result<BTreeMap<String, Vec<SimulationRow>>, RunnerError> {
        let mut open = runs.open(&self.request.out.join(RUNS), self.request.retry_failed)?;
        let (runs, completed, left) = open.counts();
        (self.listener)(Event::Planned {
            runs,
            completed,
            left,
        });
        if left > 0 {
            open.probe()?;
            open.simulate_first()?;
            let left = open.counts().2;
            if left > 0 {
                (self.listener)(Event::Estimated {
                    left,
                    time: open.time_left(),
                });
            }
        }
        open.complete(started)
    }

    /// Simulates what is left of the runs of a study that no file names, and writes no results of
    /// it; gives the simulations of its suites.
    pub(crate) fn simulate_variants(
        &mut self,
        study: Study,
    ) -> Result<Vec<SuiteSimulations>, RunnerError> {
        let started = Instant::now();
        check_writable(&self.request.out.join(RUNS))?;
        let (planned, runs) = self.plan(vec![study])?;
        let parameters = runs.parameters();
        let rows = self.complete(runs, started)?;
        let suites = planned.iter().flat_map(|planned| &planned.suites);
        Ok(suites
            .map(|(suite, names)| simulations(suite, names, &rows, &parameters))
            .collect())
    }

    /// The models of the bench that is named.
    fn bench(&self) -> Result<Vec<ModelFigures>, RunnerError> {
        let Some(path) = &self.request.bench else {
            return Ok(Vec::new());
        };
        let figures = BenchFigures::from_rows(&BenchFolder::read(path)?);
        if figures.models.is_empty() {
            return Err(RunnerError::EmptyBench(path.clone()));
        }
        Ok(figures.models)
    }

    /// Refuses a folder that takes no files, or in which files of others would be lost.
    fn check_folder(&self, name: &str) -> Result<(), RunnerError> {
        Ok(StudyFolder::new(self.folder(name)).check(RESULTS, RESULTS_MARK)?)
    }

    /// The folder of a study's results.
    fn folder(&self, name: &str) -> PathBuf {
        self.request
            .out
            .join(match (self.request.quick, self.request.limit) {
                (true, _) => format!("{name}-quick"),
                (false, Some(limit)) => format!("{name}-limit-{limit}"),
                (false, None) => name.to_owned(),
            })
    }

    /// The command that makes the results of a study. Settings of files and of options are those of
    /// `--set`.
    fn command(&self, name: &str) -> Result<String, RunnerError> {
        let mut words = vec!["planagent study".to_owned(), name.to_owned()];
        words.extend(self.request.quick.then(|| "--quick".to_owned()));
        words.extend(self.request.limit.map(|limit| format!("--limit {limit}")));
        if !self.request.suites.is_empty() {
            words.push(format!("--suite {}", self.request.suites.join(",")));
        }
        if !self.request.scenarios.is_empty() {
            let scenarios = self
                .request
                .scenarios
                .iter()
                .map(|word| quoted(word))
                .collect::<Vec<_>>();
            words.push(format!("--scenario {}", scenarios.join(" ")));
        }
        for (key, value) in self.config.changes()? {
            let value = value
                .as_str()
                .map_or_else(|| value.to_string(), str::to_owned);
            words.push(format!("--set {}", quoted(&format!("{key}={value}"))));
        }
        Ok(words.join(" "))
    }
}

/// Refuses a study of a file whose results would replace those of a built-in study, or lie among the
/// runs.
fn check_name(study: &Study) -> Result<(), StudyError> {
    let base = study.name.trim_end_matches(|c: char| c.is_ascii_digit());
    let base = [
        base.strip_suffix("-limit-"),
        study.name.strip_suffix("-quick"),
    ];
    let base = base.into_iter().flatten().next().unwrap_or(&study.name);
    let is_taken = names().chain([TOKENS, TWINS, RUNS]).any(|own| own == base);
    if !is_taken || study.word == study.name {
        return Ok(());
    }
    Err(StudyError::Value {
        place: study.word.clone(),
        fault: format!(
            "name is {:?}, the folder of other results of the program; choose another",
            study.name
        ),
    })
}

/// The simulations of a suite, variant by variant.
fn simulations(
    suite: &SelectedSuite,
    names: &[RunName],
    rows: &BTreeMap<String, Vec<SimulationRow>>,
    parameters: &BTreeMap<String, u64>,
) -> SuiteSimulations {
    let variant = |name: &RunName| match name {
        Ok(name) => {
            let rows = rows
                .get(name)
                .cloned()
                .expect("every run of the plan has ended");
            let outcome = Outcome::Simulated {
                // Relative, so that the results can be moved together with their runs.
                run: format!("../{RUNS}/{name}"),
                rows,
            };
            VariantSimulations {
                outcome,
                parameters: parameters.get(name).copied(),
            }
        }
        Err(why) => VariantSimulations {
            outcome: Outcome::NotSimulated(why),
            parameters: None,
        },
    };
    SuiteSimulations {
        name: suite.name.clone(),
        scenes: suite.sources.len(),
        blake3: suite.list.blake3.clone(),
        variants: names.iter().map(variant).collect(),
    }
}

impl From<StudyError> for RunnerError {
    fn from(error: StudyError) -> Self {
        Self::Lab(Box::new(error))
    }
}

impl From<TwinError> for RunnerError {
    fn from(error: TwinError) -> Self {
        Self::Lab(Box::new(error))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_study_of_a_file_has_no_folder_of_the_programs() {
        let mut study = find("controls").unwrap();
        check_name(&study).unwrap();
        study.word = "mine.toml".to_owned();
        for taken in [
            "controls",
            "main",
            "main-quick",
            "main-limit-12",
            "tokens",
            "twins",
            "runs",
        ] {
            study.name = taken.to_owned();
            let error = check_name(&study).unwrap_err().to_string();
            assert!(
                error.contains("mine.toml") && error.contains(taken),
                "{error}"
            );
        }
        for free in ["mine", "main-2", "limit-3", "mine-quick"] {
            study.name = free.to_owned();
            check_name(&study).unwrap();
        }
    }
}
