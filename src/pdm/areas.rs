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
