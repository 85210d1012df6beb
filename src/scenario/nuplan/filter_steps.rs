//! The filters that follow nuPlan's scenario query, in the devkit's order: number per type, number
//! in all, time between scenarios, motion of the ego, token set, route. The order of the scenarios
//! comes last.
//!
//! The scenarios of a type are in order of log and time, until the filter of time sorts those of
//! all logs by time alone (devkit `_filter_scenarios_by_timestamp`).

use super::error::{FileFault, NuPlanError};
use super::exclusion::Exclusion;
use super::extraction::{ROW_S, ROWS_PER_STEP};
use super::filter::{Limit, SPEED_NOISE, ScenarioFilter, THRESHOLD_KEY, ThresholdScope, TokenSet};
use super::lane_map::NuPlanMap;
use super::logs::{Log, LogScenario};
use super::map_store::MapStore;
use super::route::route_ids;
use super::rows::{Rows, ego_of};
use super::schema::EGO_POSE;
use super::token::Token;
use crate::UNKNOWN_TYPE;
use planagent_world::{EgoState, MICROS_PER_SECOND, STEP_S};
use rand::SeedableRng;
use rand::seq::{IndexedRandom, SliceRandom};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

type ByType = BTreeMap<String, Vec<LogScenario>>;

/// The result of the filters.
pub(super) struct Filtered {
    /// In order of tokens, or shuffled.
    pub(super) kept: Vec<LogScenario>,
    pub(super) excluded: Vec<(Token, Exclusion)>,
}

/// Applies the filters. Fails when the token set or a map that a filter needs cannot be read.
pub(super) fn apply(
    found: Vec<LogScenario>,
    filter: &ScenarioFilter,
    maps: &MapStore,
) -> Result<Filtered, NuPlanError> {
    let mut rng = filter.shuffle.then(|| Pcg64Mcg::seed_from_u64(filter.seed));
    let mut ledger = Ledger {
        left: found.iter().map(|one| one.token).collect(),
        excluded: Vec::new(),
    };
    let mut by_type = ByType::new();
    for one in found {
        by_type
            .entry(one.scenario_type.clone())
            .or_default()
            .push(one);
    }
    if let Some(count) = filter.num_scenarios_per_type {
        for scenarios in by_type.values_mut() {
            *scenarios = sample(std::mem::take(scenarios), count, rng.as_mut());
        }
        ledger.keep("num_scenarios_per_type", &by_type);
    }
    if let Some(limit) = filter.limit_total_scenarios {
        by_type = limited(by_type, limit, rng.as_mut());
        ledger.keep("limit_total_scenarios", &by_type);
    }
    if let Some(seconds) = filter.timestamp_threshold_s {
        for scenarios in by_type.values_mut() {
            *scenarios = apart(std::mem::take(scenarios), seconds, filter.threshold_scope);
        }
        ledger.keep(THRESHOLD_KEY, &by_type);
    }
    let mut kept: Vec<LogScenario> = by_type.into_values().flatten().collect();
    if filter.needs_rows() {
        let set = filter.token_set.as_ref().map(read_token_set).transpose()?;
        let judged = kept
            .into_par_iter()
            .map(|one| exclusion(&one, filter, set.as_ref(), maps).map(|judged| (one, judged)));
        let judged = judged.collect::<Result<Vec<_>, NuPlanError>>()?;
        kept = Vec::with_capacity(judged.len());
        for (one, exclusion) in judged {
            match exclusion {
                Some(exclusion) => ledger.excluded.push((one.token, exclusion)),
                None => kept.push(one),
            }
        }
    }
    // By token and not by type, so that the same scenarios have one order, however they were found.
    kept.sort_by_key(|one| one.token);
    if let Some(rng) = &mut rng {
        kept.shuffle(rng);
    }
    Ok(Filtered {
        kept,
        excluded: ledger.excluded,
    })
}

/// The scenarios that are left, and why the others are not.
struct Ledger {
    left: BTreeSet<Token>,
    excluded: Vec<(Token, Exclusion)>,
}

