//! The map along a simulation.

use super::deltas::Points;
use crate::geometry::{Bounds, Point, Polygon, Polyline, simplified};
use crate::scenario::Scenario;
use crate::world::{Lane, LaneId, LaneKind, LaneMap, MapError, MapParts, Roadblock, RoadblockId};
use serde::{Deserialize, Serialize};

/// Simplification removes vertices that are nearer than this to the remaining line, meters.
const DETAIL_M: f64 = 0.05;

/// The map along a simulation: lanes, other drivable areas, crosswalks, stop lines.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub(in crate::report) struct ReplayMap {
    lanes: Vec<ReplayLane>,
    /// Rings of each area, the outer one first.
    drivable: Vec<Vec<Points>>,
    crosswalks: Vec<Points>,
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
    /// The part of a scenario's map within `bounds`.
    pub(super) fn of(scenario: &Scenario, bounds: &Bounds) -> Self {
        let map = &scenario.map;
        let near = |polygon: &&Polygon| polygon.bounds().overlaps(bounds);
        let lanes = map.lanes().iter().filter(|lane| near(&&lane.polygon)).map(|lane| ReplayLane {
            id: lane.id,
            kind: lane.kind,
            on_route: scenario.route.contains(lane.roadblock),
            centerline: Points::of(&simplified(lane.centerline.vertices(), DETAIL_M)),
            ring: ring(lane.polygon.ring()),
        });
        // A source without road polygons has the roadblocks instead, which the lanes show already.
        let blocks: Vec<&Polygon> = map.roadblocks().iter().flat_map(|block| &block.areas).collect();
        let roads = map.road_segments().iter().filter(|road| !blocks.contains(road));
        let drivable = roads.chain(map.intersections()).chain(map.generic_drivable()).chain(map.carparks());
        let rings = |polygon: &Polygon| {
            std::iter::once(polygon.ring()).chain(polygon.holes().iter().map(Vec::as_slice)).map(ring).collect()
        };
        Self {
            lanes: lanes.collect(),
            drivable: drivable.filter(near).map(rings).collect(),
            crosswalks: map.crosswalks().iter().filter(near).map(|area| ring(area.ring())).collect(),
            stop_lines: map.stop_lines().iter().map(|l| &l.polygon).filter(near).map(|a| ring(a.ring())).collect(),
        }
    }

    /// Ids of the lanes.
    pub(super) fn lane_ids(&self) -> impl Iterator<Item = LaneId> + '_ {
        self.lanes.iter().map(|lane| lane.id)
    }

    /// A map for drawing: lanes and crosswalks without relations. It omits lanes that rounding made degenerate.
    pub(super) fn to_map(&self) -> Result<LaneMap, MapError> {
        let shapes = self.lanes.iter().filter_map(|lane| {
            let centerline = Polyline::new(lane.centerline.points()).ok()?;
            Some((lane.kind, centerline, Polygon::new(lane.ring.points()).ok()?))
        });
        let lanes: Vec<Lane> = shapes
            .enumerate()
            .map(|(i, (kind, centerline, polygon))| Lane {
                id: LaneId(i as u32),
                source_id: i as i64,
                kind,
                centerline,
                polygon,
                incoming: Vec::new(),
                outgoing: Vec::new(),
                left: Vec::new(),
                right: Vec::new(),
                roadblock: RoadblockId(0),
                speed_limit: None,
                has_traffic_lights: false,
                stop_lines: Vec::new(),
            })
            .collect();
        let block = Roadblock {
            id: RoadblockId(0),
            source_id: 0,
            kind: LaneKind::Lane,
            lanes: lanes.iter().map(|lane| lane.id).collect(),
            areas: Vec::new(),
            incoming: Vec::new(),
            outgoing: Vec::new(),
        };
        let crosswalks = self.crosswalks.iter().filter_map(|ring| Polygon::new(ring.points()).ok()).collect();
        LaneMap::new(MapParts { lanes, roadblocks: vec![block], crosswalks, ..MapParts::default() })
    }
}

/// A simplified ring; the first vertex is not repeated.
fn ring(vertices: &[Point]) -> Points {
    let closed: Vec<Point> = vertices.iter().chain(vertices.first()).copied().collect();
    let mut fewer = simplified(&closed, DETAIL_M);
    fewer.pop();
    // Simplification would reduce a thin ring, such as a stop line, to a line.
    Points::of(if fewer.len() < 3 { vertices } else { &fewer })
}
