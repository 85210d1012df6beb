//! Which scenarios a dataset is drawn from.

use super::{DatasetError, Settings, Split};
use planagent_agent::environment::TextForm;
use planagent_scenario::generator::{self, Ranges, ScenarioType, Spec, types};
use planagent_scenario::modified::ModifiedName;
use planagent_scenario::{Scenario, ScenarioRef};
use planagent_world::InteractionKind;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::ops::Range;

/// Scenarios per shard: one of each type in the mix.
pub(super) const SCENARIOS_PER_SHARD: u64 = MIX.len() as u64;
/// Scenarios of a dataset's seed; datasets of different seeds share none.
pub(super) const SCENARIOS_PER_SEED: u64 = 100_000;
/// The first of these for datasets in which a model controls the ego.
pub(super) const FIRST_OF_MODEL: u64 = SCENARIOS_PER_SEED / 2;

/// Types of the scenarios, in turn. Those in which a lane change is often right occur more than
/// once.
pub(super) const MIX: [ScenarioType; 20] = [
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

/// The first scenarios of training seeds, of each type in turn.
pub(crate) fn training_scenarios(seed: u64, count: usize) -> Vec<ScenarioRef> {
    let start = Split::Train.seeds().start;
    let first = start.saturating_add(seed.saturating_mul(SCENARIOS_PER_SEED));
    (first..first.saturating_add(count as u64))
        .map(|seed| Spec::new(MIX[seed as usize % MIX.len()], seed).into())
        .collect()
}

/// The scenarios of a shard.
pub(crate) fn scenarios(
    split: Split,
    shard: usize,
    settings: &Settings<'_>,
) -> Result<Vec<Spec>, DatasetError> {
    let Range { start, end } = split.seeds();
    let own = start.saturating_add(settings.seed.saturating_mul(SCENARIOS_PER_SEED));
    let (begin, end) = match settings.driver {
        Some(_) => (
            own.saturating_add(FIRST_OF_MODEL),
            own.saturating_add(SCENARIOS_PER_SEED).min(end),
        ),
        None => (own, own.saturating_add(FIRST_OF_MODEL).min(end)),
    };
    let first = begin.saturating_add((shard as u64).saturating_mul(SCENARIOS_PER_SHARD));
    if first.saturating_add(SCENARIOS_PER_SHARD) > end {
        return Err(DatasetError::NoScenarioLeft {
            split: split.as_str(),
            seed: settings.seed,
        });
    }
    let has_wide = settings.prompts.forms().scene_text == TextForm::Compact2;
    let spec = |seed: u64| {
        let (round, kind) = (seed as usize / MIX.len(), seed as usize % MIX.len());
        let spec = Spec::new(MIX[kind], seed);
        // Limits are unknown in wide scenarios alone, and the second compact text says what they
        // may be.
        if has_wide && round % 2 == 1 {
            spec.drawn_from(Ranges::Wide)
        } else {
            spec
        }
    };
    Ok((first..first + SCENARIOS_PER_SHARD).map(spec).collect())
}

/// The scenario of a spec. For the share of scenarios that the settings name, one of interPlan's
/// kinds modifies it, if one fits. None if the generator discards all its draws.
pub(super) fn scenario(spec: &Spec, settings: &Settings<'_>) -> Option<Scenario> {
    let base = generator::generate(spec).ok()?;
    let mut random = Pcg64Mcg::seed_from_u64(spec.seed.wrapping_mul(0xD6E8_FEB8_6659_FD93));
    if !random.random_bool(settings.modified) {
        return Some(base);
    }
    let kinds = InteractionKind::ALL;
    let first = random.random_range(0..kinds.len());
    let mut in_turn = kinds.iter().cycle().skip(first).take(kinds.len());
    let modified = |kind: &InteractionKind| {
        ModifiedName::for_kind(*kind)
            .read()
            .ok()?
            .apply(base.clone())
            .ok()
    };
    Some(in_turn.find_map(modified).unwrap_or(base))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn datasets_of_different_seeds_share_no_scenario_and_stay_in_their_split() {
        let prompts = planagent_agent::reasoning::PromptSet::open("compact").unwrap();
        let last = (FIRST_OF_MODEL / SCENARIOS_PER_SHARD) as usize - 1;
        let scenes = |seed, shard| {
            let settings = Settings {
                seed,
                prompts: &prompts,
                view: planagent_agent::environment::BevView::default(),
                driver: None,
                modified: 0.0,
            };
            scenarios(Split::Train, shard, &settings)
        };
        let ends = |scenes: Vec<Spec>| (scenes[0].seed, scenes.last().unwrap().seed);
        assert_eq!(ends(scenes(0, 0).unwrap()), (10_000_000, 10_000_019));
        assert_eq!(
            ends(scenes(0, last).unwrap()),
            (10_049_980, 10_049_999),
            "the rest is for datasets with a model"
        );
        assert_eq!(ends(scenes(1, 0).unwrap()).0, 10_100_000);
        assert_eq!(ends(scenes(99, last).unwrap()).1, 19_949_999);
        for (seed, shard) in [(0, last + 1), (100, 0), (u64::MAX, 0)] {
            let error = scenes(seed, shard).unwrap_err().to_string();
            assert!(
                error.contains(&format!("no more scenarios for seed {seed}")),
                "{error}"
            );
        }
    }
}
