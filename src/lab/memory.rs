//! Fills the memories of language agents from training scenarios, in the order of the scenarios: no
//! drive sees what another one leaves, so that the memory does not depend on threads.

use super::dataset::training_scenarios;
use planagent_agent::planner::{AskedModel, CodeSource, PlannerError};
use planagent_agent::simulation::{Challenge, SimulationLog};
use planagent_language_agents::{LeftDrive, Memory, fillers};
pub use planagent_language_agents::{MemoryFiller, MemorySource};
use planagent_runs::worker::run::{AgentParts, SimulationRecord, SimulationTask, run, with_causes};
use planagent_scenario::{Scenario, ScenarioRef};
use planagent_world::{EgoState, HISTORY_SAMPLES, History, HistorySample, SceneView};
use rayon::prelude::*;
use serde_json::Value;
use std::convert::Infallible;
use std::sync::{Mutex, PoisonError};

/// A memory, and what was left out with the reasons.
#[derive(Debug)]
pub struct Filled {
    /// The memory.
    pub memory: Memory<Value>,
    /// A line for each scenario that left nothing.
    pub notes: Vec<String>,
}

/// The agents with a memory, in the order of the registry.
pub fn agents() -> Vec<MemoryFiller> {
    fillers().collect()
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

/// How an item is made of a scene of a scenario and the ego's next states.
type Item = fn(&str, &SceneView<'_>, &[EgoState]) -> Option<Value>;

/// Instants of a log that are kept.
#[derive(Clone, Copy)]
struct Instants {
    /// Frames between two.
    every: usize,
    /// Length of what follows one, frames.
    future: usize,
    item: Item,
}

/// The memory of an agent that no model fills: what logs leave. `None` for an agent whose drives fill
/// it.
pub fn fill_from_logs(filler: &MemoryFiller, training: Training) -> Option<Filled> {
    let MemorySource::Logs {
        every,
        future,
        item,
    } = filler.source
    else {
        return None;
    };
    let instants = Instants {
        every,
        future,
        item,
    };
    let of_scenario = |source: &ScenarioRef| match source.open() {
        Ok(log) => (instants.items(&log), None),
        Err(error) => (
            Vec::new(),
            Some(format!("{source}: {}", with_causes(&error))),
        ),
    };
    let found: Vec<_> = training.sources().par_iter().map(of_scenario).collect();
    let (items, notes): (Vec<_>, Vec<_>) = found.into_iter().unzip();
    let items = items.into_iter().flatten().collect();
    Some(Filled {
        memory: Memory::new(filler.keys.planner, training.words(), items),
        notes: notes.into_iter().flatten().collect(),
    })
}

impl Instants {
    /// The items of a log.
    fn items(self, log: &Scenario) -> Vec<Value> {
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
            let future = egos.get(now + 1..=now + self.future)?;
            (self.item)(&log.id, &log.scene(frame, &history), future)
        };
        (log.start..log.frames.len())
            .step_by(self.every)
            .filter_map(at)
            .collect()
    }
}

/// The memory of an agent that its drives fill. `parts` have its model and settings; the memory that
/// they name is read in all drives and stays as it is. `None` for an agent whose memory logs fill.
///
/// # Errors
/// When the model cannot be asked.
pub fn fill_from_drives(
    filler: &MemoryFiller,
    training: Training,
    parts: &AgentParts,
    on_drive: &(dyn Fn() + Sync),
) -> Result<Option<Filled>, PlannerError> {
    let MemorySource::Drives(left) = filler.source else {
        return Ok(None);
    };
    let name = filler.keys.planner;
    let found = parts.registry.find(name);
    let planner = found
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
    let settings = parts.settings.language_agents.agent(name);
    let (mut items, mut notes) = (Vec::new(), Vec::new());
    for record in driven(&tasks, parts, on_drive) {
        let outcome = match record.outcome {
            Ok(outcome) => outcome,
            Err(why) => {
                notes.push(format!("{}: {why}", record.scenario));
                continue;
            }
        };
        let drive = LeftDrive {
            scenario: &record.scenario,
            calls: &outcome.calls,
            collided_at: collision(&outcome.log),
            asked: &asked,
            settings: &settings,
            // Each lesson has draws of its own, and they are the same in every run.
            seed: parts.settings.seed ^ items.len() as u64,
        };
        match left(&drive)? {
            Ok(left) => items.extend(left),
            Err(why) => notes.push(format!("{}: {why}", record.scenario)),
        }
    }
    Ok(Some(Filled {
        memory: Memory::new(name, training.words(), items),
        notes,
    }))
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
    fn motions_are_those_of_training_seeds_in_order_with_what_followed() {
        let training = Training {
            seed: 0,
            scenarios: 2,
        };
        let fillers = agents();
        let mut filled = fillers
            .iter()
            .filter_map(|filler| fill_from_logs(filler, training));
        let Filled { memory, notes } = filled.next().unwrap();
        assert!(
            filled.next().is_none(),
            "the other agents' drives fill theirs"
        );
        assert!(notes.is_empty(), "{notes:?}");
        assert!(memory.items.len() > 40, "{}", memory.items.len());
        let first = &memory.items[0];
        let text = |key: &str| first[key].as_str().unwrap();
        assert!(text("source").contains("10000000"), "{first}");
        assert!(text("text").contains("Goal: ") && text("goal").chars().all(char::is_uppercase));
        // What followed goes on from the motion.
        let step = first["motion"][1].as_f64().unwrap();
        let ahead = first["future"][0][1].as_f64().unwrap();
        assert!((ahead - step).abs() < 1.0, "{first}");
        let again = fillers
            .iter()
            .find_map(|filler| fill_from_logs(filler, training));
        assert_eq!(again.unwrap().memory, memory);
    }
}
