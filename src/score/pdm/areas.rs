//! The ego area: in several lanes, off the drivable area, off the route (`tuplan_garage`
//! `pdm_scorer.py`, `_calculate_ego_area`, and `pdm_observation_utils.py`,
//! `get_drivable_area_map`).

use super::Placed;
use crate::metrics::MAX_DISTANCE_OUTSIDE;
use planagent_world::geometry::{Bounds, Point, PointLocator, Polygon};
use planagent_world::{EgoState, LaneAreas, LaneId, LaneMap};
use std::collections::BTreeSet;

/// Half size of the square around the ego whose roadblocks make the map, meters.
pub(crate) const MAP_RADIUS: f64 = 50.0;

/// The layers that count as drivable.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize, schemars::JsonSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum DrivableLayers {
    /// Lanes, connectors and car parks: PDM's choice. For nuPlan's maps, and others whose lanes
    /// tile the road.
    Lanes,
    /// All of nuPlan's drivable area: roadblocks, intersections, generic drivable areas. For maps
    /// with derived lane polygons that leave gaps.
    DrivableArea,
}

/// Distance between the tested places along a lane, meters.
const TILING_STEP: f64 = 10.0;
/// Distance between the tested points across the border, meters.
const TILING_WIDTH_STEP: f64 = 0.25;
/// Lanes tile the road when at least this share of the points lies on lanes. Generated maps have
/// 0.996 and more; of eleven maps derived from Waymo's recordings eight have 0.987 and less.
/// Why: docs/decisions/106-drivable-area.md.
const TILING_SHARE: f64 = 0.99;

impl DrivableLayers {
    /// The layers for a map: [`Self::Lanes`] where the source draws the areas of lanes (nuPlan's
    /// maps). Where they are derived, how they lie on a route and within [`MAP_RADIUS`] of the ego
    /// decides: [`Self::Lanes`] if they tile the road. The tested points lie every 10 m along each
    /// lane, from its baseline across to that of its neighbors, and from its end into its
    /// successors. At least 99 % must lie on some lane.
    pub fn from_map(map: &LaneMap, route_lanes: &BTreeSet<LaneId>, center: Point) -> Self {
        if map.lane_areas() == LaneAreas::Drawn {
            return Self::Lanes;
        }
        let near = map.lanes_near(center, MAP_RADIUS);
        let lanes: BTreeSet<LaneId> = route_lanes.iter().copied().chain(near).collect();
        let (mut on_lanes, mut all) = (0usize, 0usize);
        for crossing in lanes.into_iter().flat_map(|lane| crossings(map, lane)) {
            for point in crossing.points() {
                on_lanes += usize::from(crossing.is_on_lane(map, point));
                all += 1;
            }
        }
        if on_lanes as f64 >= TILING_SHARE * all as f64 {
            Self::Lanes
        } else {
            Self::DrivableArea
        }
    }
}

/// A segment over the border of two lanes.
#[derive(Debug, Clone, Copy)]
struct Crossing {
    lanes: [LaneId; 2],
    from: Point,
    to: Point,
}

impl Crossing {
    fn points(self) -> impl Iterator<Item = Point> {
        let segment = self.to - self.from;
        let steps = (segment.norm() / TILING_WIDTH_STEP).ceil().max(1.0) as usize;
        (0..=steps).map(move |step| self.from + segment * (step as f64 / steps as f64))
    }

    fn is_on_lane(self, map: &LaneMap, point: Point) -> bool {
        self.lanes
            .iter()
            .any(|&lane| map[lane].polygon.contains(point))
            || !map.lanes_at(point).is_empty()
    }
}

