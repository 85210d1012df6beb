//! Labelled states for training: generated scenes, driven by noisy search, each state labelled by what search found best.
//!
//! The seeds of training, validation and test scenes never meet (see [`Split`]).

mod label;
mod label_weights;
pub mod search;
mod shard;

pub use label::LabelledState;
pub use shard::{FORMAT, Meta, ShardError};

use super::run::AgentParts;
use crate::environment::{BevError, BevView, LaneGraph, SceneFacts, bev};
use crate::pdm::PdmMemory;
use crate::planner::{Attempt, Planner, PlannerInput};
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
use search::Tried;
use std::ops::Range;
use std::path::Path;

/// Scenes per shard: one of each place in the mix.
const SCENES_PER_SHARD: u64 = MIX.len() as u64;
/// Scenes that a seed of [`Settings`] has to itself, so that datasets of different seeds share none.
const SCENES_PER_SEED: u64 = 100_000;
/// Of these, the scenes from this one on are for drives of a model.
const FIRST_DRIVEN: u64 = SCENES_PER_SEED / 2;
/// Iterations between two states of a drive, drawn evenly.
const GAP: std::ops::RangeInclusive<usize> = 14..=24;
/// Share of states from which the drive goes on with another planner than the best, so that off-track states are seen too.
const EXPLORE: f64 = 0.35;
/// Share of the states with a refused planner whose prompt tells of it.
const RETHINK: f64 = 0.4;

/// Types of the scenes, in turn; those where changing lanes is often right come more than once.
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

/// Which part of the seeds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Split {
    /// Scenes that models are trained on.
    Train,
    /// Scenes by which training is judged.
    Validation,
    /// Scenes by which what was trained is judged; nothing is chosen by them.
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

    /// Seeds of the split. Those below all splits are for tests of the program and demonstrations.
    pub fn seeds(self) -> Range<u64> {
        match self {
            Self::Train => 10_000_000..20_000_000,
            Self::Validation => 20_000_000..30_000_000,
            Self::Test => 30_000_000..40_000_000,
        }
    }

    /// Scenes of a shard.
    fn scenes(self, shard: usize, settings: &Settings<'_>) -> Result<Vec<Spec>, DatasetError> {
        let Range { start, end } = self.seeds();
        let own = start.saturating_add(settings.seed.saturating_mul(SCENES_PER_SEED));
        let (begin, end) = match settings.driver {
            Some(_) => (own.saturating_add(FIRST_DRIVEN), own.saturating_add(SCENES_PER_SEED).min(end)),
            None => (own, own.saturating_add(FIRST_DRIVEN).min(end)),
        };
        let first = begin.saturating_add((shard as u64).saturating_mul(SCENES_PER_SHARD));
        if first.saturating_add(SCENES_PER_SHARD) > end {
            return Err(DatasetError::NoSceneLeft { split: self.as_str(), seed: settings.seed });
        }
        Ok((first..first + SCENES_PER_SHARD).map(|seed| Spec::new(MIX[seed as usize % MIX.len()], seed)).collect())
    }
}

/// How a dataset is made.
pub struct Settings<'a> {
    /// Seed of the scenes and of the exploration.
    pub seed: u64,
    /// Prompts of the conversations.
    pub prompts: &'a PromptSet,
    /// What the images show.
    pub view: BevView,
    /// Who drives from state to state: PlanAgent with a model, so that the states are those that it reaches and the refusals its own
    /// (`DAgger`); else the search itself, with exploration. The search gives the labels either way.
    pub driver: Option<&'a AgentParts>,
}

/// Why a dataset cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum DatasetError {
    /// A shard cannot be written.
    #[error(transparent)]
    Shard(#[from] ShardError),
    /// A prompt cannot be made.
    #[error(transparent)]
    Prompt(#[from] PromptError),
    /// The view cannot be drawn.
    #[error(transparent)]
    View(#[from] BevError),
    /// All scenes that the split has for this seed are labelled.
    #[error(
        "the split {split} has no more scenes for seed {seed}; ask for fewer states, or for another seed below 100"
    )]
    NoSceneLeft {
        /// Name of the split.
        split: &'static str,
        /// Seed of the dataset.
        seed: u64,
    },
}

/// Writes shards until a split has `states` labelled states; complete shards of an earlier run are kept. Gives the number of
/// states. `on_states` is told how many came.
///
/// # Errors
/// When a shard cannot be written or a prompt cannot be made.
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

