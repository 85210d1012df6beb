//! The reference path: the repaired route, the centerline and the three paths, chosen once.

use super::centerline::{centerline_poses, lane_chain};
use super::current_lane::current_lane;
use super::proposals::LATERAL_OFFSETS;
use super::route::corrected_route;
use super::{DrivableLayers, PdmPath};
use planagent_world::geometry::{GeometryError, Pose};
use planagent_world::{EgoState, LaneId, LaneMap, RoadblockId, Route};
use std::collections::BTreeSet;

/// Why PDM-Closed has no reference path.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the message of a variant says what it is")]
pub enum NoReferencePath {
    #[error("the route has no lanes")]
    EmptyRoute,
    #[error("the centerline of the route makes no path")]
    Path(#[from] GeometryError),
}

/// The path that PDM-Closed follows: chosen at the first iteration and kept.
#[derive(Debug, Clone, PartialEq)]
pub struct ReferencePath {
    lanes: Vec<LaneId>,
    lane_set: BTreeSet<LaneId>,
    layers: DrivableLayers,
    /// One for each lateral offset; the first is the centerline.
    paths: [PdmPath; LATERAL_OFFSETS.len()],
}

impl ReferencePath {
    /// The reference path of an ego on a route: the route is repaired, and the cheapest chain of
    /// lanes starts at the lane under the ego.
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

    /// The reference path of an ego along a given centerline (rear-axle poses, map frame) on a
    /// given route.
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
        let layers = DrivableLayers::from_map(map, &lane_set, ego.center().position());
        let [_, right, left] = LATERAL_OFFSETS;
        let (right, left) = (center.offset(right)?, center.offset(left)?);
        Ok(Self {
            lanes,
            lane_set,
            layers,
            paths: [center, right, left],
        })
    }

    /// The lanes of the route, in its order.
    pub fn lanes(&self) -> &[LaneId] {
        &self.lanes
    }

    /// The lanes of the route, by id.
    pub(crate) fn lane_set(&self) -> &BTreeSet<LaneId> {
        &self.lane_set
    }

    /// The layers that count as drivable.
    pub fn layers(&self) -> DrivableLayers {
        self.layers
    }

    /// The line along which progress is measured.
    pub fn centerline(&self) -> &PdmPath {
        &self.paths[0]
    }

    /// The paths of the proposals, one for each lateral offset.
    pub fn paths(&self) -> &[PdmPath; LATERAL_OFFSETS.len()] {
        &self.paths
    }

    /// Speed limit of the ego's present lane, m/s; `None` when it has none.
    pub fn speed_limit(&self, map: &LaneMap, ego: &EgoState) -> Option<f64> {
        map[current_lane(map, &self.lanes, ego)?].speed_limit
    }
}

fn lanes_of(map: &LaneMap, route: &[RoadblockId]) -> Vec<LaneId> {
    route
        .iter()
        .flat_map(|&block| map[block].lanes.iter().copied())
        .collect()
}
