//! Labeled states for training. A noisy search or a model controls the ego in generated scenarios, and the search labels each
//! state with the best planner.
//!
//! The seeds of training, validation and test are disjoint (see [`Split`]).

#[cfg(feature = "learned")]
pub mod imitation;
mod label;
mod label_weights;
pub mod search;
mod shard;

pub use label::LabeledState;
pub use shard::{FORMAT, Meta, ShardError};

use super::run::AgentParts;
use crate::environment::{BevError, BevView, LaneGraph, SceneFacts, TextForm, bev};
use crate::pdm::PdmMemory;
use crate::planner::{AgentLayer, Attempt, Planner, PlannerInput};
use crate::reasoning::{Feedback, PromptError, PromptSet, feedback_text};
use crate::reflection::Verdict;
use crate::scenario::generator::{self, ScenarioType, Spec, types};
use crate::simulation::{Challenge, ClosedLoop};
use image::RgbImage;
use label_weights::DecisionWeights;
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;
use search::Candidate;
use std::ops::Range;
use std::path::Path;

/// Scenarios per shard: one of each type in the mix.
const SCENARIOS_PER_SHARD: u64 = MIX.len() as u64;
/// Scenarios of a dataset's seed; datasets of different seeds share none.
const SCENARIOS_PER_SEED: u64 = 100_000;
/// The first of these for datasets in which a model controls the ego.
const FIRST_OF_MODEL: u64 = SCENARIOS_PER_SEED / 2;
/// Iterations between two states of a scenario, uniformly random.
const GAP: std::ops::RangeInclusive<usize> = 14..=24;
/// Share of states after which a random candidate controls the ego, so that the dataset has states off the best path.
const EXPLORE: f64 = 0.35;
/// Share of the states with a rejected candidate whose prompt reports it.
const RETHINK: f64 = 0.4;

/// Types of the scenarios, in turn. Those in which a lane change is often right occur more than once.
const MIX: [ScenarioType; 20] = [
    types::starting_left_turn::TYPE,
    types::starting_right_turn::TYPE,
    types::starting_straight_traffic_light_intersection_traversal::TYPE,
    types::stopping_with_lead::TYPE,
    types::high_lateral_acceleration::TYPE,
    types::high_magnitude_speed::TYPE,
    types::low_magnitude_speed::TYPE,
    types::traversing_pickup_dropoff::TYPE,
    types::waiting_for_pedestrian_to_cross::TYPE,
    types::behind_long_vehicle::TYPE,
    types::stationary_in_traffic::TYPE,
    types::near_multiple_vehicles::TYPE,
    types::changing_lane::TYPE,
    types::following_lane_with_lead::TYPE,
    types::traversing_intersection::TYPE,
    types::traversing_roundabout::TYPE,
    types::changing_lane::TYPE,
    types::behind_long_vehicle::TYPE,
    types::changing_lane::TYPE,
    types::following_lane_with_lead::TYPE,
];

/// A part of the seeds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Split {
    Train,
    /// For the evaluation during training.
    Validation,
    /// For the evaluation of a trained model; no choice depends on it.
    Test,
}

impl Split {
    /// Name in file names.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Train => "train",
            Self::Validation => "validation",
            Self::Test => "test",
        }
    }

    /// Seeds of the split. Smaller ones are for tests of the program and demonstrations.
    pub fn seeds(self) -> Range<u64> {
        match self {
            Self::Train => 10_000_000..20_000_000,
            Self::Validation => 20_000_000..30_000_000,
            Self::Test => 30_000_000..40_000_000,
        }
    }

    fn scenarios(self, shard: usize, settings: &Settings<'_>) -> Result<Vec<Spec>, DatasetError> {
        let Range { start, end } = self.seeds();
        let own = start.saturating_add(settings.seed.saturating_mul(SCENARIOS_PER_SEED));
        let (begin, end) = match settings.driver {
            Some(_) => (own.saturating_add(FIRST_OF_MODEL), own.saturating_add(SCENARIOS_PER_SEED).min(end)),
            None => (own, own.saturating_add(FIRST_OF_MODEL).min(end)),
        };
        let first = begin.saturating_add((shard as u64).saturating_mul(SCENARIOS_PER_SHARD));
        if first.saturating_add(SCENARIOS_PER_SHARD) > end {
            return Err(DatasetError::NoScenarioLeft { split: self.as_str(), seed: settings.seed });
        }
        let has_wide = settings.prompts.forms().scene_text == TextForm::Compact2;
        let spec = |seed: u64| {
            let (round, kind) = (seed as usize / MIX.len(), seed as usize % MIX.len());
            let spec = Spec::new(MIX[kind], seed);
            // Limits are unknown in wide scenarios alone, and the second compact text says what they may be.
            if has_wide && round % 2 == 1 { spec.widened() } else { spec }
        };
        Ok((first..first + SCENARIOS_PER_SHARD).map(spec).collect())
    }
}