/// Writes a shard of a split under a name.
fn write_shard(
    folder: &Path,
    (split, name): (Split, &str),
    number: usize,
    settings: &Settings<'_>,
) -> Result<usize, DatasetError> {
    let scenes = split.scenes(number, settings)?;
    let labelled: Vec<Vec<(LabelledState, RgbImage)>> =
        scenes.par_iter().map(|spec| label_scene(spec, settings)).collect::<Result<_, PromptError>>()?;
    let states: Vec<_> = labelled.into_iter().flatten().collect();
    let made = states.len();
    shard::write(folder, name, number, states, settings.view.pixels())?;
    Ok(made)
}

/// Labelled states of one scene. A scene that cannot be generated gives none; the generator's seeds are not all fruitful.
fn label_scene(spec: &Spec, settings: &Settings<'_>) -> Result<Vec<(LabelledState, RgbImage)>, PromptError> {
    let mut random = Pcg64Mcg::seed_from_u64(settings.seed ^ spec.seed.wrapping_mul(0x9E37_79B9_7F4A_7C15));
    let Ok(scenario) = generator::generate(spec) else { return Ok(Vec::new()) };
    let challenge = Challenge::CLOSED_LOOP[usize::from(random.random_bool(0.5))];
    let Ok(mut drive) = ClosedLoop::new(&scenario, challenge) else { return Ok(Vec::new()) };
    let mut agent = settings.driver.and_then(|parts| parts.agent(&scenario.id));
    let mut states = Vec::new();
    loop {
        let scene = drive.scene();
        let Ok(graph) = LaneGraph::build(&scene, crate::environment::DEFAULT_NODE_LENGTH) else { break };
        let tried = search::search(&drive, &graph);
        let Some(best) = search::best(&tried) else { break };
        let facts = SceneFacts::of(&scene, &graph);
        let name = format!("{}@{:.1}", scenario.id, drive.iteration() as f64 * crate::world::STEP_S);
        let image = bev::render(&scene, &settings.view);
        let mut label = |feedback: Option<Feedback>| -> Result<(), PromptError> {
            let weights = DecisionWeights::of(best, &tried, feedback.is_some());
            let told = feedback.map(|feedback| feedback_text(settings.prompts, &feedback)).transpose()?;
            let label = label::label(name.clone(), &graph, &facts, (best, weights), settings.prompts, told.as_deref())?;
            states.push((label, image.clone()));
            Ok(())
        };
        // What a model has to answer after a refusal is the label as well: one that is accepted, or one that, refused again, drives best.
        let planner = if let Some(agent) = &mut agent {
            if agent.compute_trajectory(&PlannerInput { iteration: 0, scene }).is_err() {
                break;
            }
            label(None)?;
            let call = agent.calls().last();
            for refused in call.iter().flat_map(|call| &call.attempts).filter(|attempt| is_refused(attempt)) {
                label(Some(refused.feedback(search::THRESHOLD)))?;
            }
            agent.active_plan().cloned()
        } else {
            let refused: Vec<&Tried> = tried.iter().filter(|t| !t.is_accepted() && *t != best).collect();
            let told = refused.choose(&mut random).filter(|_| random.random_bool(RETHINK));
            label(told.map(|refused| refused.feedback()))?;
            let next = if random.random_bool(EXPLORE) { tried.choose(&mut random).unwrap_or(best) } else { best };
            search::planner(&drive, &graph, next.code.clone())
        };
        let Some(planner) = planner else { break };
        if search::follow(&mut drive, &planner, &mut PdmMemory::default(), random.random_range(GAP)).is_none() {
            break;
        }
    }
    Ok(states)
}

/// Whether Reflection refused what was attempted.
fn is_refused(attempt: &Attempt) -> bool {
    attempt.reflection.as_ref().is_some_and(|report| report.verdict == Verdict::Rethink)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn datasets_of_different_seeds_share_no_scene_and_keep_to_their_split() {
        let prompts = PromptSet::open("compact").unwrap();
        let last = (FIRST_DRIVEN / SCENES_PER_SHARD) as usize - 1;
        let scenes = |seed, shard| {
            let settings = Settings { seed, prompts: &prompts, view: BevView::default(), driver: None };
            Split::Train.scenes(shard, &settings)
        };
        let ends = |scenes: Vec<Spec>| (scenes[0].seed, scenes.last().unwrap().seed);
        assert_eq!(ends(scenes(0, 0).unwrap()), (10_000_000, 10_000_019));
        assert_eq!(ends(scenes(0, last).unwrap()), (10_049_980, 10_049_999), "the rest is for drives of a model");
        assert_eq!(ends(scenes(1, 0).unwrap()).0, 10_100_000);
        assert_eq!(ends(scenes(99, last).unwrap()).1, 19_949_999);
        for (seed, shard) in [(0, last + 1), (100, 0), (u64::MAX, 0)] {
            let error = scenes(seed, shard).unwrap_err().to_string();
            assert!(error.contains(&format!("no more scenes for seed {seed}")), "{error}");
        }
    }
}
