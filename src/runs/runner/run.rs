//! One run: its folder, its tasks, and which of them are left.

use super::error::RunnerError;
use super::event::{Event, Listener};
use super::machine::cpu;
use super::probe;
use super::watch::while_in_place;
use crate::report::Failure;
use crate::report::{Manifest, RunFolder, Session, SimulationRow, Summary, Timing};
use crate::worker::FailedCall;
use crate::worker::run::{self, AgentParts, SimulationRecord, SimulationTask};
use planagent_scenario::MissingTokens;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

/// Kinds of failed simulations of which a run tells before its end.
const MAX_TOLD: usize = 10;

/// How a run is resumed.
#[derive(Debug, Clone, Copy, Default)]
pub struct Resume {
    /// Discard failed simulations, so that they are repeated.
    pub retry_failed: bool,
    /// Go on although inputs changed.
    pub accept_changes: bool,
}

/// What a run is made of, before it has a folder.
pub struct RunPlan {
    pub manifest: Manifest,
    /// The tasks of the run, those of other shards included.
    pub tasks: Vec<SimulationTask>,
    /// Places of the tasks that are simulated.
    pub numbers: Vec<usize>,
    pub agent: AgentParts,
    /// Time that the model took to load, seconds.
    pub load_s: Option<f64>,
}

impl RunPlan {
    /// Asks the server of its model, if it has one, what simulations will ask.
    pub(super) fn probe(&self, listener: &Listener) -> Result<(), RunnerError> {
        let bev = self.agent.settings.environment.bev;
        match &self.agent.model {
            Some(source) => probe::probe(source, bev, listener),
            None => Ok(()),
        }
    }
}

/// The results of a run whose simulations are all completed.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct RunResults {
    /// Its folder.
    pub folder: PathBuf,
    /// `summary.json`.
    pub summary: Summary,
    /// `timing.json`.
    pub timing: Timing,
    /// The simulations.
    pub rows: Vec<SimulationRow>,
    /// Scenarios that the splits name and the data does not hold.
    pub missing: Vec<MissingTokens>,
}

/// A run in its folder.
pub struct Run {
    plan: RunPlan,
    folder: RunFolder,
    /// Places in the tasks that are not completed.
    left: Vec<usize>,
    /// The completed simulations.
    rows: Vec<SimulationRow>,
    /// How many of them this session simulated.
    simulated: usize,
    /// How many failed ones were discarded to be repeated.
    pub(super) retried: usize,
    /// The causes of failed planning calls that were told: of each the first.
    told: Arc<Mutex<BTreeSet<&'static str>>>,
    /// The kinds of failed simulations that were told.
    told_failures: Mutex<BTreeSet<String>>,
}

impl Run {
    /// Starts a run in a new folder; without a name, in the next free `runs/NNNN`.
    #[doc(hidden)]
    pub fn create(path: Option<&Path>, plan: RunPlan) -> Result<Self, RunnerError> {
        let folder = RunFolder::create(path, &plan.manifest)?;
        let left = plan.numbers.clone();
        Ok(Self {
            plan,
            folder,
            left,
            rows: Vec::new(),
            simulated: 0,
            retried: 0,
            told: Arc::default(),
            told_failures: Mutex::default(),
        })
    }

