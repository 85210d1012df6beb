//! Progress along the expert's route (devkit `ego_progress_along_expert_route.py`).

use super::route::driven_route;
use planagent_world::geometry::{Point, Polyline, Pose};
use planagent_world::{EgoState, LaneId, LaneMap, RoadblockId};

/// Shorter distances count as this, meters. The devkit's documentation says 0.1; its configuration,
/// which decides, 2.
pub(crate) const SCORE_PROGRESS: f64 = 2.0;

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
            let stage = Stage {
                roadblock: map[lane].roadblock,
                baseline: &map[lane].centerline,
            };
            if stages
                .last()
                .is_none_or(|last| last.roadblock != stage.roadblock)
            {
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

    /// The next stage after `current` that contains the point, and the meters of the skipped
    /// stages.
    fn entered(&self, current: usize, point: Point) -> Option<(usize, f64)> {
        let mut skipped = 0.0;
        for (i, stage) in self.stages.iter().enumerate().skip(current + 1) {
            if self.map.roadblock_holds(stage.roadblock, point) {
                return Some((i, skipped));
            }
            let (before, after) = (
                self.stages[i - 1].baseline,
                self.stages.get(i + 1)?.baseline,
            );
            skipped +=
                stage.baseline.project(after.start()).s - stage.baseline.project(before.end()).s;
        }
        None
    }
}

/// The first lane of each part of a route; a part ends where no lane is shared with the part's
/// first sample.
fn simplified(route: &[Vec<LaneId>]) -> Vec<LaneId> {
    let mut parts: Vec<&Vec<LaneId>> = Vec::new();
    for lanes in route.iter().filter(|lanes| !lanes.is_empty()) {
        if parts
            .last()
            .is_none_or(|last| !last.iter().any(|id| lanes.contains(id)))
        {
            parts.push(lanes);
        }
    }
    parts
        .into_iter()
        .filter_map(|lanes| lanes.first().copied())
        .collect()
}

/// 0 when the ego moved back by more than 2 m, else the ratio of the distances, each at least 2 m;
/// at most 1.
pub fn progress_ratio(ego_total: f64, expert_total: f64) -> f64 {
    if ego_total < -SCORE_PROGRESS {
        0.0
    } else {
        (ego_total.max(SCORE_PROGRESS) / expert_total.max(SCORE_PROGRESS)).min(1.0)
    }
}

/// The progress of the ego and of the expert along the expert's route, meters.
#[derive(Debug)]
pub(super) struct Progress {
    /// Of the ego at each sample.
    pub(super) per_frame: Vec<f64>,
    pub(super) ego_total: f64,
    pub(super) expert_total: f64,
}

impl Progress {
    /// The progress; `None` without an expert route.
    pub(super) fn from_states(
        map: &LaneMap,
        states: &[EgoState],
        expert: &[EgoState],
    ) -> Option<Self> {
        let expert_centers: Vec<Pose> = expert.iter().map(EgoState::center).collect();
        let route = RouteProgress::along(map, &expert_centers);
        if route.is_empty() {
            return None;
        }
        let centers: Vec<Point> = states.iter().map(|s| s.center().position()).collect();
        let expert_points: Vec<Point> = expert_centers.iter().map(Pose::position).collect();
        let per_frame = route.per_frame(&centers);
        let ego_total = per_frame.iter().sum();
        let expert_total = route.per_frame(&expert_points).iter().sum();
        Some(Self {
            per_frame,
            ego_total,
            expert_total,
        })
    }

    /// The [`progress_ratio`].
    pub(super) fn ratio(&self) -> f64 {
        progress_ratio(self.ego_total, self.expert_total)
    }
}
