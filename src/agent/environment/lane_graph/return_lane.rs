//! The lane that the ego left to pass what blocks it.

use super::goal::{GoalLane, nearest_first};
use super::{GraphedScene, LaneGraph};
use planagent_world::{LaneId, LanePath, PACIFICA, SceneView};

/// The lane that the ego left to pass what blocks it. Past that, it becomes the goal's lane where
/// the route has none.
/// Why: docs/decisions/123-way-back.md.
#[derive(Debug, Clone, PartialEq)]
pub struct ReturnLane {
    path: LanePath,
    /// Where the ego's rear axle is past what blocks the lane; arc length on the path, meters.
    clear_s: f64,
}

impl ReturnLane {
    /// The ego's lane; `None` where nothing blocks it.
    pub fn from_graph(graph: &LaneGraph) -> Option<Self> {
        let blocked = graph.blocked?;
        Some(Self {
            path: graph.ego_lane().path.clone(),
            clear_s: blocked.to_s + PACIFICA.rear_length,
        })
    }

    /// Whether the ego has passed what blocked the lane, and is back in it.
    pub fn is_reached(&self, seen: GraphedScene<'_>) -> bool {
        self.ahead(seen.scene).is_some() && self.path.lanes.contains(&ego_lane(seen.graph))
    }

    /// The lane as a goal at the end of the known path; `None` before the ego is past what blocks
    /// the lane, in the lane, and where no lane beside is of the path.
    pub(super) fn as_goal(&self, scene: &SceneView<'_>, graph: &LaneGraph) -> Option<GoalLane> {
        let distance = self.ahead(scene)?;
        let (here, from) = (ego_lane(graph), scene.ego.rear_axle.position());
        let leads_there = |&changes: &i32| {
            scene
                .map
                .beside(here, from, changes)
                .is_some_and(|(lane, _)| self.path.lanes.contains(&lane))
        };
        let changes = nearest_first()
            .find(leads_there)
            .filter(|&changes| changes != 0)?;
        Some(GoalLane { changes, distance })
    }

    /// From the ego's rear axle to the end of the path, meters; `None` before the ego is past what
    /// blocks the lane, and at the end.
    fn ahead(&self, scene: &SceneView<'_>) -> Option<f64> {
        let line = &self.path.centerline;
        let here = line.project(scene.ego.rear_axle.position()).s;
        (here >= self.clear_s && here < line.length()).then(|| line.length() - here)
    }
}

fn ego_lane(graph: &LaneGraph) -> LaneId {
    let own = graph.ego_lane();
    own.path.lane_at(own.ego_s)
}