/// Segments from a lane to the middle of its neighbors and into its successors.
fn crossings(map: &LaneMap, id: LaneId) -> Vec<Crossing> {
    let lane = &map[id];
    let line = &lane.centerline;
    // Places between the steps: the ends themselves lie on an edge.
    let places =
        (0..(line.length() / TILING_STEP).round() as usize).map(|i| (i as f64 + 0.5) * TILING_STEP);
    let beside = places.flat_map(|s| {
        let from = line.point_at(s);
        let neighbors = lane.left_at(s).into_iter().chain(lane.right_at(s));
        neighbors.map(move |other| Crossing {
            lanes: [id, other],
            from,
            to: map[other].centerline.project(from).point,
        })
    });
    let onward = lane.outgoing.iter().flat_map(|&next| {
        let (end, start) = (
            line.pose_at(line.length()),
            map[next].centerline.pose_at(0.0),
        );
        [-1.0, 0.0, 1.0].map(|left| Crossing {
            lanes: [id, next],
            from: end.translated(-1.0, left).position(),
            to: start.translated(1.0, left).position(),
        })
    });
    beside.chain(onward).collect()
}

/// The ego area at one instant.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct EgoAreas {
    /// Several polygons hold a corner and none holds all four.
    pub multiple_lanes: bool,
    /// At least one corner is off the drivable area.
    pub non_drivable: bool,
    /// The center is in no lane of the route.
    pub oncoming: bool,
}

impl EgoAreas {
    /// Whether a lateral collision here is the ego's fault.
    pub(crate) fn in_multiple_lanes_or_off_road(self) -> bool {
        self.multiple_lanes || self.non_drivable
    }
}

/// A polygon of the drivable map.
#[derive(Clone, Copy)]
struct Area<'a> {
    polygon: &'a Polygon,
    /// `None` for a car park.
    lane: Option<LaneId>,
    on_route: bool,
}

/// The drivable polygons around the ego.
pub struct DrivableMap<'a> {
    map: &'a LaneMap,
    areas: Vec<Area<'a>>,
    layers: DrivableLayers,
    /// A corner may be outside by less than this, meters.
    tolerance: f64,
}

impl<'a> DrivableMap<'a> {
    /// All lanes and connectors of the roadblocks that meet the square of [`MAP_RADIUS`] around
    /// `center` (the center of the ego), and the car parks there.
    pub fn around(
        map: &'a LaneMap,
        route_lanes: &BTreeSet<LaneId>,
        center: Point,
        layers: DrivableLayers,
    ) -> Self {
        // By way of roadblocks, because upstream takes all lanes of one, also those outside the
        // square.
        let blocks: BTreeSet<_> = map
            .lanes_near(center, MAP_RADIUS)
            .into_iter()
            .map(|lane| map[lane].roadblock)
            .collect();
        let lanes: BTreeSet<LaneId> = blocks
            .iter()
            .flat_map(|&block| map[block].lanes.iter().copied())
            .collect();
        let patch = Bounds::square(center, MAP_RADIUS);
        let carparks = map.carparks_within(&patch);
        let areas = lanes
            .into_iter()
            .map(|id| Area {
                polygon: &map[id].polygon,
                lane: Some(id),
                on_route: route_lanes.contains(&id),
            })
            .chain(carparks.map(|polygon| Area {
                polygon,
                lane: None,
                on_route: false,
            }))
            .collect();
        Self {
            map,
            areas,
            layers,
            tolerance: 0.0,
        }
    }

    /// Judges as nuPlan's metrics do, where the areas of lanes are derived. All of nuPlan's drivable
    /// area counts, and a corner may be outside by its tolerance. A lane beside one of the route, in
    /// its direction, counts as on the route: recordings end roadblocks in the middle of a road. Areas
    /// that the source draws stay as they are.
    #[must_use]
    pub fn judged_as_by_the_metric(self) -> Self {
        match self.map.lane_areas() {
            LaneAreas::Drawn => self,
            LaneAreas::Derived => Self {
                areas: self.with_lanes_beside_the_route(),
                layers: DrivableLayers::DrivableArea,
                tolerance: MAX_DISTANCE_OUTSIDE,
                ..self
            },
        }
    }