    /// Resumes the run in a folder.
    #[doc(hidden)]
    pub fn resume(
        path: &Path,
        mut plan: RunPlan,
        how: Resume,
        listener: &Listener,
    ) -> Result<Self, RunnerError> {
        let recorded = RunFolder::manifest(path)?.inputs.is_some();
        let (folder, manifest, accepted) =
            RunFolder::resume(path, &plan.manifest, how.accept_changes)?;
        if !recorded {
            let text = "the run was started by a version that recorded no digests of prompts, model files and recordings; \
                        whether they changed is not known";
            listener(Event::Note(text.to_owned()));
        }
        for change in accepted {
            listener(Event::Note(format!("accepted: {change}")));
        }
        plan.manifest = manifest;
        let completed = folder.completed(&plan.tasks)?;
        // What a crash left half-written is simulated again, and the rest stays.
        for path in &completed.damaged {
            let text = format!(
                "the record or a result in {} is damaged; its simulation is repeated",
                path.display()
            );
            listener(Event::Note(text));
        }
        let (discarded, rows): (Vec<_>, Vec<_>) = completed
            .rows
            .into_iter()
            .partition(|row| how.retry_failed && row.error.is_some());
        folder.discard(&discarded.iter().map(|row| row.number).collect())?;
        let done: BTreeSet<usize> = rows.iter().map(|row| row.number).collect();
        let left: Vec<usize> = plan
            .numbers
            .iter()
            .copied()
            .filter(|number| !done.contains(number))
            .collect();
        if folder.has_summary()? {
            let known = discarded.len() + completed.damaged.len();
            let lost = left.len().saturating_sub(known);
            if lost > 0 {
                listener(Event::Note(format!(
                    "{lost} simulations of this run, which had ended, have no folder any more; they are repeated"
                )));
            }
        }
        Ok(Self {
            plan,
            folder,
            left,
            rows,
            simulated: 0,
            retried: discarded.len(),
            told: Arc::default(),
            told_failures: Mutex::default(),
        })
    }

    /// Numbers of the tasks that are not completed.
    #[doc(hidden)]
    pub fn left(&self) -> &[usize] {
        &self.left
    }

    /// How many tasks it simulates.
    #[doc(hidden)]
    pub fn total(&self) -> usize {
        self.plan.numbers.len()
    }

    /// Its folder.
    pub(super) fn path(&self) -> &Path {
        self.folder.path()
    }

    /// Whether one of its planners asks the model.
    pub(super) fn has_model(&self) -> bool {
        self.plan.manifest.model.is_some()
    }

    /// Whether a command is one of its planners, or controls its agents.
    pub(super) fn has_commands(&self) -> bool {
        let Manifest {
            commands, agents, ..
        } = &self.plan.manifest;
        !commands.is_empty() || !agents.is_empty()
    }

    /// The tasks of its first scenario that are left.
    #[doc(hidden)]
    pub fn first(&self) -> Vec<usize> {
        let source = |number: &usize| self.plan.tasks.get(*number).map(|task| &task.source);
        let first = self.left.first().and_then(source);
        self.left
            .iter()
            .copied()
            .take_while(|number| source(number) == first)
            .collect()
    }

    /// Mean wall time of the completed simulations; none before the first.
    #[doc(hidden)]
    pub fn seconds_per_simulation(&self) -> Option<f64> {
        let seconds: f64 = self
            .rows
            .iter()
            .map(|row| row.time.ended_s - row.time.started_s)
            .sum();
        (!self.rows.is_empty()).then(|| seconds / self.rows.len() as f64)
    }

    /// Asks the server of its model what the simulations that are left will ask.
    #[doc(hidden)]
    pub fn probe(&self, listener: &Listener) -> Result<(), RunnerError> {
        if self.left.is_empty() {
            return Ok(());
        }
        self.plan.probe(listener)
    }

    /// Tells of a simulation that failed as none did before. So does the end of the run, which may
    /// be hours away.
    fn tell_failure(&self, record: &SimulationRecord, listener: &Listener) {
        let Some(failure) = Failure::from_record(record) else {
            return;
        };
        let mut told = self
            .told_failures
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        if told.len() < MAX_TOLD && told.insert(failure.kind) {
            listener(Event::SimulationFailed {
                failure: failure.line,
            });
        }
    }

