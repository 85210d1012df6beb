//! The filters that follow nuPlan's scenario query, in the devkit's order: number per type, number in all, time between scenarios,
//! motion of the ego, token set, route; then the order of the scenarios.
//!
//! A type's scenarios stand in order of log and time until the filter of time sorts them by time alone.

use super::error::NuPlanError;
use super::extraction::{ROW_S, ROWS_PER_STEP, UNKNOWN_TYPE};
use super::filter::{Limit, SPEED_NOISE, ScenarioFilter, TokenSet};
use super::map_store::MapStore;
use super::open::{ego_of, route_ids};
use super::rows::Rows;
use super::schema::{EGO_POSE, open_log};
use super::search::Found;
use super::token::Token;
use crate::world::{EgoState, MICROS_PER_SECOND, STEP_S};
use rand::SeedableRng;
use rand::seq::{IndexedRandom, SliceRandom};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

type ByType = BTreeMap<String, Vec<Found>>;

/// Applies the filters.
pub(super) fn thin(found: Vec<Found>, filter: &ScenarioFilter, maps: &MapStore) -> Result<Vec<Found>, NuPlanError> {
    let mut dice = filter.shuffle.then(|| Pcg64Mcg::seed_from_u64(filter.seed));
    let mut by_type = ByType::new();
    for one in found {
        by_type.entry(one.scenario_type.clone()).or_default().push(one);
    }
    if let Some(count) = filter.num_scenarios_per_type {
        for scenarios in by_type.values_mut() {
            *scenarios = sample(std::mem::take(scenarios), count, dice.as_mut());
        }
    }
    if let Some(limit) = filter.limit_total_scenarios {
        by_type = limited(by_type, limit, dice.as_mut());
    }
    if let Some(seconds) = filter.timestamp_threshold_s {
        for scenarios in by_type.values_mut() {
            *scenarios = apart(std::mem::take(scenarios), seconds);
        }
    }
    let mut kept: Vec<Found> = by_type.into_values().flatten().collect();
    if filter.looks_inside() {
        let set = filter.token_set.as_ref().map(read_token_set).transpose()?;
        let passing = kept.into_par_iter().map(|one| Ok(passes(&one, filter, set.as_ref(), maps)?.then_some(one)));
        let passing = passing.collect::<Result<Vec<_>, NuPlanError>>()?;
        kept = passing.into_iter().flatten().collect();
    }
    kept.sort_by_key(|one| one.token);
    if let Some(dice) = &mut dice {
        kept.shuffle(dice);
    }
    Ok(kept)
}

/// `count` scenarios: drawn at random, else evenly spaced from the first on.
fn sample(scenarios: Vec<Found>, count: usize, dice: Option<&mut Pcg64Mcg>) -> Vec<Found> {
    if let Some(dice) = dice.filter(|_| count < scenarios.len()) {
        return scenarios.sample(dice, count).cloned().collect();
    }
    let step = (scenarios.len() / count.max(1)).max(1);
    scenarios.into_iter().step_by(step).take(count).collect()
}

/// Scenarios without a tag go first; only when they do not suffice, tagged ones follow.
fn limited(mut by_type: ByType, limit: Limit, dice: Option<&mut Pcg64Mcg>) -> ByType {
    let total: usize = by_type.values().map(Vec::len).sum();
    let wanted = match limit {
        Limit::Count(count) => count,
        Limit::Fraction(share) => (share * total as f64).ceil() as usize,
    };
    if wanted >= total {
        return by_type;
    }
    let surplus = total - wanted;
    if let Some(unknown) = by_type.remove(UNKNOWN_TYPE)
        && surplus < unknown.len()
    {
        let kept = unknown.len() - surplus;
        by_type.insert(UNKNOWN_TYPE.to_owned(), sample(unknown, kept, dice));
        return by_type;
    }
    let mut all: Vec<Found> = by_type.into_values().flatten().collect();
    all.sort_by_key(|one| one.token);
    let mut kept = ByType::new();
    for one in sample(all, wanted, dice) {
        kept.entry(one.scenario_type.clone()).or_default().push(one);
    }
    kept
}

/// In order of time, those that begin at least so long after the one before that was kept.
fn apart(mut scenarios: Vec<Found>, seconds: f64) -> Vec<Found> {
    scenarios.sort_by_key(|one| one.timestamp_us);
    let mut next = f64::NEG_INFINITY;
    scenarios.retain(|one| {
        let time = one.timestamp_us as f64 / MICROS_PER_SECOND;
        let kept = time >= next;
        if kept {
            next = time + seconds;
        }
        kept
    });
    scenarios
}

