//! `ego_progress_along_expert_route`: the ego's progress along the expert's route relative to the expert's; and
//! `ego_is_making_progress`, which requires a fifth of it.

use super::route::driven_route;
use super::{MetricList, MetricResult, MetricSpec, Statistic, StatisticKind, TimeSeries};
use crate::geometry::{Point, Polyline, Pose};
use crate::world::{EgoState, LaneId, LaneMap, RoadblockId};

/// Shorter distances count as this, meters. The devkit's documentation says 0.1; its configuration, which decides, 2.
pub const SCORE_PROGRESS: f64 = 2.0;
/// Least ratio for `ego_is_making_progress` (devkit `ego_is_making_progress_statistics.yaml`).
pub const MIN_PROGRESS_RATIO: f64 = 0.2;

pub(super) const SPEC: MetricSpec =
    MetricSpec::new("ego_progress_along_expert_route", |input| Ok(Some(input.progress().clone())))
        .only(MetricList::ClosedLoop)
        .weight(5.0)
        .label("prog");
pub(super) const MAKING_PROGRESS: MetricSpec = MetricSpec::new("ego_is_making_progress", |input| {
    Ok(Some(ego_is_making_progress(input.progress().score.unwrap_or(0.0))))
})
.only(MetricList::ClosedLoop)
.multiplier()
.truth_value()
.label("moves");

/// 1 when the ratio of `ego_progress_along_expert_route` is at least [`MIN_PROGRESS_RATIO`], else 0.
pub fn ego_is_making_progress(progress_ratio: f64) -> MetricResult {
    MAKING_PROGRESS.judged(progress_ratio >= MIN_PROGRESS_RATIO, vec![])
}

/// A roadblock of the expert's route with the centerline along which progress is measured.
#[derive(Debug, Clone, Copy)]
struct Stage<'a> {
    roadblock: RoadblockId,
    baseline: &'a Polyline,
}

/// The expert's route as a chain of roadblocks, and progress along it.
#[derive(Debug, Clone)]
pub struct RouteProgress<'a> {
    map: &'a LaneMap,
    stages: Vec<Stage<'a>>,
}

impl<'a> RouteProgress<'a> {
    /// The roadblocks along a path; empty when the path is in no lane.
    pub fn along(map: &'a LaneMap, centers: &[Pose]) -> Self {
        let mut stages: Vec<Stage<'a>> = Vec::new();
        for lane in simplified(&driven_route(map, centers)) {
            let stage = Stage { roadblock: map[lane].roadblock, baseline: &map[lane].centerline };
            if stages.last().is_none_or(|last| last.roadblock != stage.roadblock) {
                stages.push(stage);
            }
        }
        Self { map, stages }
    }

    /// Whether there is no route.
    pub fn is_empty(&self) -> bool {
        self.stages.is_empty()
    }

    /// Progress at each point since the previous one, meters; 0 for the first and off the route.
    pub fn per_frame(&self, points: &[Point]) -> Vec<f64> {
        let (Some(head), Some((first, rest))) = (self.stages.first(), points.split_first()) else {
            return vec![0.0; points.len()];
        };
        let mut current = 0;
        let mut before = head.baseline.project(*first).s;
        let mut progress = vec![0.0];
        for &point in rest {
            let stage = self.stages[current];
            if self.map.roadblock_holds(stage.roadblock, point) {
                let s = stage.baseline.project(point).s;
                progress.push(s - before);
                before = s;
            } else if let Some((entered, skipped)) = self.entered(current, point) {
                let next = self.stages[entered];
                let s = next.baseline.project(point).s;
                let joint = next.baseline.project(stage.baseline.end()).s;
                progress.push(stage.baseline.length() - before + s - joint + skipped);
                current = entered;
                before = s;
            } else {
                progress.push(0.0);
            }
        }
        progress
    }

    /// The next stage after `current` that contains the point, and the meters of the skipped stages.
    fn entered(&self, current: usize, point: Point) -> Option<(usize, f64)> {
        let mut skipped = 0.0;
        for (i, stage) in self.stages.iter().enumerate().skip(current + 1) {
            if self.map.roadblock_holds(stage.roadblock, point) {
                return Some((i, skipped));
            }
            let (before, after) = (self.stages[i - 1].baseline, self.stages.get(i + 1)?.baseline);
            skipped += stage.baseline.project(after.start()).s - stage.baseline.project(before.end()).s;
        }
        None
    }
}

/// The first lane of each part of a route; a part ends where no lane is shared with the part's first sample.
fn simplified(route: &[Vec<LaneId>]) -> Vec<LaneId> {
    let mut parts: Vec<&Vec<LaneId>> = Vec::new();
    for lanes in route.iter().filter(|lanes| !lanes.is_empty()) {
        if parts.last().is_none_or(|last| !last.iter().any(|id| lanes.contains(id))) {
            parts.push(lanes);
        }
    }
    parts.into_iter().filter_map(|lanes| lanes.first().copied()).collect()
}

/// 0 when the ego moved back by more than 2 m, else the ratio of the distances, each at least 2 m; at most 1.
pub fn progress_ratio(ego_total: f64, expert_total: f64) -> f64 {
    if ego_total < -SCORE_PROGRESS {
        0.0
    } else {
        (ego_total.max(SCORE_PROGRESS) / expert_total.max(SCORE_PROGRESS)).min(1.0)
    }
}

/// The score is the [`progress_ratio`]; 1 without an expert route.
pub fn ego_progress_along_expert_route(map: &LaneMap, states: &[EgoState], expert: &[EgoState]) -> MetricResult {
    let expert_centers: Vec<Pose> = expert.iter().map(EgoState::center).collect();
    let route = RouteProgress::along(map, &expert_centers);
    let value = |name: &str, value| Statistic::new(StatisticKind::Value, name, "meters", value);
    let ratio = |value| Statistic::new(StatisticKind::Ratio, "ego_expert_progress_along_route_ratio", "ratio", value);
    if route.is_empty() {
        let statistics = vec![value("expert_total_progress_along_route", 0.0), ratio(1.0)];
        // nuPlan passes no unit here.
        return MetricResult { score_unit: None, ..SPEC.scored(1.0, statistics) };
    }
    let centers: Vec<Point> = states.iter().map(|s| s.center().position()).collect();
    let progress = route.per_frame(&centers);
    let ego_total: f64 = progress.iter().sum();
    let expert_points: Vec<Point> = expert_centers.iter().map(Pose::position).collect();
    let expert_total: f64 = route.per_frame(&expert_points).iter().sum();
    let score = progress_ratio(ego_total, expert_total);
    let statistics = vec![
        value("expert_total_progress_along_route", expert_total),
        value("ego_total_progress_along_route", ego_total),
        ratio(score),
    ];
    SPEC.scored(score, statistics).with_series(TimeSeries::of_states("meters", states, progress))
}