pub struct Settings<'a> {
    /// Seed of the scenarios and of the exploration.
    pub seed: u64,
    pub prompts: &'a PromptSet,
    /// Size of the images and of the area that they show.
    pub view: BevView,
    /// PlanAgent with a model that controls the ego between the states (`DAgger`): the states and the rejections are its own.
    /// Without it, the search controls the ego, with exploration. The search labels the states in both cases.
    pub driver: Option<&'a AgentParts>,
}

#[derive(Debug, thiserror::Error)]
pub enum DatasetError {
    #[error(transparent)]
    Shard(#[from] ShardError),
    #[error(transparent)]
    Prompt(#[from] PromptError),
    #[error(transparent)]
    View(#[from] BevError),
    #[error(
        "the split {split} has no more scenarios for seed {seed}; ask for fewer states, or use another seed below 100"
    )]
    NoScenarioLeft { split: &'static str, seed: u64 },
}

/// Checks that a dataset with these settings can be begun or resumed in a folder, and writes nothing.
///
/// # Errors
/// When it holds other files, or a dataset with other settings.
pub fn check_folder(folder: &Path, settings: &Settings<'_>) -> Result<(), DatasetError> {
    shard::is_begun(folder, &meta(settings))?;
    Ok(())
}

/// Writes shards until a split has `states` labeled states. Complete shards of an earlier run stay. Gives the number of states;
/// `on_states` gets that of each shard.
pub fn write_split(
    folder: &Path,
    split: Split,
    states: usize,
    settings: &Settings<'_>,
    on_states: &dyn Fn(usize),
) -> Result<usize, DatasetError> {
    shard::open_folder(folder, &meta(settings))?;
    let name = if settings.driver.is_some() { format!("{}-driven", split.as_str()) } else { split.as_str().to_owned() };
    let mut count = 0;
    let mut number = 0;
    while count < states {
        let made = match shard::complete(folder, &name, number) {
            Some(present) => present,
            None => write_shard(folder, (split, &name), number, settings)?,
        };
        on_states(made);
        count += made;
        number += 1;
    }
    Ok(count)
}

fn meta(settings: &Settings<'_>) -> Meta {
    Meta {
        format: FORMAT,
        image_pixels: settings.view.pixels(),
        view_m: settings.view.metres(),
        prompt_set: settings.prompts.name().to_owned(),
        seed: settings.seed,
        planagent: env!("CARGO_PKG_VERSION").to_owned(),
    }
}

fn write_shard(
    folder: &Path,
    (split, name): (Split, &str),
    number: usize,
    settings: &Settings<'_>,
) -> Result<usize, DatasetError> {
    let scenarios = split.scenarios(number, settings)?;
    let labeled: Vec<Vec<(LabeledState, RgbImage)>> =
        scenarios.par_iter().map(|spec| label_scenario(spec, settings)).collect::<Result<_, PromptError>>()?;
    let states: Vec<_> = labeled.into_iter().flatten().collect();
    let made = states.len();
    shard::write(folder, name, number, states, settings.view.pixels())?;
    Ok(made)
}

/// Labeled states of one scenario; none if the generator discards all its draws.
fn label_scenario(spec: &Spec, settings: &Settings<'_>) -> Result<Vec<(LabeledState, RgbImage)>, PromptError> {
    let mut random = Pcg64Mcg::seed_from_u64(settings.seed ^ spec.seed.wrapping_mul(0x9E37_79B9_7F4A_7C15));
    let Ok(scenario) = generator::generate(spec) else { return Ok(Vec::new()) };
    let challenge = Challenge::CLOSED_LOOP[usize::from(random.random_bool(0.5))];
    let Ok(mut simulation) = ClosedLoop::new(&scenario, challenge) else { return Ok(Vec::new()) };
    let mut agent = settings.driver.and_then(|parts| parts.agent(&scenario.id));
    let mut states = Vec::new();
    loop {
        let scene = simulation.scene();
        let Ok(graph) = LaneGraph::build(&scene, crate::environment::DEFAULT_NODE_LENGTH) else { break };
        let tried = search::search(&simulation, &graph);
        let Some(best) = search::best(&tried) else { break };
        let facts = SceneFacts::of(&scene, &graph);
        let name = format!("{}@{:.1}", scenario.id, simulation.iteration() as f64 * crate::world::STEP_S);
        let image = bev::render(&scene, &settings.view);
        let mut label = |feedback: Option<Feedback>| -> Result<(), PromptError> {
            let weights = DecisionWeights::of(best, &tried, feedback.is_some());
            let feedback = feedback.map(|feedback| feedback_text(settings.prompts, &feedback)).transpose()?;
            let label =
                label::label(name.clone(), &graph, &facts, (best, weights), settings.prompts, feedback.as_deref())?;
            states.push((label, image.clone()));
            Ok(())
        };
        // The label is also the right answer after a rejection: it is accepted, or it is the best of the rejected.
        let planner = if let Some(agent) = &mut agent {
            agent.state_mut().request_call();
            if agent.compute_trajectory(&PlannerInput { iteration: 0, scene }).is_err() {
                break;
            }
            label(None)?;
            let call = agent.calls().last();
            for rejected in call.iter().flat_map(|call| &call.attempts).filter(|attempt| is_rejected(attempt)) {
                label(Some(rejected.feedback(search::THRESHOLD)))?;
            }
            agent.state().active_plan().cloned()
        } else {
            let rejected: Vec<&Candidate> = tried.iter().filter(|t| !t.is_accepted() && *t != best).collect();
            let reported = rejected.choose(&mut random).filter(|_| random.random_bool(RETHINK));
            label(reported.map(|candidate| candidate.feedback()))?;
            let next = if random.random_bool(EXPLORE) { tried.choose(&mut random).unwrap_or(best) } else { best };
            search::planner(&simulation, &graph, next.code)
        };
        let Some(planner) = planner else { break };
        if search::follow(&mut simulation, &planner, &mut PdmMemory::default(), random.random_range(GAP)).is_none() {
            break;
        }
    }
    Ok(states)
}

fn is_rejected(attempt: &Attempt) -> bool {
    attempt.reflection.as_ref().is_some_and(|report| report.verdict == Verdict::Rethink)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn datasets_of_different_seeds_share_no_scenario_and_stay_in_their_split() {
        let prompts = PromptSet::open("compact").unwrap();
        let last = (FIRST_OF_MODEL / SCENARIOS_PER_SHARD) as usize - 1;
        let scenes = |seed, shard| {
            let settings = Settings { seed, prompts: &prompts, view: BevView::default(), driver: None };
            Split::Train.scenarios(shard, &settings)
        };
        let ends = |scenes: Vec<Spec>| (scenes[0].seed, scenes.last().unwrap().seed);
        assert_eq!(ends(scenes(0, 0).unwrap()), (10_000_000, 10_000_019));
        assert_eq!(ends(scenes(0, last).unwrap()), (10_049_980, 10_049_999), "the rest is for datasets with a model");
        assert_eq!(ends(scenes(1, 0).unwrap()).0, 10_100_000);
        assert_eq!(ends(scenes(99, last).unwrap()).1, 19_949_999);
        for (seed, shard) in [(0, last + 1), (100, 0), (u64::MAX, 0)] {
            let error = scenes(seed, shard).unwrap_err().to_string();
            assert!(error.contains(&format!("no more scenarios for seed {seed}")), "{error}");
        }
    }
}