fn read_token_set(set: &TokenSet) -> Result<(BTreeSet<Token>, f64), NuPlanError> {
    let failed = |reason: String| NuPlanError::TokenSet { path: set.path.clone(), reason };
    let text = std::fs::read_to_string(&set.path).map_err(|error| failed(error.to_string()))?;
    let words: Vec<String> = serde_json::from_str(&text).map_err(|error| failed(error.to_string()))?;
    let tokens = words.iter().map(|word| word.parse().map_err(|error| failed(format!("{error}"))));
    Ok((tokens.collect::<Result<_, _>>()?, set.fraction))
}

/// Whether a scenario passes the filters that look at its rows. One that could not be driven (too short, without route) does not.
fn passes(
    found: &Found,
    filter: &ScenarioFilter,
    set: Option<&(BTreeSet<Token>, f64)>,
    maps: &MapStore,
) -> Result<bool, NuPlanError> {
    match passes_inside(found, filter, set, maps) {
        Err(NuPlanError::Scenario { .. }) => Ok(false),
        passes => passes,
    }
}

fn passes_inside(
    found: &Found,
    filter: &ScenarioFilter,
    set: Option<&(BTreeSet<Token>, f64)>,
    maps: &MapStore,
) -> Result<bool, NuPlanError> {
    let database = open_log(&found.log)?;
    let rows = Rows::read(&database, found)?;
    let iterations: Vec<_> = rows.iterations().collect();
    let ego = |place: usize| match rows.window.get(place) {
        Some(row) => database.first(EGO_POSE, "WHERE token = ?1", [row.ego_pose], |record| ego_of(record, row.time_us)),
        None => Ok(None),
    };
    let Some(start) = ego(0)? else { return Ok(false) };
    let moves = filter.ego_displacement_minimum_m.is_some()
        || filter.ego_start_speed_threshold.is_some()
        || filter.ego_stop_speed_threshold.is_some();
    if moves {
        let duration = iterations.last().map_or(0, |last| last.time_us - start.time_us) as f64 / MICROS_PER_SECOND;
        let mut future = Vec::new();
        for place in future_rows(duration) {
            future.extend(ego(place)?);
        }
        let noise = filter.speed_noise_tolerance.unwrap_or(SPEED_NOISE);
        let starts = |threshold: f64| crosses(&start, &future, threshold, noise).0;
        let stops = |threshold: f64| crosses(&start, &future, threshold, noise).1;
        let passes = filter.ego_displacement_minimum_m.is_none_or(|metres| displacement(&future) >= metres)
            && filter.ego_start_speed_threshold.is_none_or(starts)
            && filter.ego_stop_speed_threshold.is_none_or(stops);
        if !passes {
            return Ok(false);
        }
    }
    if let Some((set, fraction)) = set {
        let own: BTreeSet<Token> = iterations.iter().map(|row| row.token).collect();
        let share = own.intersection(set).count() as f64 / own.len() as f64;
        if !(if *fraction >= 1.0 { own == *set } else { share > *fraction }) {
            return Ok(false);
        }
    }
    if let Some(radius) = filter.ego_route_radius {
        let map = maps.map(&found.map_name)?;
        let (_, _, ids) = route_ids(&database, found.token)?;
        let on_route: BTreeSet<_> = ids.iter().filter_map(|&id| map.roadblock(id)).collect();
        let here = map.to_local(start.rear_axle).position();
        return Ok(map
            .lanes
            .lanes_near(here, radius)
            .iter()
            .any(|&lane| on_route.contains(&map.lanes[lane].roadblock)));
    }
    Ok(true)
}

/// The rows behind iteration 0 that the devkit samples over a scenario's duration (`sample_indices_with_time_horizon`).
fn future_rows(duration_s: f64) -> impl Iterator<Item = usize> {
    let count = (duration_s / STEP_S) as usize;
    let rows = (duration_s / ROW_S) as usize + 1;
    let step = rows.checked_div(count).unwrap_or(ROWS_PER_STEP).max(1);
    (1..=count).map(move |sample| sample * step)
}

/// Metres that the centre of the ego covers from sample to sample.
fn displacement(states: &[EgoState]) -> f64 {
    states.windows(2).map(|pair| pair[0].center().distance(&pair[1].center())).sum()
}

/// Whether the speed rises above a threshold, and whether it falls to it (devkit `_check_for_speed_edge`).
fn crosses(start: &EgoState, future: &[EgoState], threshold: f64, noise: f64) -> (bool, bool) {
    let (mut highest, mut lowest) = (start.speed(), start.speed());
    let (mut rises, mut falls) = (false, false);
    for speed in future.iter().map(EgoState::speed) {
        if speed > highest {
            highest = speed;
            if highest > threshold && threshold >= lowest && highest - lowest > noise {
                rises = true;
                lowest = highest;
            }
        }
        if speed < lowest {
            lowest = speed;
            if highest > threshold && threshold >= lowest && highest - lowest > noise {
                falls = true;
                highest = lowest;
            }
        }
    }
    (rises, falls)
}
