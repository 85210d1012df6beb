//! The input of a planner at one instant.

use super::{EgoState, History, LaneId, LaneMap, RoadblockId, TrackedObject, TrafficLights};
use crate::geometry::Pose;
use std::collections::BTreeSet;

/// The route that the ego shall follow.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct Route {
    /// The chain of roadblocks, from the start on.
    pub roadblocks: Vec<RoadblockId>,
    /// nuPlan's mission goal: the end of the recording; `None` when unknown.
    pub goal: Option<Pose>,
    /// The lane that holds the goal, where the score asks for it: in a modified scenario with a
    /// goal.
    pub goal_lane: Option<LaneId>,
}

impl Route {
    /// All lanes and connectors of the route's roadblocks.
    pub fn lanes(&self, map: &LaneMap) -> BTreeSet<LaneId> {
        self.roadblocks
            .iter()
            .flat_map(|&block| map[block].lanes.iter().copied())
            .collect()
    }

    /// Whether a roadblock belongs to the route.
    #[inline]
    pub fn contains(&self, block: RoadblockId) -> bool {
        self.roadblocks.contains(&block)
    }
}

/// The present and the recent past. It holds no future.
#[derive(Debug, Clone, Copy)]
pub struct SceneView<'a> {
    /// The static map.
    pub map: &'a LaneMap,
    /// The route.
    pub route: &'a Route,
    /// The ego now.
    pub ego: &'a EgoState,
    /// Objects now.
    pub objects: &'a [TrackedObject],
    /// Traffic lights now.
    pub lights: &'a TrafficLights,
    /// The last two seconds, the present included as the newest sample.
    pub history: &'a History,
}