impl Ledger {
    /// Records that a field of the filter excluded those that were left and are not in `kept`.
    fn keep(&mut self, key: &'static str, kept: &ByType) {
        let kept: BTreeSet<Token> = kept.values().flatten().map(|one| one.token).collect();
        self.excluded.extend(
            self.left
                .difference(&kept)
                .map(|&token| (token, Exclusion::Filtered(key))),
        );
        self.left = kept;
    }
}

/// `count` scenarios: random, or evenly spaced from the first on.
fn sample(
    scenarios: Vec<LogScenario>,
    count: usize,
    rng: Option<&mut Pcg64Mcg>,
) -> Vec<LogScenario> {
    if let Some(rng) = rng.filter(|_| count < scenarios.len()) {
        return scenarios.sample(rng, count).cloned().collect();
    }
    let step = (scenarios.len() / count.max(1)).max(1);
    scenarios.into_iter().step_by(step).take(count).collect()
}

/// Drops scenarios without a tag first; tagged ones only when those do not suffice.
fn limited(mut by_type: ByType, limit: Limit, rng: Option<&mut Pcg64Mcg>) -> ByType {
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
        by_type.insert(UNKNOWN_TYPE.to_owned(), sample(unknown, kept, rng));
        return by_type;
    }
    let mut all: Vec<LogScenario> = by_type.into_values().flatten().collect();
    all.sort_by_key(|one| one.token);
    let mut kept = ByType::new();
    for one in sample(all, wanted, rng) {
        kept.entry(one.scenario_type.clone()).or_default().push(one);
    }
    kept
}

/// In order of time, the scenarios that start at least a threshold after the previously kept one.
fn apart(mut scenarios: Vec<LogScenario>, seconds: f64, scope: ThresholdScope) -> Vec<LogScenario> {
    scenarios.sort_by_key(|one| one.timestamp_us);
    let mut next: BTreeMap<Option<Arc<Log>>, f64> = BTreeMap::new();
    scenarios.retain(|one| {
        let time = one.timestamp_us as f64 / MICROS_PER_SECOND;
        let log = match scope {
            ThresholdScope::AllLogs => None,
            ThresholdScope::EachLog => Some(one.log.clone()),
        };
        let next = next.entry(log).or_insert(f64::NEG_INFINITY);
        let kept = time >= *next;
        if kept {
            *next = time + seconds;
        }
        kept
    });
    scenarios
}

fn read_token_set(set: &TokenSet) -> Result<(BTreeSet<Token>, f64), NuPlanError> {
    let failed = |reason: String| NuPlanError::file(&set.path, FileFault::TokenSet(reason));
    let text = planagent_files::read_text(&set.path, planagent_files::MAX_LIST_BYTES)
        .map_err(|error| failed(error.to_string()))?;
    let words: Vec<String> =
        serde_json::from_str(&text).map_err(|error| failed(error.to_string()))?;
    let tokens = words
        .iter()
        .map(|word| word.parse().map_err(|error| failed(format!("{error}"))));
    Ok((tokens.collect::<Result<_, _>>()?, set.fraction))
}

/// The exclusion of a scenario by its rows. One that cannot be simulated (too short, without route)
/// is excluded. One whose log is damaged passes: its simulation will fail and report the damage.
fn exclusion(
    found: &LogScenario,
    filter: &ScenarioFilter,
    set: Option<&(BTreeSet<Token>, f64)>,
    maps: &MapStore,
) -> Result<Option<Exclusion>, NuPlanError> {
    let route = filter
        .ego_route_radius
        .map(|radius| maps.map(&found.map_name).map(|map| (radius, map)))
        .transpose()?;
    match excluded_by_rows(found, filter, set, route.as_ref()) {
        Err(NuPlanError::Scenario { .. }) => Ok(Some(Exclusion::NotDrivable)),
        Err(_) => Ok(None),
        judged => judged,
    }
}

