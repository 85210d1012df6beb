//! The lane in which the route's goal lies, seen from the ego's.

use super::Centerline;
use crate::world::{LaneId, LaneMap, LanePath, RoadblockId, SceneView};

/// A goal further ahead is not reported, meters: there is time to change lanes later.
pub const GOAL_REACH: f64 = 400.0;
/// Lane changes to one side after which the goal's lane is not looked for any more.
const MAX_CHANGES: usize = 8;

/// The way to the goal's lane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GoalLane {
    /// Lane changes from the ego's lane to the goal's, positive to the left; 0 on it.
    pub changes: i32,
    /// From the ego's center to the goal along the lane, meters.
    pub distance: f64,
}

impl GoalLane {
    /// Seen from the ego's centerline. `None` where the route has no lane of a goal, the goal lies behind or beyond
    /// [`GOAL_REACH`], or the ego's lane leads past its roadblock.
    pub(super) fn find(scene: &SceneView<'_>, ego: &Centerline) -> Option<Self> {
        let (map, goal_lane) = (scene.map, scene.route.goal_lane?);
        let goal = scene.route.goal?.position();
        let lane = ego.path.lane_at(ego.ego_s);
        let from = ego.ego_s - ego.path.starts.get(ego.path.lanes.iter().position(|&on| on == lane)?)?;
        let onward = LanePath::along(map, scene.route, lane, from + GOAL_REACH);
        let block = map[goal_lane].roadblock;
        let (beside, start) = in_roadblock(map, &onward, block)?;
        let distance = start + map[beside].centerline.project(goal).s - from;
        let changes = changes(map, beside, goal_lane)?;
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

/// The first lane of a path in a roadblock, and where it begins on the path.
fn in_roadblock(map: &LaneMap, path: &LanePath, block: RoadblockId) -> Option<(LaneId, f64)> {
    let mut lanes = path.lanes.iter().copied().zip(path.starts.iter().copied());
    lanes.find(|&(lane, _)| map[lane].roadblock == block)
}

/// Changes from a lane to another beside it, positive to the left.
fn changes(map: &LaneMap, from: LaneId, to: LaneId) -> Option<i32> {
    let left = |lane: LaneId| map[lane].left.last().map(|neighbor| neighbor.lane);
    let right = |lane: LaneId| map[lane].right.last().map(|neighbor| neighbor.lane);
    let steps = |next: &dyn Fn(LaneId) -> Option<LaneId>| {
        let row = std::iter::successors(Some(from), |&lane| next(lane)).take(MAX_CHANGES + 1);
        row.zip(0..).find(|&(lane, _)| lane == to).map(|(_, steps)| steps)
    };
    steps(&left).or_else(|| steps(&right).map(|steps: i32| -steps))
}
