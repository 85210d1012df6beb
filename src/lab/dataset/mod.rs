//! Labeled states for training. A noisy search or a model controls the ego in generated scenarios,
//! and the search labels each state with the best planner.
//!
//! The seeds of training, validation and test are disjoint (see [`Split`]).

mod count;
#[cfg(feature = "learned")]
pub mod imitation;
mod label;
mod label_weights;
mod lessons;
mod messages;
mod refusal;
mod reward;
mod scenes;
mod shard;
mod state_name;
mod states;
pub mod twins;

pub use count::Counts;
pub(crate) use label::LabeledState;
pub use messages::{Chats, MessageModel, check_messages, write_message_card, write_messages};
pub use planagent_language_agents::{Teacher, taught_agents, teacher};
pub use reward::{Reward, RewardError, RewardKind, RewardOutcome, rewards};
pub(crate) use scenes::scenarios;
pub(crate) use scenes::training_scenarios;
pub use shard::{FORMAT, Meta, ShardError};
pub use state_name::{StateError, StateName};
pub(crate) use states::{VisitedState, walk};

use image::RgbImage;
use planagent_agent::environment::{BevError, BevView};
use planagent_agent::reasoning::{PromptError, PromptSet};
use planagent_runs::worker::run::AgentParts;
use planagent_runs::worker::seeds::Split;
use rayon::prelude::*;
use std::path::Path;

pub struct Settings<'a> {
    /// Seed of the scenarios and of the exploration.
    pub seed: u64,
    pub prompts: &'a PromptSet,
    /// Size of the images and of the area that they show.
    pub view: BevView,
    /// PlanAgent with a model that controls the ego between the states (`DAgger`): the states and
    /// the rejections are its own. Without it, the search controls the ego, with exploration. The
    /// search labels the states in both cases.
    pub driver: Option<&'a AgentParts>,
    /// Share of the scenarios that are modified by interPlan's kinds, from 0 to 1.
    pub modified: f64,
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

/// Checks that a dataset with these settings can be begun or resumed in a folder, and writes
/// nothing.
///
/// # Errors
/// When it holds other files, or a dataset with other settings.
pub fn check_folder(folder: &Path, settings: &Settings<'_>) -> Result<(), DatasetError> {
    shard::is_begun(folder, &meta(settings))?;
    Ok(())
}

/// Writes shards until a split has `states` labeled states. Complete shards of an earlier run stay.
/// Gives the number of states; `on_states` gets that of each shard.
pub fn write_split(
    folder: &Path,
    split: Split,
    states: usize,
    settings: &Settings<'_>,
    on_states: &dyn Fn(usize),
) -> Result<usize, DatasetError> {
    shard::open_folder(folder, &meta(settings))?;
    let name = if settings.driver.is_some() {
        format!("{}-driven", split.as_str())
    } else {
        split.as_str().to_owned()
    };
    let make = |number: usize| -> Result<LabeledStates, DatasetError> {
        let scenarios = scenes::scenarios(split, number, settings)?;
        let labeled = scenarios
            .par_iter()
            .map(|spec| states::label_scenario(spec, settings));
        Ok(labeled
            .collect::<Result<Vec<_>, PromptError>>()?
            .into_iter()
            .flatten()
            .collect())
    };
    write_shards(folder, &name, states, settings, (&make, on_states))
}

/// Writes shards until a split has the states of `pairs` text twins; the two states of a pair
/// follow each other. Gives the number of pairs; `on_pairs` gets that of each shard.
pub fn write_twins(
    folder: &Path,
    split: Split,
    pairs: usize,
    settings: &Settings<'_>,
    on_pairs: &dyn Fn(usize),
) -> Result<usize, DatasetError> {
    shard::open_folder(folder, &meta(settings))?;
    let make = |number: usize| -> Result<LabeledStates, DatasetError> {
        let names = twins::candidates(split, number, settings)?;
        let labeled = names.par_iter().map(|name| twins::labeled(name, settings));
        Ok(labeled
            .collect::<Result<Vec<_>, PromptError>>()?
            .into_iter()
            .flatten()
            .flatten()
            .collect())
    };
    let name = format!("{}-twins", split.as_str());
    Ok(write_shards(
        folder,
        &name,
        2 * pairs,
        settings,
        (&make, &|states| on_pairs(states / 2)),
    )? / 2)
}

/// States with their images.
type LabeledStates = Vec<(LabeledState, RgbImage)>;
/// Makes the shard of a number, and gets the number of its states.
type ShardMaker<'a> = (
    &'a dyn Fn(usize) -> Result<LabeledStates, DatasetError>,
    &'a dyn Fn(usize),
);

/// Writes shards until there are at least `states` states, and returns their number.
fn write_shards(
    folder: &Path,
    name: &str,
    states: usize,
    settings: &Settings<'_>,
    (make, on_states): ShardMaker<'_>,
) -> Result<usize, DatasetError> {
    let mut count = 0;
    let mut number = 0;
    while count < states {
        let made = match shard::complete(folder, name, number) {
            Some(present) => present,
            None => shard::write(folder, name, number, make(number)?, settings.view.pixels())?,
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
        view_m: settings.view.meters(),
        prompt_set: settings.prompts.name().to_owned(),
        modified: settings.modified,
        occupancy_s: [0.0, 1.0, 2.0],
        seed: settings.seed,
        planagent: env!("CARGO_PKG_VERSION").to_owned(),
    }
}
