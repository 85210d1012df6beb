//! The lane map of a recording from its lanes and the layers of its source.

use super::junctions::{Cluster, intersections};
use super::lanes::{RecordedLane, Side};
use super::roadblocks::roadblocks;
use super::trace::Trace;
use geo::Simplify;
use planagent_world::geometry::{Point, Polygon};
use planagent_world::{
    Lane, LaneAreas, LaneId, LaneKind, LaneMap, MapError, MapParts, StopLine, StopLineId,
};
use std::collections::BTreeSet;

/// Layers of a map. Lanes are indices; the n-th element of every list belongs to the n-th lane.
#[derive(Debug)]
pub(crate) struct Layers<'a> {
    pub(crate) name: String,
    pub(crate) lanes: &'a [RecordedLane],
    /// True for connectors.
    pub(crate) connector: &'a [bool],
    pub(crate) areas: Vec<Polygon>,
    pub(crate) clusters: &'a [Cluster],
    pub(crate) edges: &'a [Trace],
    /// Lanes with a traffic light.
    pub(crate) lit: BTreeSet<usize>,
    pub(crate) stop_lines: Vec<StopLine>,
    pub(crate) crosswalks: Vec<Polygon>,
    /// Drivable area beside the lanes.
    pub(crate) generic_drivable: Vec<Polygon>,
}

/// Derives roadblocks and intersections and checks the map.
pub(crate) fn lane_map(layers: Layers<'_>) -> Result<LaneMap, MapError> {
    let Layers {
        name,
        lanes: recorded,
        connector,
        areas,
        stop_lines,
        crosswalks,
        generic_drivable,
        ..
    } = layers;
    let (roadblocks, block_of) = roadblocks(recorded, connector, &areas);
    let intersections = intersections(layers.edges, layers.clusters, &areas);
    let ids = |places: &[usize]| {
        places
            .iter()
            .map(|&place| LaneId(place as u32))
            .collect::<Vec<_>>()
    };
    // Ids are places in `recorded`, since no lane is left out here.
    let lanes = recorded
        .iter()
        .zip(areas)
        .enumerate()
        .map(|(place, (lane, polygon))| Lane {
            id: LaneId(place as u32),
            source_id: lane.id,
            kind: if connector[place] {
                LaneKind::Connector
            } else {
                LaneKind::Lane
            },
            centerline: lane.trace.line.clone(),
            polygon,
            incoming: ids(&lane.entries),
            outgoing: ids(&lane.exits),
            left: lane.neighbors_along(recorded, Side::Left),
            right: lane.neighbors_along(recorded, Side::Right),
            roadblock: block_of[place],
            speed_limit: lane.speed_limit,
            has_traffic_lights: layers.lit.contains(&place),
            stop_lines: (0..stop_lines.len())
                .filter(|&line| stop_lines[line].lanes.contains(&LaneId(place as u32)))
                .map(|line| StopLineId(line as u32))
                .collect(),
        });
    let lanes = lanes.collect();
    let parts = MapParts {
        name,
        lanes,
        lane_areas: LaneAreas::Derived,
        roadblocks,
        stop_lines,
        intersections,
        crosswalks,
        road_segments: Vec::new(),
        generic_drivable,
        carparks: Vec::new(),
    };
    LaneMap::new(parts.with_roadblocks_as_road().with_dense_baselines())
}

/// Cuts lane areas so that at most one lane holds a point, as nuPlan's metrics assume. An earlier
/// lane keeps the overlap, and a lane that would lose everything keeps its area. Connectors may
/// overlap each other and lanes.
pub(crate) fn separate(areas: &mut [Polygon], connector: &[bool]) {
    /// Smaller overlaps are rounding, m².
    const MIN_OVERLAP: f64 = 1e-6;
    for later in (0..areas.len()).filter(|&i| !connector[i]) {
        for earlier in (0..later).filter(|&i| !connector[i]) {
            let (a, b) = (&areas[earlier], &areas[later]);
            if a.overlaps(b)
                && a.shared_area(b) > MIN_OVERLAP
                && let Some(rest) = b.without(a)
            {
                areas[later] = rest;
            }
        }
    }
}

/// The polygon without the vertices that change its outline by less than `by` meters.
pub(crate) fn simplified(polygon: &Polygon, by: f64) -> Polygon {
    from_geo(&to_geo(polygon).simplify(by)).unwrap_or_else(|| polygon.clone())
}

fn to_geo(polygon: &Polygon) -> geo::Polygon<f64> {
    let ring: Vec<(f64, f64)> = polygon.ring().iter().map(|p| (p.x, p.y)).collect();
    geo::Polygon::new(geo::LineString::from(ring), vec![])
}

fn from_geo(polygon: &geo::Polygon<f64>) -> Option<Polygon> {
    Polygon::new(polygon.exterior().coords().map(|c| Point::new(c.x, c.y))).ok()
}
