//! The lane map of a Waymo recording.

use super::connectors::classify;
use super::drivable::beside_lanes;
use super::features::MapFeatures;
use super::outline::lane_areas;
use super::proto::{DynamicMapState, MapFeature};
use super::signals::{governed_lanes, stop_lines};
use crate::recording::error::RecordingFault;
use crate::recording::junctions::{clusters, crossings};
use crate::recording::map::{self, Layers};
use planagent_world::LaneMap;
use planagent_world::geometry::Vector;
use std::collections::BTreeSet;

/// Derives the map; `origin` becomes the point (0, 0).
pub(super) fn lane_map(
    features: &[MapFeature],
    lights: &[DynamicMapState],
    origin: Vector,
) -> Result<LaneMap, RecordingFault> {
    let map = MapFeatures::read(features, origin)?;
    let crossings = crossings(&map.lanes);
    let governed = governed_lanes(&map, lights, origin);
    let connector = classify(&map, &crossings, &governed);
    let areas = lane_areas(&map, &connector);
    let clusters = clusters(&map.lanes, &connector, &crossings);
    let lit = lit_connectors(&map, lights, &connector, &governed);
    let stop_lines = stop_lines(&map, &connector, &lit);
    let generic_drivable = beside_lanes(&map, &clusters, &areas);
    let layers = Layers {
        name: format!("waymo open motion, origin ({}, {})", origin.x, origin.y),
        lanes: &map.lanes,
        connector: &connector,
        areas,
        clusters: &clusters,
        edges: &map.edges,
        lit,
        stop_lines,
        crosswalks: map.crosswalks,
        generic_drivable,
    };
    Ok(map::lane_map(layers)?)
}

/// Connectors with a light at their start, or at the end of a lane that leads to them.
fn lit_connectors(
    map: &MapFeatures,
    lights: &[DynamicMapState],
    connector: &[bool],
    governed: &BTreeSet<usize>,
) -> BTreeSet<usize> {
    let named: BTreeSet<i64> = lights
        .iter()
        .flat_map(|step| &step.lane_states)
        .map(|light| light.lane)
        .collect();
    let behind = map
        .lanes
        .iter()
        .enumerate()
        .filter(|(place, lane)| named.contains(&lane.id) && !governed.contains(place));
    let behind = behind
        .flat_map(|(_, lane)| lane.exits.iter().copied())
        .filter(|&lane| connector[lane]);
    governed.iter().copied().chain(behind).collect()
}
