//! The lane map of a recording from its lanes and what the source derived for them.

use super::junctions::{Cluster, intersections};
use super::lanes::{RecordedLane, Side};
use super::roadblocks::roadblocks;
use super::trace::Trace;
use crate::geometry::Polygon;
use crate::world::{Lane, LaneId, LaneKind, LaneMap, MapError, MapParts, StopLine, StopLineId};
use std::collections::BTreeSet;

/// A map in which lanes are places in a list; the n-th of every list belongs to the n-th lane.
#[derive(Debug)]
pub(in crate::scenario) struct Layers<'a> {
    /// Name of the map with its origin.
    pub(in crate::scenario) name: String,
    pub(in crate::scenario) lanes: &'a [RecordedLane],
    /// Which lanes are connectors.
    pub(in crate::scenario) connector: &'a [bool],
    /// The area of each lane.
    pub(in crate::scenario) areas: Vec<Polygon>,
    /// Connectors that belong together.
    pub(in crate::scenario) clusters: &'a [Cluster],
    /// Road edges.
    pub(in crate::scenario) edges: &'a [Trace],
    /// Lanes that a traffic light ever governs.
    pub(in crate::scenario) lit: BTreeSet<usize>,
    pub(in crate::scenario) stop_lines: Vec<StopLine>,
    pub(in crate::scenario) crosswalks: Vec<Polygon>,
    /// What is drivable beside the lanes.
    pub(in crate::scenario) generic_drivable: Vec<Polygon>,
}

/// Derives roadblocks and intersections and checks the whole.
///
/// # Errors
/// When there is no lane.
pub(in crate::scenario) fn lane_map(layers: Layers<'_>) -> Result<LaneMap, MapError> {
    let Layers { name, lanes: recorded, connector, areas, stop_lines, crosswalks, generic_drivable, .. } = layers;
    let (roadblocks, block_of) = roadblocks(recorded, connector, &areas);
    let intersections = intersections(layers.edges, layers.clusters, &areas);
    let ids = |places: &[usize]| places.iter().map(|&place| LaneId(place as u32)).collect::<Vec<_>>();
    let lanes = recorded.iter().zip(areas).enumerate().map(|(place, (lane, polygon))| Lane {
        id: LaneId(place as u32),
        source_id: lane.id,
        kind: if connector[place] { LaneKind::Connector } else { LaneKind::Lane },
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
        roadblocks,
        stop_lines,
        intersections,
        crosswalks,
        road_segments: Vec::new(),
        generic_drivable,
        carparks: Vec::new(),
    };
    LaneMap::new(parts.with_roadblocks_as_road())
}
