//! `driving_direction_compliance`: 0.5 or 0 for driving against the direction of the lane.

use super::{MetricList, MetricResult, MetricSpec, Statistic, StatisticKind, TimeSeries};
use planagent_world::{EgoState, LaneId, LaneMap, MICROS_PER_SECOND};

/// Compliant movement against the direction within a second, meters.
pub(crate) const DIRECTION_COMPLIANCE: f64 = 2.0;
/// Movement against the direction within a second at which the score is 0, meters.
pub(crate) const DIRECTION_VIOLATION: f64 = 6.0;
/// Length of the window over which movement is summed, seconds.
const HORIZON_S: f64 = 1.0;

pub(super) const SPEC: MetricSpec = MetricSpec::new("driving_direction_compliance", |input| {
    Ok(Some(driving_direction_compliance(
        input.simulation.map,
        input.states(),
        &input.lanes().center,
    )))
})
.only(MetricList::ClosedLoop)
.multiplier()
.truth_value()
.bounds(Some(-DIRECTION_COMPLIANCE), None)
.label("dir");

/// 1 for less than 2 m against the direction, 0.5 for less than 6 m, else 0.
pub(crate) fn direction_score(meters_against: f64) -> f64 {
    if meters_against < DIRECTION_COMPLIANCE {
        1.0
    } else if meters_against < DIRECTION_VIOLATION {
        0.5
    } else {
        0.0
    }
}

/// The [`direction_score`] of the worst second along the lanes at the ego's center (`center_lanes`,
/// one entry a state).
pub fn driving_direction_compliance(
    map: &LaneMap,
    states: &[EgoState],
    center_lanes: &[Vec<LaneId>],
) -> MetricResult {
    let progress = progress_along_lanes(map, states, center_lanes);
    let window = samples_in_horizon(states);
    let sums: Vec<f64> = (0..progress.len())
        .map(|i| progress[i.saturating_sub(window)..=i].iter().sum::<f64>())
        .collect();
    // The absolute value also turns a positive minimum into movement against the direction; sample
    // 0 is always 0.
    let worst = sums.iter().copied().fold(f64::INFINITY, f64::min);
    let against = if worst.is_finite() { worst.abs() } else { 0.0 };
    let score = direction_score(against);
    let least = "min_progress_along_driving_direction_in_1_second_interval";
    let statistics = vec![
        Statistic::new(
            StatisticKind::Value,
            format!("{}_score", SPEC.name),
            "value",
            score,
        ),
        Statistic::new(StatisticKind::Min, least, "meters", -against),
    ];
    let unit = "progress_along_driving_direction_in_last_1_seconds_[m]";
    SPEC.scored(score, statistics)
        .with_series(TimeSeries::of_states(unit, states, sums))
}

/// Samples in the window before the present one: 10 at 10 Hz, 9 when the mean step is any longer.
/// Counted in microseconds, because rounding the step in seconds could lose the tenth.
fn samples_in_horizon(states: &[EgoState]) -> usize {
    let [first, .., last] = states else { return 0 };
    let mean_step_us = (last.time_us - first.time_us) as f64 / (states.len() - 1) as f64;
    if mean_step_us > 0.0 {
        (HORIZON_S * MICROS_PER_SECOND / mean_step_us) as usize
    } else {
        0
    }
}

/// Movement of the ego's center along the lane at each sample, meters.
fn progress_along_lanes(
    map: &LaneMap,
    states: &[EgoState],
    center_lanes: &[Vec<LaneId>],
) -> Vec<f64> {
    let mut followed = center_lanes
        .first()
        .and_then(|lanes| lanes.first().copied());
    let mut before: Option<f64> = None;
    let mut progress = Vec::with_capacity(states.len());
    for (state, lanes) in states.iter().zip(center_lanes) {
        let Some(&lane) = lanes.first() else {
            progress.push(0.0);
            continue;
        };
        if followed == Some(lane) {
            let s = map[lane].centerline.project(state.center().position()).s;
            // nuPlan takes an arc length of exactly 0 for a missing one.
            progress.push(before.map_or(0.0, |before| if s > 0.0 { s - before } else { 0.0 }));
            before = Some(s);
        } else {
            followed = Some(lane);
            before = None;
            progress.push(0.0);
        }
    }
    progress
}
