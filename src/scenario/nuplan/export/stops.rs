//! Stop lines as nuPlan stores them.
//!
//! A connector that names a stop line has traffic lights. Stop signs therefore name their
//! connectors instead. A connector with lights but without a stop line gets one across its start.

use super::graph::Graph;
use planagent_world::geometry::{OrientedBox, Polygon, Pose};
use planagent_world::{LaneId, LaneMap, StopLineId};
use std::collections::BTreeMap;

/// Stop line types of nuPlan's enumeration: of a stop sign,
const STOP_SIGN: i64 = 1;
/// and of a traffic light.
const TRAFFIC_LIGHT: i64 = 2;
/// Depth and width of an inserted stop line, m.
const INSERTED_SIZE: [f64; 2] = [0.5, 3.5];

/// A row of `stop_polygons`.
#[derive(Debug, Clone)]
pub(super) struct StopRow {
    pub(super) fid: i64,
    pub(super) polygon: Polygon,
    pub(super) kind: i64,
    pub(super) lanes: Vec<i64>,
    pub(super) connectors: Vec<i64>,
    /// Connectors that name it as the stop line of their lights.
    pub(super) governs: Vec<i64>,
    pub(super) inserted: bool,
}

/// The stop lines of a map, in order, then the inserted ones.
pub(super) fn stop_rows(map: &LaneMap, graph: &Graph) -> Vec<StopRow> {
    let connectors = graph.connectors_by_lane();
    let lanes: BTreeMap<LaneId, i64> = graph
        .lanes
        .iter()
        .filter_map(|row| Some((row.source?, row.fid)))
        .collect();
    let fids = |lane: &LaneId| connectors.get(lane).into_iter().flatten().copied();
    let mut rows: Vec<StopRow> = Vec::with_capacity(map.stop_lines().len());
    for (place, stop) in map.stop_lines().iter().enumerate() {
        let id = StopLineId(place as u32);
        let governed =
            |lane: &&LaneId| map[**lane].has_traffic_lights && map[**lane].stop_lines.contains(&id);
        rows.push(StopRow {
            fid: place as i64 + 1,
            polygon: stop.polygon.clone(),
            kind: if stop.stop_sign {
                STOP_SIGN
            } else {
                TRAFFIC_LIGHT
            },
            lanes: stop
                .lanes
                .iter()
                .filter_map(|lane| lanes.get(lane).copied())
                .collect(),
            connectors: stop.lanes.iter().flat_map(fids).collect(),
            governs: if stop.stop_sign {
                vec![]
            } else {
                stop.lanes.iter().filter(governed).flat_map(fids).collect()
            },
            inserted: false,
        });
    }
    for lane in map
        .lanes()
        .iter()
        .filter(|lane| lane.is_connector() && lane.has_traffic_lights)
    {
        // nuPlan finds a light by its stop line, so a connector with a light needs one.
        let own: Vec<i64> = fids(&lane.id).collect();
        if rows
            .iter()
            .any(|row| row.governs.iter().any(|fid| own.contains(fid)))
        {
            continue;
        }
        let start: Pose = lane.centerline.pose_at(0.0);
        let [depth, width] = INSERTED_SIZE;
        rows.push(StopRow {
            fid: rows.len() as i64 + 1,
            polygon: OrientedBox::new(start.translated(depth / 2.0, 0.0), depth, width)
                .to_polygon(),
            kind: TRAFFIC_LIGHT,
            lanes: Vec::new(),
            connectors: own.clone(),
            governs: own,
            inserted: true,
        });
    }
    rows
}
