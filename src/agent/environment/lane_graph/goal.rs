//! The lane in which the route's goal lies, seen from the ego's.

use super::ego_lane::ego_lane;
use planagent_world::geometry::Pose;
use planagent_world::{LaneId, LanePath, SceneView};

/// A goal further ahead is not reported, meters: there is time to change lanes later.
/// Why: docs/decisions/116-goal-lane.md.
pub(crate) const GOAL_REACH: f64 = 400.0;
/// Lane changes to one side after which the goal's lane is not looked for any more.
const MAX_CHANGES: i32 = 8;

/// The way to the goal's lane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GoalLane {
    /// Lane changes from the ego's lane to the goal's, positive to the left; 0 on it.
    pub changes: i32,
    /// From the ego's rear axle to the goal's along the lane, meters; negative behind the goal.
    pub distance: f64,
}

impl GoalLane {
    /// Seen from the lane that holds the ego.
    pub fn from_scene(scene: &SceneView<'_>) -> Option<Self> {
        Self::from_lane(scene, ego_lane(scene)?)
    }

    /// Seen from a lane. Where that does not lead to the goal's roadblock, the changes are at least
    /// those to the nearest lane beside that does. `None` where the route has no lane of a goal, or
    /// no lane beside leads there within [`GOAL_REACH`].
    pub(super) fn from_lane(scene: &SceneView<'_>, lane: LaneId) -> Option<Self> {
        let (goal_lane, goal) = (scene.route.goal_lane?, scene.route.goal?);
        nearest_first().find_map(|first| {
            let (beside, _) = scene
                .map
                .beside(lane, scene.ego.rear_axle.position(), first)?;
            let (entered, distance) = path_to_goal(scene, beside, goal_lane, goal)?;
            let reaches = |&then: &i32| {
                scene
                    .map
                    .beside(entered, goal.position(), then)
                    .is_some_and(|(found, _)| found == goal_lane)
            };
            let then = nearest_first().find(reaches)?;
            let changes = match first {
                0 => then,
                1.. => first.max(first + then),
                _ => first.min(first + then),
            };
            Some(Self { changes, distance })
        })
    }

    /// Whether it lies ahead, within [`GOAL_REACH`].
    pub(super) fn is_ahead(&self) -> bool {
        (0.0..=GOAL_REACH).contains(&self.distance)
    }

    /// Lane changes that are left after a change in this direction: 1 to the left, -1 to the right.
    pub fn left_after(self, direction: i32) -> u32 {
        (self.changes - direction).unsigned_abs()
    }

    /// Whether a change in this direction leads towards the goal's lane.
    pub fn is_towards(self, direction: i32) -> bool {
        self.changes * direction > 0
    }
}

/// Where the way along a lane enters the goal's roadblock, and the meters from the ego's rear axle
/// to the goal. `None` where it does not.
fn path_to_goal(
    scene: &SceneView<'_>,
    lane: LaneId,
    goal_lane: LaneId,
    goal: Pose,
) -> Option<(LaneId, f64)> {
    let map = scene.map;
    let from = map[lane]
        .centerline
        .project(scene.ego.rear_axle.position())
        .s;
    let path = LanePath::along(map, scene.route, lane, from + GOAL_REACH);
    let mut lanes = path.lanes.iter().copied().zip(path.starts.iter().copied());
    let (entered, start) = lanes.find(|&(on, _)| map[on].roadblock == map[goal_lane].roadblock)?;
    Some((
        entered,
        start + map[entered].centerline.project(goal.position()).s - from,
    ))
}

/// Numbers of changes that are tried.
pub(super) fn nearest_first() -> impl Iterator<Item = i32> {
    std::iter::once(0).chain((1..=MAX_CHANGES).flat_map(|count| [count, -count]))
}
