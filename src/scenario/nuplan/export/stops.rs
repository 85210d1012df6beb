//! Stop lines as nuPlan says them.
//!
//! A connector names the stop lines of its traffic lights; naming any makes it one with traffic lights. Stop signs therefore name their
//! connectors, and not the other way. A connector with lights but without a stop line gets one across its beginning.

use super::graph::Graph;
use crate::geometry::{OrientedBox, Polygon, Pose};
use crate::world::{LaneId, LaneMap, StopLineId};
use std::collections::BTreeMap;

/// Kind of a stop line that belongs to a stop sign, in nuPlan's enumeration.
const STOP_SIGN: i64 = 1;
/// Kind of one that belongs to a traffic light.
const TRAFFIC_LIGHT: i64 = 2;
/// Depth and width of a stop line that is put in, metres.
const PUT_IN: [f64; 2] = [0.5, 3.5];

/// A row of `stop_polygons`.
#[derive(Debug, Clone)]
pub(super) struct StopRow {
    /// Its id.
    pub(super) fid: i64,
    /// Its area.
    pub(super) polygon: Polygon,
    /// Its kind.
    pub(super) kind: i64,
    /// Lanes that must stop there.
    pub(super) lanes: Vec<i64>,
    /// Connectors that must stop there.
    pub(super) connectors: Vec<i64>,
    /// Connectors that name it as the stop line of their light.
    pub(super) governs: Vec<i64>,
    /// Whether the map did not have it.
    pub(super) put_in: bool,
}

/// The stop lines of a map, in its order, then those put in.
pub(super) fn stop_rows(map: &LaneMap, graph: &Graph) -> Vec<StopRow> {
    let connectors = graph.connectors_by_lane();
    let lanes: BTreeMap<LaneId, i64> = graph.lanes.iter().filter_map(|row| Some((row.source?, row.fid))).collect();
    let fids = |lane: &LaneId| connectors.get(lane).into_iter().flatten().copied();
    let mut rows: Vec<StopRow> = Vec::with_capacity(map.stop_lines().len());
    for (place, stop) in map.stop_lines().iter().enumerate() {
        let id = StopLineId(place as u32);
        let governed = |lane: &&LaneId| map[**lane].has_traffic_lights && map[**lane].stop_lines.contains(&id);
        rows.push(StopRow {
            fid: place as i64 + 1,
            polygon: stop.polygon.clone(),
            kind: if stop.stop_sign { STOP_SIGN } else { TRAFFIC_LIGHT },
            lanes: stop.lanes.iter().filter_map(|lane| lanes.get(lane).copied()).collect(),
            connectors: stop.lanes.iter().flat_map(fids).collect(),
            governs: if stop.stop_sign { vec![] } else { stop.lanes.iter().filter(governed).flat_map(fids).collect() },
            put_in: false,
        });
    }
    for lane in map.lanes().iter().filter(|lane| lane.is_connector() && lane.has_traffic_lights) {
        let own: Vec<i64> = fids(&lane.id).collect();
        if rows.iter().any(|row| row.governs.iter().any(|fid| own.contains(fid))) {
            continue;
        }
        let start: Pose = lane.centerline.pose_at(0.0);
        let [depth, width] = PUT_IN;
        rows.push(StopRow {
            fid: rows.len() as i64 + 1,
            polygon: OrientedBox::new(start.translated(depth / 2.0, 0.0), depth, width).to_polygon(),
            kind: TRAFFIC_LIGHT,
            lanes: Vec::new(),
            connectors: own.clone(),
            governs: own,
            put_in: true,
        });
    }
    rows
}