/// The first field of the filter that the rows of a scenario do not satisfy; `route` is the maximal
/// distance to a lane of the route, m, and the map.
fn excluded_by_rows(
    found: &LogScenario,
    filter: &ScenarioFilter,
    set: Option<&(BTreeSet<Token>, f64)>,
    route: Option<&(f64, Arc<NuPlanMap>)>,
) -> Result<Option<Exclusion>, NuPlanError> {
    let database = found.log.open()?;
    let rows = Rows::read(&database, found)?;
    let iterations: Vec<_> = rows.iterations().collect();
    let ego = |place: usize| match rows.window.get(place) {
        Some(row) => database.first(EGO_POSE, "WHERE token = ?1", [row.ego_pose], |record| {
            ego_of(record, row.time_us)
        }),
        None => Ok(None),
    };
    let Some(start) = ego(0)? else {
        return Ok(Some(Exclusion::NotDrivable));
    };
    // The fields that need the fewest rows come first, and the one that needs the map comes last.
    let moves = filter.ego_displacement_minimum_m.is_some()
        || filter.ego_start_speed_threshold.is_some()
        || filter.ego_stop_speed_threshold.is_some();
    if moves {
        let duration = (iterations
            .last()
            .expect("the window has its first row")
            .time_us
            - start.time_us) as f64
            / MICROS_PER_SECOND;
        let mut future = Vec::new();
        for place in future_rows(duration) {
            future.extend(ego(place)?);
        }
        let noise = filter.speed_noise_tolerance.unwrap_or(SPEED_NOISE);
        let starts = |threshold: f64| crosses(&start, &future, threshold, noise).0;
        let stops = |threshold: f64| crosses(&start, &future, threshold, noise).1;
        if filter
            .ego_displacement_minimum_m
            .is_some_and(|meters| displacement(&future) < meters)
        {
            return Ok(Some(Exclusion::Filtered("ego_displacement_minimum_m")));
        }
        if !filter.ego_start_speed_threshold.is_none_or(starts) {
            return Ok(Some(Exclusion::Filtered("ego_start_speed_threshold")));
        }
        if !filter.ego_stop_speed_threshold.is_none_or(stops) {
            return Ok(Some(Exclusion::Filtered("ego_stop_speed_threshold")));
        }
    }
    if let Some((set, fraction)) = set {
        let own: BTreeSet<Token> = iterations.iter().map(|row| row.token).collect();
        let share = own.intersection(set).count() as f64 / own.len() as f64;
        if !(if *fraction >= 1.0 {
            own == *set
        } else {
            share > *fraction
        }) {
            return Ok(Some(Exclusion::Filtered("fraction_in_token_set_threshold")));
        }
    }
    if let Some((radius, map)) = route {
        let (_, _, ids) = route_ids(&database, found.token)?;
        let on_route: BTreeSet<_> = ids.iter().filter_map(|&id| map.roadblock(id)).collect();
        let here = map.to_local(start.rear_axle).position();
        let near = map.lanes.lanes_near(here, *radius);
        if !near
            .iter()
            .any(|&lane| on_route.contains(&map.lanes[lane].roadblock))
        {
            return Ok(Some(Exclusion::Filtered("ego_route_radius")));
        }
    }
    Ok(None)
}

/// The rows after iteration 0 that the devkit samples over the duration of a scenario
/// (`sample_indices_with_time_horizon`).
fn future_rows(duration_s: f64) -> impl Iterator<Item = usize> {
    let count = (duration_s / STEP_S) as usize;
    let rows = (duration_s / ROW_S) as usize + 1;
    let step = rows.checked_div(count).unwrap_or(ROWS_PER_STEP).max(1);
    (1..=count).map(move |sample| sample * step)
}

/// Distance that the center of the ego covers from sample to sample, m.
fn displacement(states: &[EgoState]) -> f64 {
    states
        .windows(2)
        .map(|pair| pair[0].center().distance(&pair[1].center()))
        .sum()
}

/// Whether the speed rises above a threshold, and whether it falls to the threshold (devkit
/// `_check_for_speed_edge`).
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
