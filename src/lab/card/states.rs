//! The states of a card, and what a model answers at them. A search drives to them, so that every
//! model is asked at the same ones: one in each generated scene of test seeds.

use super::error::CardError;
use super::questions::Questions;
use super::state_record::StateRecord;
use crate::dataset::{Settings, scenarios, walk};
use crate::report::Records;
use crate::study_runs::answers_folder;
use planagent_agent::environment::BevView;
use planagent_planners::all_planners;
use planagent_runs::runner::model::agent_parts;
use planagent_runs::runner::{Config, Event, Listener, LoadedModel, RunnerError};
use planagent_runs::worker::seeds::Split;
use planagent_scenario::generator::Spec;
use rayon::prelude::*;
use std::cell::Cell;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

/// Name of the folder, and of the file in it.
const STATES: &str = "states";
const FILE: &str = "states.jsonl";
/// Share of the scenes that one of interPlan's kinds modifies, so that lane changes are needed.
const MODIFIED: f64 = 0.5;
/// The state of a scene is one of its first so many, in turn.
const STATES_IN_TURN: u64 = 6;

/// The states that were asked at.
#[derive(Debug, Default)]
pub(super) struct AskedStates {
    pub(super) records: Vec<StateRecord>,
    /// States at which the model gave no answer in time, or failed; they do not count.
    pub(super) unanswered: usize,
}

/// Asks a model at so many states; those that it answered before stay. `on_time` hears early on how
/// long a state takes on one thread, if many are left.
pub(super) fn ask(
    wanted: usize,
    loaded: &LoadedModel,
    config: &Config,
    runs: &Path,
    (listener, on_time): (&Listener, &dyn Fn(Duration)),
) -> Result<AskedStates, RunnerError> {
    let (_, prompts, _) = loaded
        .parts()
        .ok_or(CardError::Twin(crate::twins::TwinError::NoModel))?;
    let view = BevView::new(BevView::default().pixels(), config.environment.view_m)
        .map_err(CardError::from)?;
    let settings = Settings {
        seed: config.seed,
        prompts,
        view,
        driver: None,
        modified: MODIFIED,
    };
    let parts = agent_parts(config, all_planners(), Some(loaded));
    let questions = Questions::new(&parts, loaded.about.image_size.is_some());
    // The digest of these words names the folder: other questions have other answers.
    let words = [
        format!("{} states of seed {}", Split::Test.as_str(), config.seed),
        questions.in_words(),
    ];
    let (folder, _) = answers_folder(runs, STATES, &words, loaded, config)?;
    let (records, known) = Records::<StateRecord>::open(&folder, FILE)?;
    let states = States {
        settings: &settings,
        questions: &questions,
        records: &records,
    };
    states.ask(wanted, known, listener, on_time)
}

/// What is asked, and where it is kept.
struct States<'a> {
    settings: &'a Settings<'a>,
    questions: &'a Questions,
    records: &'a Records<StateRecord>,
}

/// What became of a scene.
enum Visited {
    Asked(Box<StateRecord>),
    Unanswered,
    /// It has no such state.
    None,
}

impl States<'_> {
    fn ask(
        &self,
        wanted: usize,
        known: Vec<StateRecord>,
        listener: &Listener,
        on_time: &dyn Fn(Duration),
    ) -> Result<AskedStates, RunnerError> {
        let known: BTreeMap<String, StateRecord> = known
            .into_iter()
            .map(|record| (record.scene.clone(), record))
            .collect();
        let mut asked = AskedStates::default();
        let done = AtomicUsize::new(0);
        let (mut shard, mut left, mut is_timed) = (0, Vec::new(), false);
        // A server that answers nowhere would be asked without end.
        while asked.records.len() < wanted && asked.unanswered <= wanted {
            if left.is_empty() {
                let specs = scenarios(Split::Test, shard, self.settings);
                left = specs.map_err(CardError::from)?;
                left.reverse();
                shard += 1;
            }
            // A few first, for the estimate of the time.
            let first = if is_timed {
                usize::MAX
            } else {
                2 * rayon::current_num_threads()
            };
            let count = (wanted - asked.records.len()).min(left.len()).min(first);
            let specs = left.split_off(left.len() - count);
            let started = Instant::now();
            let visit = |spec: &Spec| -> Result<(Visited, bool), RunnerError> {
                let scene = spec.to_string();
                if let Some(record) = known.get(&scene) {
                    return Ok((Visited::Asked(Box::new(record.clone())), false));
                }
                let visited = self.visit(spec, &scene)?;
                let done = done.fetch_add(1, Ordering::Relaxed) + 1;
                let total = wanted.max(done + 1);
                listener(Event::ScenesCounted { done, total });
                Ok((visited, true))
            };
            let visited = specs.par_iter().rev().map(visit);
            let visited = visited.collect::<Result<Vec<_>, _>>()?;
            let new = visited.iter().filter(|(_, is_new)| *is_new).count();
            if let Some(time) = per_item(started.elapsed(), new).filter(|_| !is_timed) {
                is_timed = true;
                on_time(time);
            }
            for (one, _) in visited {
                match one {
                    Visited::Asked(record) => asked.records.push(*record),
                    Visited::Unanswered => asked.unanswered += 1,
                    Visited::None => {}
                }
            }
        }
        let end = done.load(Ordering::Relaxed);
        listener(Event::ScenesCounted {
            done: end,
            total: end,
        });
        Ok(asked)
    }

    /// Drives to the state of a scene and asks there.
    fn visit(&self, spec: &Spec, scene: &str) -> Result<Visited, RunnerError> {
        let place = spec.seed % STATES_IN_TURN;
        let next = Cell::new(0);
        let visited = walk(spec, self.settings, &|visited, _| {
            let is_own = next.replace(next.get() + 1) == place;
            Ok(is_own.then(|| self.questions.ask(visited, scene)))
        });
        let visited = visited.map_err(CardError::from)?;
        match visited.into_iter().flatten().next().transpose()? {
            None => Ok(Visited::None),
            Some(None) => Ok(Visited::Unanswered),
            Some(Some(record)) => {
                self.records.add(&record)?;
                Ok(Visited::Asked(Box::new(record.as_read()?)))
            }
        }
    }
}

/// Time of one of several items that all threads of the current pool worked on.
fn per_item(time: Duration, items: usize) -> Option<Duration> {
    let threads = rayon::current_num_threads().min(items);
    (items > 0).then(|| time.mul_f64(threads as f64 / items as f64))
}
