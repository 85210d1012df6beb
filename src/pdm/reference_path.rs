//! What PDM-Closed decides once: the repaired route, the centreline and the three paths.

use super::centerline::{centerline_poses, lane_chain};
use super::current_lane::current_lane;
use super::proposals::LATERAL_OFFSETS;
use super::route::corrected_route;
use super::{DrivableLayers, PdmPath};
use crate::geometry::{GeometryError, Pose};
use crate::world::{EgoState, LaneId, LaneMap, RoadblockId, Route};
use std::collections::BTreeSet;

/// Why PDM-Closed has no way to drive.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NoReferencePath {
    /// The route holds no lane.
    #[error("the route has no lanes")]
    EmptyRoute,
    /// The centreline, or a path beside it, makes no line.
    #[error("the centreline of the route makes no path")]
    Path(#[from] GeometryError),
}

/// The way that PDM-Closed drives: chosen at the first iteration and kept.
#[derive(Debug, Clone, PartialEq)]
pub struct ReferencePath {
    lanes: Vec<LaneId>,
    lane_set: BTreeSet<LaneId>,
    layers: DrivableLayers,
    /// One a lateral offset; the first is the centreline.
    paths: [PdmPath; LATERAL_OFFSETS.len()],
}

impl ReferencePath {
    /// The way of an ego along a route: the route repaired, the lane under the ego, and the cheapest chain of lanes from
    /// there on.
    ///
    /// # Errors
    /// When the route has no lanes or they make no line.
    pub fn find(map: &LaneMap, route: &Route, ego: &EgoState) -> Result<Self, NoReferencePath> {
        let blocks = corrected_route(map, &route.roadblocks, ego.rear_axle);
        let lanes = lanes_of(map, &blocks);
        let start = current_lane(map, &lanes, ego).ok_or(NoReferencePath::EmptyRoute)?;
        let chain = lane_chain(map, &blocks, &lanes, start);
        Self::along(map, &blocks, &centerline_poses(map, &chain), ego)
    }

    /// The way of an ego along a given centreline (rear-axle poses, map frame) on a given route.
    ///
    /// # Errors
    /// When the poses make no line.
    pub fn along(
        map: &LaneMap,
        route: &[RoadblockId],
        centerline: &[Pose],
        ego: &EgoState,
    ) -> Result<Self, NoReferencePath> {
        let lanes = lanes_of(map, route);
        let lane_set: BTreeSet<LaneId> = lanes.iter().copied().collect();
        let center = PdmPath::new(centerline)?;
        let layers = DrivableLayers::of(map, &lane_set, ego.center().position());
        let [_, right, left] = LATERAL_OFFSETS;
        let (right, left) = (center.offset(right)?, center.offset(left)?);
        Ok(Self { lanes, lane_set, layers, paths: [center, right, left] })
    }

    /// The lanes of the route, in its order.
    pub fn lanes(&self) -> &[LaneId] {
        &self.lanes
    }

    /// The lanes of the route, by id.
    pub fn lane_set(&self) -> &BTreeSet<LaneId> {
        &self.lane_set
    }

    /// What counts as drivable along this way.
    pub fn layers(&self) -> DrivableLayers {
        self.layers
    }

    /// The line along which progress is measured.
    pub fn centerline(&self) -> &PdmPath {
        &self.paths[0]
    }

    /// The paths of the proposals, one a lateral offset.
    pub fn paths(&self) -> &[PdmPath; LATERAL_OFFSETS.len()] {
        &self.paths
    }

    /// Speed limit of the lane that the ego is on now, m/s; `None` when it has none.
    pub fn speed_limit(&self, map: &LaneMap, ego: &EgoState) -> Option<f64> {
        map[current_lane(map, &self.lanes, ego)?].speed_limit
    }
}

fn lanes_of(map: &LaneMap, route: &[RoadblockId]) -> Vec<LaneId> {
    route.iter().flat_map(|&block| map[block].lanes.iter().copied()).collect()
}