    /// Simulates some of the tasks that are left, and writes each as it ends.
    #[doc(hidden)]
    pub fn simulate(&mut self, numbers: &[usize], listener: &Listener) -> Result<(), RunnerError> {
        let folder = &self.folder;
        let users = self.plan.agent.stop.clone().unwrap_or_default();
        let stop = users.part();
        let (told, hearing) = (Arc::clone(&self.told), Arc::clone(listener));
        let on_failed_call = move |call: FailedCall| {
            let is_first = told
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .insert(call.cause);
            if is_first {
                hearing(Event::CallFailed(call));
            }
        };
        let agent = AgentParts {
            stop: Some(stop.clone()),
            on_failed_call: Some(Arc::new(on_failed_call)),
            ..self.plan.agent.clone()
        };
        let ended = AtomicUsize::new(0);
        let stopped = || RunnerError::Stopped {
            folder: folder.path().to_owned(),
        };
        while_in_place(folder, &stop, || {
            run::run(
                &self.plan.tasks,
                numbers,
                &agent,
                &|_| listener(Event::Stepped),
                &|number, record| {
                    // A simulation that was cut short is none.
                    if stop.is_stopped() && record.outcome.is_err() {
                        folder.check_in_place()?;
                        return Err(stopped());
                    }
                    folder.commit(number, &record)?;
                    if ended.fetch_add(1, Ordering::Relaxed) + 1 < self.left.len() {
                        self.tell_failure(&record, listener);
                    }
                    listener(Event::Ended {
                        failed: record.outcome.is_err(),
                    });
                    if stop.is_stopped() {
                        Err(stopped())
                    } else {
                        Ok(())
                    }
                },
            )
        })?;
        self.left.retain(|number| !numbers.contains(number));
        self.simulated += numbers.len();
        self.rows = folder.completed(&self.plan.tasks)?.rows;
        Ok(())
    }

    /// Writes the results of a run whose simulations are all completed, and unlocks its folder.
    #[doc(hidden)]
    pub fn finish(self, started: Instant) -> Result<RunResults, RunnerError> {
        let Self {
            plan,
            folder,
            rows,
            simulated,
            ..
        } = self;
        let (total, path) = (plan.numbers.len(), folder.path().to_owned());
        if rows.len() != total {
            return Err(RunnerError::Unrecorded {
                missing: total - rows.len(),
                total,
                folder: path,
            });
        }
        finish(
            &folder,
            plan.manifest,
            session(started, simulated, plan.load_s),
            rows,
        )
    }
}

/// Writes the results of a run whose simulations are all completed.
pub(super) fn finish(
    folder: &RunFolder,
    manifest: Manifest,
    session: Session,
    rows: Vec<SimulationRow>,
) -> Result<RunResults, RunnerError> {
    let path = folder.path().to_owned();
    // Read from the manifest: a merged or resumed run has no configuration of its own here.
    let seed = manifest.config.get("seed");
    let seed = seed
        .and_then(toml::Value::as_integer)
        .and_then(|seed| u64::try_from(seed).ok())
        .ok_or_else(|| RunnerError::ManifestSeed {
            folder: path.clone(),
            found: seed.map_or_else(|| "absent".to_owned(), ToString::to_string),
        })?;
    let model = manifest
        .model
        .clone()
        .map(toml::Table::try_into)
        .transpose();
    let model = model.map_err(|source| RunnerError::ManifestModel {
        folder: path.clone(),
        source,
    })?;
    let summary = Summary::new(seed, model, &manifest.scenarios.missing, &rows);
    let timing = Timing::new(session, &rows);
    folder.finish(&manifest, &summary, &timing, &rows)?;
    Ok(RunResults {
        folder: path,
        summary,
        timing,
        rows,
        missing: manifest.scenarios.missing,
    })
}

/// This machine, and what this session simulated since it `started`.
pub(super) fn session(started: Instant, simulations: usize, load_s: Option<f64>) -> Session {
    let (threads, wall_s) = (
        rayon::current_num_threads(),
        started.elapsed().as_secs_f64(),
    );
    Session {
        cpu: cpu(),
        threads,
        wall_s,
        simulations,
        load_s,
    }
}
