//! `speed_limit_compliance`: the speed above the limit, over time.

use super::{
    MetricCategory, MetricList, MetricResult, MetricSpec, Statistic, StatisticKind, TimeSeries,
};
use planagent_world::{EgoState, LaneId, LaneMap, MICROS_PER_SECOND};

/// Mean speed above the limit at which the score is 0, m/s (devkit
/// `speed_limit_compliance_statistics.yaml`).
pub(crate) const MAX_OVERSPEED: f64 = 2.23;

pub(super) const SPEC: MetricSpec = MetricSpec::new("speed_limit_compliance", |input| {
    Ok(Some(speed_limit_compliance(
        input.simulation.map,
        input.states(),
        &input.lanes().center,
    )))
})
.only(MetricList::ClosedLoop)
.weight(4.0)
.category(MetricCategory::Violations)
.bounds(None, Some(0.0))
.label("speed");

/// The score along the lanes at the ego's center (`center_lanes`, one entry a state).
pub fn speed_limit_compliance(
    map: &LaneMap,
    states: &[EgoState],
    center_lanes: &[Vec<LaneId>],
) -> MetricResult {
    let over: Vec<f64> = states
        .iter()
        .zip(center_lanes)
        .map(|(state, lanes)| {
            limit_of(map, lanes).map_or(0.0, |limit| (state.speed() - limit).max(0.0))
        })
        .collect();
    let times: Vec<i64> = states.iter().map(|s| s.time_us).collect();
    let statistics = statistics(SPEC.name, &violations(&over, &times));
    SPEC.scored(score(&over, &times), statistics)
        .with_series(TimeSeries::of_states(
            "over_speeding[meters_per_second]",
            states,
            over,
        ))
}

/// The limit of these lanes, m/s: a lane's own; in connectors the highest of the lanes before and
/// after them, when all have one. (nuPlan fails on connectors without such a lane; here they have
/// no limit.)
fn limit_of(map: &LaneMap, lanes: &[LaneId]) -> Option<f64> {
    let first = map.lanes().get(lanes.first()?.index())?;
    let limits: Vec<Option<f64>> = if first.is_connector() {
        let edges = lanes
            .iter()
            .flat_map(|&id| map[id].outgoing.iter().chain(&map[id].incoming));
        edges.map(|&id| map[id].speed_limit).collect()
    } else {
        vec![first.speed_limit]
    };
    let known: Option<Vec<f64>> = limits
        .into_iter()
        .map(|limit| limit.filter(|&l| l != 0.0))
        .collect();
    known?.into_iter().max_by(f64::total_cmp)
}

/// 1 − (mean overspeed · number of steps' worth of time) / (2.23 m/s · duration), not below 0.
fn score(over: &[f64], times: &[i64]) -> f64 {
    let (Some(first), Some(last)) = (times.first(), times.last()) else {
        return 1.0;
    };
    let duration = (last - first) as f64 / MICROS_PER_SECOND;
    if duration <= 0.0 || over.iter().all(|&o| o <= 0.0) {
        return 1.0;
    }
    let step = duration / (times.len() - 1) as f64;
    (1.0 - over.iter().sum::<f64>() * step / (MAX_OVERSPEED * duration)).max(0.0)
}

/// Consecutive samples above the limit.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Violation {
    /// From its first sample to the first sample after it, or the last of the simulation, seconds.
    duration: f64,
    /// Largest overspeed, m/s.
    extremum: f64,
    /// Mean overspeed, m/s.
    mean: f64,
}

fn violations(over: &[f64], times: &[i64]) -> Vec<Violation> {
    let mut found = Vec::new();
    let mut i = 0;
    while i < over.len() {
        if over[i] <= 0.0 {
            i += 1;
            continue;
        }
        let length = over[i..].iter().take_while(|&&o| o > 0.0).count();
        let end = (i + length).min(over.len() - 1);
        let depths = &over[i..i + length];
        found.push(Violation {
            duration: (times[end] - times[i]) as f64 / MICROS_PER_SECOND,
            extremum: depths.iter().copied().fold(0.0, f64::max),
            mean: depths.iter().sum::<f64>() / length as f64,
        });
        i += length;
    }
    found
}

/// Number and size of the violations, then whether there is none.
fn statistics(name: &str, violations: &[Violation]) -> Vec<Statistic> {
    let mut statistics = Vec::new();
    if !violations.is_empty() {
        statistics.push(Statistic::count(
            format!("number_of_violations_of_{name}"),
            violations.len(),
        ));
        let unit = "meters_per_second";
        let extrema = || violations.iter().map(|v| v.extremum);
        let durations: f64 = violations.iter().map(|v| v.duration).sum();
        // A single violation at the last sample has no duration, and then nuPlan has no mean (NaN).
        let mean = violations.iter().map(|v| v.mean * v.duration).sum::<f64>() / durations;
        let (max, min) = (
            extrema().fold(f64::NEG_INFINITY, f64::max),
            extrema().fold(f64::INFINITY, f64::min),
        );
        statistics.extend([
            Statistic::new(
                StatisticKind::Max,
                format!("max_violation_of_{name}"),
                unit,
                max,
            ),
            Statistic::new(
                StatisticKind::Min,
                format!("min_violation_of_{name}"),
                unit,
                min,
            ),
            Statistic::new(
                StatisticKind::Mean,
                format!("mean_violation_of_{name}"),
                unit,
                mean,
            ),
        ]);
    }
    statistics.push(Statistic::boolean(name, violations.is_empty()));
    statistics
}
