//! `ego_progress_along_expert_route`: the ego's progress along the expert's route relative to the
//! expert's; and `ego_is_making_progress`, which requires a fifth of it.

use super::route_progress::Progress;
use super::{MetricList, MetricResult, MetricSpec, Statistic, StatisticKind, TimeSeries};
use planagent_world::{EgoState, LaneMap};

/// Minimum ratio for `ego_is_making_progress` (devkit `ego_is_making_progress_statistics.yaml`).
pub(crate) const MIN_PROGRESS_RATIO: f64 = 0.2;

pub(super) const SPEC: MetricSpec = MetricSpec::new("ego_progress_along_expert_route", |input| {
    Ok(Some(result(input.states(), input.progress())))
})
.only(MetricList::ClosedLoop)
.weight(5.0)
.label("prog");
pub(super) const MAKING_PROGRESS: MetricSpec = MetricSpec::new("ego_is_making_progress", |input| {
    Ok(Some(ego_is_making_progress(
        input.progress().map_or(1.0, Progress::ratio),
    )))
})
.only(MetricList::ClosedLoop)
.multiplier()
.truth_value()
.label("moves");

/// 1 when the ratio of `ego_progress_along_expert_route` is at least [`MIN_PROGRESS_RATIO`], else
/// 0.
pub fn ego_is_making_progress(progress_ratio: f64) -> MetricResult {
    MAKING_PROGRESS.judged(progress_ratio >= MIN_PROGRESS_RATIO, vec![])
}

/// The score is the [`progress_ratio`](super::progress_ratio); 1 without an expert route.
pub fn ego_progress_along_expert_route(
    map: &LaneMap,
    states: &[EgoState],
    expert: &[EgoState],
) -> MetricResult {
    result(states, Progress::from_states(map, states, expert).as_ref())
}

fn result(states: &[EgoState], progress: Option<&Progress>) -> MetricResult {
    let value = |name: &str, value| Statistic::new(StatisticKind::Value, name, "meters", value);
    let ratio = |value| {
        Statistic::new(
            StatisticKind::Ratio,
            "ego_expert_progress_along_route_ratio",
            "ratio",
            value,
        )
    };
    let Some(progress) = progress else {
        let statistics = vec![value("expert_total_progress_along_route", 0.0), ratio(1.0)];
        // nuPlan passes no unit here.
        return MetricResult {
            score_unit: None,
            ..SPEC.scored(1.0, statistics)
        };
    };
    let statistics = vec![
        value("expert_total_progress_along_route", progress.expert_total),
        value("ego_total_progress_along_route", progress.ego_total),
        ratio(progress.ratio()),
    ];
    let series = TimeSeries::of_states("meters", states, progress.per_frame.clone());
    SPEC.scored(progress.ratio(), statistics)
        .with_series(series)
}
