//! Fills the memories of language agents from training scenarios, in the order of the scenarios: no
//! drive sees what another one leaves, so that the memory does not depend on threads.

use super::dataset::training_scenarios;
use planagent_agent::planner::{AskedModel, CodeSource, PlannerError};
use planagent_agent::simulation::{Challenge, SimulationLog};
use planagent_language_agents::{
    DiluItem, Drive, ExperienceItem, Memory, experience, lesson_items,
};
use planagent_runs::worker::run::{AgentParts, SimulationRecord, SimulationTask, run, with_causes};
use planagent_scenario::{Scenario, ScenarioRef};
use planagent_world::{EgoState, HISTORY_SAMPLES, History, HistorySample};
use rayon::prelude::*;
use std::convert::Infallible;
use std::sync::{Mutex, PoisonError};

/// Frames between two experiences: half a second.
const EVERY: usize = 5;
/// Length of an experience, frames.
const FUTURE: usize = 30;

/// A memory, and what was left out with the reasons.
#[derive(Debug)]
pub struct Filled<T> {
    /// The memory.
    pub memory: Memory<T>,
    /// A line for each scenario that left nothing.
    pub notes: Vec<String>,
}

/// What a memory is filled from.
#[derive(Debug, Clone, Copy)]
pub struct Training {
    /// Seed: other seeds give other scenarios.
    pub seed: u64,
    /// Number of scenarios.
    pub scenarios: usize,
}

impl Training {
    fn sources(self) -> Vec<ScenarioRef> {
        training_scenarios(self.seed, self.scenarios)
    }

    fn words(self) -> String {
        let Self { seed, scenarios } = self;
        format!("{scenarios} generated scenarios of training seeds, seed {seed}")
    }
}

/// The memory of Agent-Driver: logged motions every half second.
pub fn fill_experiences(training: Training) -> Filled<ExperienceItem> {
    let of_scenario = |source: &ScenarioRef| match source.open() {
        Ok(log) => (experiences(&log), None),
        Err(error) => (
            Vec::new(),
            Some(format!("{source}: {}", with_causes(&error))),
        ),
    };
    let found: Vec<_> = training.sources().par_iter().map(of_scenario).collect();
    let (items, notes): (Vec<_>, Vec<_>) = found.into_iter().unzip();
    let items = items.into_iter().flatten().collect();
    Filled {
        memory: Memory::new("agent-driver", training.words(), items),
        notes: notes.into_iter().flatten().collect(),
    }
}

fn experiences(log: &Scenario) -> Vec<ExperienceItem> {
    let egos: Vec<EgoState> = log
        .frames
        .iter()
        .map(|frame| frame.ego)
        .chain(log.future.iter().copied())
        .collect();
    let at = |now: usize| {
        let frame = log.frames.get(now)?;
        let mut history = History::default();
        for past in log
            .frames
            .get((now + 1).saturating_sub(HISTORY_SAMPLES)..=now)?
        {
            history.push(HistorySample {
                ego: past.ego,
                objects: past.objects.clone(),
            });
        }
        let future = egos.get(now + 1..=now + FUTURE)?;
        experience(&log.id, &log.scene(frame, &history), future)
    };
    (log.start..log.frames.len())
        .step_by(EVERY)
        .filter_map(at)
        .collect()
}

/// The memory of `DiLu`: decisions of its drives, and lessons of its accidents. `parts` have its
/// model and settings; the memory that they name is read in all drives and stays as it is.
///
/// # Errors
/// When the model cannot be asked.
pub fn fill_decisions(
    training: Training,
    parts: &AgentParts,
    on_drive: &(dyn Fn() + Sync),
) -> Result<Filled<DiluItem>, PlannerError> {
    let planner = parts
        .registry
        .find("dilu")
        .map_err(|error| PlannerError::Failed {
            doing: "finding the planner",
            source: Box::new(error),
        })?
        .name;
    let Some(CodeSource::Model {
        model,
        prompts,
        reasoning,
    }) = parts.model.clone()
    else {
        return Err(PlannerError::MissingPart {
            planner,
            part: "a language model",
        });
    };
    let asked = AskedModel {
        model,
        prompts,
        reasoning,
    };
    let tasks: Vec<SimulationTask> = training
        .sources()
        .into_iter()
        .map(|source| SimulationTask {
            source,
            planner,
            challenge: Challenge::NonReactive,
        })
        .collect();
    let max_tokens = parts.settings.language_agents.dilu.max_tokens;
    let (mut items, mut notes) = (Vec::new(), Vec::new());
    for record in driven(&tasks, parts, on_drive) {
        let outcome = match record.outcome {
            Ok(outcome) => outcome,
            Err(why) => {
                notes.push(format!("{}: {why}", record.scenario));
                continue;
            }
        };
        let drive = Drive::new(&outcome.calls, collision(&outcome.log));
        // Each lesson has draws of its own, and they are the same in every run.
        let seed = parts.settings.seed ^ items.len() as u64;
        match lesson_items(&record.scenario, &drive, &asked, max_tokens, seed)? {
            Ok(left) => items.extend(left),
            Err(why) => notes.push(format!("{}: {why}", record.scenario)),
        }
    }
    Ok(Filled {
        memory: Memory::new("dilu", training.words(), items),
        notes,
    })
}

/// The records of the drives, in the order of the scenarios.
fn driven(
    tasks: &[SimulationTask],
    parts: &AgentParts,
    on_drive: &(dyn Fn() + Sync),
) -> Vec<SimulationRecord> {
    let numbers: Vec<usize> = (0..tasks.len()).collect();
    let records = Mutex::new(Vec::new());
    let keep = |number: usize, record: SimulationRecord| {
        let mut records = records.lock().unwrap_or_else(PoisonError::into_inner);
        records.push((number, record));
        on_drive();
        Ok::<(), Infallible>(())
    };
    match run(tasks, &numbers, parts, &|_| {}, &keep) {
        Ok(()) => {}
        Err(never) => match never {},
    }
    let mut records = records.into_inner().unwrap_or_else(PoisonError::into_inner);
    records.sort_by_key(|(number, _)| *number);
    records.into_iter().map(|(_, record)| record).collect()
}

/// The iteration at which the ego first touches something.
fn collision(log: &SimulationLog) -> Option<usize> {
    log.samples.iter().position(|sample| {
        let own = sample.ego.footprint();
        sample
            .objects
            .iter()
            .any(|object| object.shape.overlaps(&own))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn experiences_are_the_logged_motions_of_training_seeds_in_order() {
        let training = Training {
            seed: 0,
            scenarios: 2,
        };
        let Filled { memory, notes } = fill_experiences(training);
        assert!(notes.is_empty(), "{notes:?}");
        assert!(memory.items.len() > 40, "{}", memory.items.len());
        let first = &memory.items[0];
        assert!(first.source.contains("10000000"), "{}", first.source);
        assert!(first.text.contains("Goal: ") && first.goal.chars().all(char::is_uppercase));
        // What followed goes on from the motion.
        let step = first.motion[1];
        assert!((first.future[0][1] - step).abs() < 1.0, "{first:?}");
        assert_eq!(fill_experiences(training).memory, memory);
    }
}
