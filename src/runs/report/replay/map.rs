//! The map along a simulation.

use super::deltas::Points;
use crate::report::bounded::at_most;
use crate::report::limits::MAX_OBJECTS;
use planagent_world::geometry::{Bounds, Point, Polygon, simplified};
use planagent_world::{LaneId, LaneKind, LaneMap, Route};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Simplification removes vertices that are nearer than this to the remaining line, meters.
const DETAIL_M: f64 = 0.05;

/// The map along a simulation: lanes, other drivable areas, crosswalks, stop lines.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub(in crate::report) struct ReplayMap {
    #[serde(deserialize_with = "at_most::<_, _, MAX_OBJECTS>")]
    lanes: Vec<ReplayLane>,
    /// Rings of each area, the outer one first.
    #[serde(deserialize_with = "at_most::<_, _, MAX_OBJECTS>")]
    drivable: Vec<Vec<Points>>,
    #[serde(deserialize_with = "at_most::<_, _, MAX_OBJECTS>")]
    crosswalks: Vec<Points>,
    #[serde(deserialize_with = "at_most::<_, _, MAX_OBJECTS>")]
    stop_lines: Vec<Points>,
}

/// A lane or connector.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
struct ReplayLane {
    id: LaneId,
    kind: LaneKind,
    /// Whether it belongs to the route.
    on_route: bool,
    centerline: Points,
    ring: Points,
}

impl ReplayMap {
    /// The part of a map with a route within `bounds`.
    pub(super) fn from_map(map: &LaneMap, route: &Route, bounds: &Bounds) -> Self {
        let near = |polygon: &&Polygon| polygon.bounds().overlaps(bounds);
        let lanes = map
            .lanes()
            .iter()
            .filter(|lane| near(&&lane.polygon))
            .map(|lane| ReplayLane {
                id: lane.id,
                kind: lane.kind,
                on_route: route.contains(lane.roadblock),
                centerline: Points::from_points(&simplified(lane.centerline.vertices(), DETAIL_M)),
                ring: ring(lane.polygon.ring()),
            });
        // A source without road polygons has the roadblocks instead, which the lanes show already.
        let blocks: Vec<&Polygon> = map
            .roadblocks()
            .iter()
            .flat_map(|block| &block.areas)
            .collect();
        let roads = map
            .road_segments()
            .iter()
            .filter(|road| !blocks.contains(road));
        let drivable = roads
            .chain(map.intersections())
            .chain(map.generic_drivable())
            .chain(map.carparks());
        let rings = |polygon: &Polygon| {
            std::iter::once(polygon.ring())
                .chain(polygon.holes().iter().map(Vec::as_slice))
                .map(ring)
                .collect()
        };
        Self {
            lanes: lanes.collect(),
            drivable: drivable.filter(near).map(rings).collect(),
            crosswalks: map
                .crosswalks()
                .iter()
                .filter(near)
                .map(|area| ring(area.ring()))
                .collect(),
            stop_lines: map
                .stop_lines()
                .iter()
                .map(|l| &l.polygon)
                .filter(near)
                .map(|a| ring(a.ring()))
                .collect(),
        }
    }

    /// Ids of the lanes.
    pub(super) fn lane_ids(&self) -> impl Iterator<Item = LaneId> + '_ {
        self.lanes.iter().map(|lane| lane.id)
    }
}

/// A map as it is drawn, map frame.
#[derive(Debug, Clone, Default)]
pub(in crate::report) struct DrawnMap {
    /// Rings of each drivable area beside the lanes.
    pub(in crate::report) drivable: Vec<Vec<Vec<Point>>>,
    /// Rings of lanes and connectors.
    pub(in crate::report) lanes: Vec<Vec<Point>>,
    /// Those of the route.
    pub(in crate::report) route: Vec<Vec<Point>>,
    /// Centerlines of lanes.
    pub(in crate::report) centerlines: Vec<Vec<Point>>,
    /// Centerlines of connectors.
    pub(in crate::report) connectors: Vec<Vec<Point>>,
    /// Rings of crosswalks.
    pub(in crate::report) crosswalks: Vec<Vec<Point>>,
    /// Rings of stop lines.
    pub(in crate::report) stop_lines: Vec<Vec<Point>>,
    /// The first segment of each centerline.
    starts: BTreeMap<LaneId, [Point; 2]>,
}

impl DrawnMap {
    /// The part of a map with a route within `bounds`.
    pub(in crate::report) fn from_map(map: &LaneMap, route: &Route, bounds: &Bounds) -> Self {
        Self::from(&ReplayMap::from_map(map, route, bounds))
    }

    /// The first segment of a centerline.
    pub(in crate::report) fn start_of(&self, lane: LaneId) -> Option<[Point; 2]> {
        self.starts.get(&lane).copied()
    }

    /// The lanes with the first segments of their centerlines.
    pub(in crate::report) fn starts(&self) -> impl Iterator<Item = (LaneId, [Point; 2])> + '_ {
        self.starts.iter().map(|(lane, start)| (*lane, *start))
    }
}

impl From<&ReplayMap> for DrawnMap {
    fn from(map: &ReplayMap) -> Self {
        let points = |ring: &Points| -> Vec<Point> { ring.points().collect() };
        let mut drawn = Self {
            drivable: map
                .drivable
                .iter()
                .map(|rings| rings.iter().map(points).collect())
                .collect(),
            crosswalks: map.crosswalks.iter().map(points).collect(),
            stop_lines: map.stop_lines.iter().map(points).collect(),
            ..Self::default()
        };
        for lane in &map.lanes {
            let (ring, centerline) = (points(&lane.ring), points(&lane.centerline));
            if let [first, second, ..] = centerline.as_slice() {
                drawn.starts.insert(lane.id, [*first, *second]);
            }
            if lane.on_route {
                drawn.route.push(ring.clone());
            }
            drawn.lanes.push(ring);
            match lane.kind {
                LaneKind::Lane => drawn.centerlines.push(centerline),
                LaneKind::Connector => drawn.connectors.push(centerline),
            }
        }
        drawn
    }
}

/// A simplified ring; the first vertex is not repeated.
fn ring(vertices: &[Point]) -> Points {
    let closed: Vec<Point> = vertices.iter().chain(vertices.first()).copied().collect();
    let mut fewer = simplified(&closed, DETAIL_M);
    fewer.pop();
    // Simplification would reduce a thin ring, such as a stop line, to a line.
    Points::from_points(if fewer.len() < 3 { vertices } else { &fewer })
}
