//! The lane map of a recording, by the rules of the modules beside this one.

use super::connectors::{classify, crossings};
use super::drivable::beside_lanes;
use super::error::RecordingFault;
use super::features::{Beside, LaneFeature, MapFeatures, Side};
use super::junctions::{clusters, intersections};
use super::outline::lane_areas;
use super::proto::{DynamicMapState, MapFeature};
use super::roadblocks::roadblocks;
use super::signals::{governed_lanes, stop_lines};
use crate::geometry::{Vector, wrap_angle};
use crate::world::{Lane, LaneId, LaneKind, LaneMap, MapParts, Neighbor, StopLineId};
use std::collections::BTreeSet;

/// Derives the map; `origin` becomes the place (0, 0) and is kept in the map's name.
///
/// # Errors
/// When a feature is unsound or there is no lane.
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
    let (roadblocks, block_of) = roadblocks(&map, &connector, &areas);
    let clusters = clusters(&map, &connector, &crossings);
    let lit = lit_connectors(&map, lights, &connector, &governed);
    let stop_lines = stop_lines(&map, &connector, &lit);
    let generic_drivable = beside_lanes(&map, &clusters, &areas);
    let intersections = intersections(&map, &clusters, &areas);
    let ids = |places: &[usize]| places.iter().map(|&place| LaneId(place as u32)).collect::<Vec<_>>();
    let lanes = map.lanes.iter().zip(areas).enumerate().map(|(place, (lane, polygon))| Lane {
        id: LaneId(place as u32),
        source_id: lane.id,
        kind: if connector[place] { LaneKind::Connector } else { LaneKind::Lane },
        centerline: lane.trace.line.clone(),
        polygon,
        incoming: ids(&lane.entries),
        outgoing: ids(&lane.exits),
        left: neighbors(&map, lane, Side::Left),
        right: neighbors(&map, lane, Side::Right),
        roadblock: block_of[place],
        speed_limit: lane.speed_limit,
        has_traffic_lights: lit.contains(&place),
        stop_lines: (0..stop_lines.len())
            .filter(|&line| stop_lines[line].lanes.contains(&LaneId(place as u32)))
            .map(|line| StopLineId(line as u32))
            .collect(),
    });
    let lanes = lanes.collect();
    let name = format!("waymo open motion, origin ({}, {})", origin.x, origin.y);
    let (crosswalks, carparks) = (map.crosswalks, Vec::new());
    let parts = MapParts {
        name,
        lanes,
        roadblocks,
        stop_lines,
        intersections,
        crosswalks,
        road_segments: Vec::new(),
        generic_drivable,
        carparks,
    };
    Ok(LaneMap::new(parts.with_roadblocks_as_road())?)
}

/// Connectors with a light at their beginning, or whose only ways in have one at their end.
fn lit_connectors(
    map: &MapFeatures,
    lights: &[DynamicMapState],
    connector: &[bool],
    governed: &BTreeSet<usize>,
) -> BTreeSet<usize> {
    let named: BTreeSet<i64> = lights.iter().flat_map(|step| &step.lane_states).map(|light| light.lane).collect();
    let behind =
        map.lanes.iter().enumerate().filter(|(place, lane)| named.contains(&lane.id) && !governed.contains(place));
    let behind = behind.flat_map(|(_, lane)| lane.exits.iter().copied()).filter(|&lane| connector[lane]);
    governed.iter().copied().chain(behind).collect()
}

/// Lanes beside a lane that run in its direction there.
fn neighbors(map: &MapFeatures, lane: &LaneFeature, side: Side) -> Vec<Neighbor> {
    let listed = lane.neighbors.at(side).iter().filter(|beside| one_direction(map, lane, beside));
    let mut neighbors: Vec<Neighbor> = listed
        .map(|beside| Neighbor { lane: LaneId(beside.lane as u32), from_s: beside.from_s, to_s: beside.to_s })
        .collect();
    neighbors.sort_by(|a, b| a.from_s.total_cmp(&b.from_s).then(a.lane.cmp(&b.lane)));
    neighbors
}

fn one_direction(map: &MapFeatures, lane: &LaneFeature, beside: &Beside) -> bool {
    let middle = lane.trace.line.pose_at(f64::midpoint(beside.from_s, beside.to_s));
    let other = map.lanes[beside.lane].trace.line.project(middle.position());
    wrap_angle(other.heading - middle.heading).abs() < std::f64::consts::FRAC_PI_4
}
