//! `ego_progress_along_expert_route`: how far the ego came along the expert's route, beside how far the expert came.

use super::route::driven_route;
use super::{MetricName, MetricResult, Statistic, StatisticKind, TimeSeries};
use crate::geometry::{Point, Polyline, Pose};
use crate::world::{EgoState, LaneId, LaneMap, RoadblockId};

/// Distances below this count as this much, metres. The devkit's documentation says 0.1; its configuration, which
/// decides, 2.
pub const SCORE_PROGRESS: f64 = 2.0;

/// A roadblock of the expert's route with the centreline along which progress in it is measured.
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
    /// The chain of roadblocks that a path drove through; empty when it never was in a lane.
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

    /// Progress at each point since the one before it, metres; 0 for the first and off the route.
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

    /// The next stage after `current` that holds the point, and the metres of the stages skipped on the way there.
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

/// The score: 0 when the ego went back by more than 2 m, else the ratio of the distances, each held at 2 m or above, at
/// most 1.
pub fn progress_ratio(ego_total: f64, expert_total: f64) -> f64 {
    if ego_total < -SCORE_PROGRESS {
        0.0
    } else {
        (ego_total.max(SCORE_PROGRESS) / expert_total.max(SCORE_PROGRESS)).min(1.0)
    }
}

/// Scores the progress of a drive. Without an expert route the score is 1.
pub fn ego_progress_along_expert_route(map: &LaneMap, states: &[EgoState], expert: &[EgoState]) -> MetricResult {
    let metric = MetricName::EgoProgressAlongExpertRoute;
    let expert_centers: Vec<Pose> = expert.iter().map(EgoState::center).collect();
    let route = RouteProgress::along(map, &expert_centers);
    let value = |name: &str, value| Statistic::new(StatisticKind::Value, name, "meters", value);
    let ratio = |value| Statistic::new(StatisticKind::Ratio, "ego_expert_progress_along_route_ratio", "ratio", value);
    if route.is_empty() {
        let statistics = vec![value("expert_total_progress_along_route", 0.0), ratio(1.0)];
        // Here nuPlan forgets to pass the unit on.
        return MetricResult { score_unit: None, ..MetricResult::scored(metric, 1.0, statistics) };
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
    MetricResult::scored(metric, score, statistics).with_series(TimeSeries::of_states("meters", states, progress))
}