    fn with_lanes_beside_the_route(&self) -> Vec<Area<'a>> {
        let route: BTreeSet<LaneId> = self
            .areas
            .iter()
            .filter(|area| area.on_route)
            .filter_map(|area| area.lane)
            .collect();
        let is_beside = |lane: LaneId| {
            let lane = &self.map[lane];
            let mut neighbors = lane.left.iter().chain(&lane.right);
            neighbors.any(|neighbor| route.contains(&neighbor.lane))
        };
        self.areas
            .iter()
            .map(|&area| Area {
                on_route: area.on_route || area.lane.is_some_and(is_beside),
                ..area
            })
            .collect()
    }

    /// The same with some lanes counted as lanes of the route: those on which the ego may pass
    /// something.
    #[must_use]
    pub(crate) fn allowing(&self, lanes: &[LaneId]) -> Self {
        let is_allowed = |lane: LaneId| lanes.contains(&lane);
        let areas = self.areas.iter().map(|&area| Area {
            on_route: area.on_route || area.lane.is_some_and(is_allowed),
            ..area
        });
        Self {
            map: self.map,
            areas: areas.collect(),
            layers: self.layers,
            tolerance: self.tolerance,
        }
    }

    /// The layers that count as drivable.
    pub fn layers(&self) -> DrivableLayers {
        self.layers
    }

    /// The map that it was taken from.
    pub fn map(&self) -> &'a LaneMap {
        self.map
    }

    /// The area of an ego state.
    pub fn areas_of(&self, ego: &EgoState) -> EgoAreas {
        let placed = Placed::from_state(ego);
        self.near(&placed.bounds()).areas_of(&placed)
    }

    /// The polygons that meet some bounds, prepared for many queries.
    pub(super) fn near(&self, bounds: &Bounds) -> NearAreas<'a> {
        let near = self
            .areas
            .iter()
            .filter(|area| area.polygon.bounds().overlaps(bounds));
        let areas = near
            .map(|area| (PointLocator::new(area.polygon), area.on_route))
            .collect();
        NearAreas {
            map: self.map,
            areas,
            layers: self.layers,
            tolerance: self.tolerance,
        }
    }
}

/// The drivable polygons within some bounds, each with whether it is on the route.
pub(super) struct NearAreas<'a> {
    map: &'a LaneMap,
    areas: Vec<(PointLocator<'a>, bool)>,
    layers: DrivableLayers,
    tolerance: f64,
}

impl NearAreas<'_> {
    /// The area of an ego within the bounds.
    pub(super) fn areas_of(&self, ego: &Placed) -> EgoAreas {
        let (mut covered, mut holders, mut whole) = ([false; 4], 0, false);
        let mut on_route = false;
        let bounds = ego.bounds();
        for (polygon, is_route) in self
            .areas
            .iter()
            .filter(|(polygon, _)| polygon.bounds().overlaps(&bounds))
        {
            let inside = ego.corners.map(|corner| polygon.contains(corner));
            holders += usize::from(inside.contains(&true));
            whole |= inside == [true; 4];
            for (covered, inside) in covered.iter_mut().zip(inside) {
                *covered |= inside;
            }
            on_route = on_route || (*is_route && polygon.contains(ego.shape.center.position()));
        }
        let off = |(corner, covered): (&Point, bool)| {
            !covered && (self.layers == DrivableLayers::Lanes || !self.is_near_drivable(*corner))
        };
        EgoAreas {
            multiple_lanes: holders > 1 && !whole,
            non_drivable: ego.corners.iter().zip(covered).any(off),
            oncoming: !on_route,
        }
    }

    fn is_near_drivable(&self, point: Point) -> bool {
        let near = || {
            self.map
                .distance_to_drivable(point, self.tolerance)
                .is_some_and(|d| d < self.tolerance)
        };
        self.map.is_drivable(point) || (self.tolerance > 0.0 && near())
    }
}
