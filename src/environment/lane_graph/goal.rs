//! The lane in which the route's goal lies, seen from the ego's.

use super::Centerline;
use crate::geometry::Pose;
use crate::world::{LaneId, LaneMap, LanePath, SceneView};

/// A goal further ahead is not reported, meters: there is time to change lanes later.
pub const GOAL_REACH: f64 = 400.0;
/// Lane changes to one side after which the goal's lane is not looked for any more.
const MAX_CHANGES: i32 = 8;

/// The way to the goal's lane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GoalLane {
    /// Lane changes from the ego's lane to the goal's, positive to the left; 0 on it.
    pub changes: i32,
    /// From the ego's center to the goal along the lane, meters.
    pub distance: f64,
}

impl GoalLane {
    /// Seen from the ego's centerline. Where its lane leads past the goal's roadblock, the changes are at least those to the nearest
    /// lane beside that leads there. `None` where the route has no lane of a goal, no lane beside leads there, or the goal lies
    /// behind or beyond [`GOAL_REACH`].
    pub(super) fn find(scene: &SceneView<'_>, ego: &Centerline) -> Option<Self> {
        let (goal_lane, goal) = (scene.route.goal_lane?, scene.route.goal?);
        let lane = ego.path.lane_at(ego.ego_s);
        let found = nearest_first().find_map(|first| {
            let (entered, distance) = way_to_goal(scene, beside(scene.map, lane, first)?, goal_lane, goal)?;
            Some((first, changes(scene.map, entered, goal_lane)?, distance))
        });
        let (first, then, distance) = found?;
        let changes = match first {
            0 => then,
            1.. => first.max(first + then),
            _ => first.min(first + then),
        };
        (0.0..=GOAL_REACH).contains(&distance).then_some(Self { changes, distance })
    }

    /// Lane changes that are left after a change in this direction: 1 to the left, -1 to the right.
    pub fn left_after(self, direction: i32) -> u32 {
        (self.changes - direction).unsigned_abs()
    }

    /// Whether a change in this direction leads towards the goal's lane.
    pub fn is_towards(self, direction: i32) -> bool {
        self.changes.signum() == direction && direction != 0
    }
}

/// Where the way along a lane enters the goal's roadblock, and the meters from beside the ego to the goal. `None` where it does not.
fn way_to_goal(scene: &SceneView<'_>, lane: LaneId, goal_lane: LaneId, goal: Pose) -> Option<(LaneId, f64)> {
    let map = scene.map;
    let from = map[lane].centerline.project(scene.ego.center().position()).s;
    let path = LanePath::along(map, scene.route, lane, from + GOAL_REACH);
    let mut lanes = path.lanes.iter().copied().zip(path.starts.iter().copied());
    let (entered, start) = lanes.find(|&(on, _)| map[on].roadblock == map[goal_lane].roadblock)?;
    Some((entered, start + map[entered].centerline.project(goal.position()).s - from))
}

/// The lane so many changes beside another, positive to the left.
fn beside(map: &LaneMap, from: LaneId, changes: i32) -> Option<LaneId> {
    (0..changes.abs()).try_fold(from, |lane, _| {
        let side = if changes > 0 { &map[lane].left } else { &map[lane].right };
        side.last().map(|neighbor| neighbor.lane)
    })
}

/// Changes from a lane to another beside it, positive to the left.
fn changes(map: &LaneMap, from: LaneId, to: LaneId) -> Option<i32> {
    nearest_first().find(|&count| beside(map, from, count) == Some(to))
}

/// Numbers of changes that are tried.
fn nearest_first() -> impl Iterator<Item = i32> {
    std::iter::once(0).chain((1..=MAX_CHANGES).flat_map(|count| [count, -count]))
}
