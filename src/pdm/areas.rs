//! Where the ego is: in several lanes, off the drivable area, off the route (`tuplan_garage` `pdm_scorer.py`,
//! `_calculate_ego_area`, and `pdm_observation_utils.py`, `get_drivable_area_map`).

use crate::geometry::{Bounds, Point, Polygon, SpatialIndex};
use crate::world::{EgoState, LaneId, LaneMap};
use std::collections::BTreeSet;

/// Half size of the square around the ego whose roadblocks make the map, metres.
pub const MAP_RADIUS: f64 = 50.0;

/// Which layers a corner may stand on without being off the drivable area.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DrivableLayers {
    /// Lanes, connectors and car parks: PDM's choice, made for maps whose lanes tile the road.
    Lanes,
    /// Also whatever nuPlan's drivable area holds: roadblocks, intersections, generic drivable areas. For maps derived
    /// from recordings, whose lane polygons leave gaps.
    DrivableArea,
}

/// Distance between the places along a lane at which it is looked whether lanes tile the road, metres.
const TILING_STEP: f64 = 5.0;
/// Distance between the points that are looked at there, across the lane, metres.
const TILING_WIDTH_STEP: f64 = 0.25;
/// Lanes tile the road when so great a share of the points lies on lanes.
const TILING_SHARE: f64 = 0.98;

impl DrivableLayers {
    /// The layers for a map, by how its lanes lie along a route: [`Self::Lanes`] where they tile the road. Looked at are
    /// points from each lane of the route across to the middle of its neighbours, every 5 m, and to the first pose of its
    /// successors; at least 98 % must lie on some lane.
    pub fn of(map: &LaneMap, route_lanes: &BTreeSet<LaneId>) -> Self {
        let (mut on_lanes, mut all) = (0usize, 0usize);
        for (from, to) in route_lanes.iter().flat_map(|&lane| crossings(map, lane)) {
            let steps = ((to - from).norm() / TILING_WIDTH_STEP).ceil().max(1.0) as usize;
            for step in 0..=steps {
                let point = from + (to - from) * (step as f64 / steps as f64);
                on_lanes += usize::from(!map.lanes_at(point).is_empty());
                all += 1;
            }
        }
        if on_lanes as f64 >= TILING_SHARE * all as f64 { Self::Lanes } else { Self::DrivableArea }
    }
}

/// Ways across the borders of a lane: to the middle of its neighbours and into its successors.
fn crossings(map: &LaneMap, lane: LaneId) -> Vec<(Point, Point)> {
    let lane = &map[lane];
    let line = &lane.centerline;
    let beside = (0..=(line.length() / TILING_STEP) as usize).flat_map(|i| {
        let s = i as f64 * TILING_STEP;
        let here = line.point_at(s);
        let neighbors = lane.left_at(s).into_iter().chain(lane.right_at(s));
        neighbors.map(move |other| (here, map[other].centerline.project(here).point))
    });
    let onward = lane.outgoing.iter().flat_map(|&next| {
        let (end, start) = (line.pose_at(line.length()), map[next].centerline.pose_at(0.0));
        [-1.0, 0.0, 1.0].map(|left| (end.translated(-1.0, left).position(), start.translated(1.0, left).position()))
    });
    beside.chain(onward).collect()
}

/// Where the ego is at one instant.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct EgoAreas {
    /// Several polygons hold a corner and none holds all four.
    pub multiple_lanes: bool,
    /// At least one corner is off the drivable area.
    pub non_drivable: bool,
    /// The centre is in no lane of the route.
    pub oncoming: bool,
}

impl EgoAreas {
    /// Whether a lateral collision here is the ego's fault.
    pub fn in_multiple_lanes_or_off_road(self) -> bool {
        self.multiple_lanes || self.non_drivable
    }
}

struct Area<'a> {
    polygon: &'a Polygon,
    on_route: bool,
}

/// The drivable polygons around the ego.
pub struct DrivableMap<'a> {
    map: &'a LaneMap,
    areas: Vec<Area<'a>>,
    index: SpatialIndex,
    layers: DrivableLayers,
}

impl<'a> DrivableMap<'a> {
    /// All lanes and connectors of the roadblocks that meet the square of [`MAP_RADIUS`] around `center` (the centre of
    /// the ego), and the car parks there.
    pub fn around(map: &'a LaneMap, route_lanes: &BTreeSet<LaneId>, center: Point, layers: DrivableLayers) -> Self {
        let blocks: BTreeSet<_> =
            map.lanes_near(center, MAP_RADIUS).into_iter().map(|lane| map[lane].roadblock).collect();
        let lanes: BTreeSet<LaneId> = blocks.iter().flat_map(|&block| map[block].lanes.iter().copied()).collect();
        let patch = Bounds::square(center, MAP_RADIUS);
        let carparks = map.carparks_within(&patch);
        let areas: Vec<Area<'a>> = lanes
            .into_iter()
            .map(|id| Area { polygon: &map[id].polygon, on_route: route_lanes.contains(&id) })
            .chain(carparks.map(|polygon| Area { polygon, on_route: false }))
            .collect();
        let index = SpatialIndex::new(areas.iter().map(|area| area.polygon.bounds()));
        Self { map, areas, index, layers }
    }

    /// The map that it was taken from.
    pub fn map(&self) -> &'a LaneMap {
        self.map
    }

    /// Where the ego is.
    pub fn areas_of(&self, ego: &EgoState) -> EgoAreas {
        let shape = ego.footprint();
        let corners = shape.corners();
        let (mut covered, mut holders, mut whole) = ([false; 4], 0, false);
        let mut on_route = false;
        for area in self.index.within(&shape.bounds()).into_iter().map(|i| &self.areas[i]) {
            let inside = corners.map(|corner| area.polygon.contains(corner));
            holders += usize::from(inside.contains(&true));
            whole |= inside == [true; 4];
            for (covered, inside) in covered.iter_mut().zip(inside) {
                *covered |= inside;
            }
            on_route |= area.on_route && area.polygon.contains(shape.center.position());
        }
        let off = |(corner, covered): (&Point, bool)| {
            !covered && (self.layers == DrivableLayers::Lanes || !self.map.is_drivable(*corner))
        };
        EgoAreas {
            multiple_lanes: holders > 1 && !whole,
            non_drivable: corners.iter().zip(covered).any(off),
            oncoming: !on_route,
        }
    }
}
