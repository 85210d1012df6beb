//! The lane map of a `map.gpkg`, with nuPlan's derived relations.
//!
//! * A connector succeeds the lane of its `exit_lane_fid` and precedes the lane of its
//!   `entry_lane_fid`.
//! * The left and right neighbors of a lane have a `lane_index` of one less and one more in its
//!   lane group, along its length.
//! * Lane groups are roadblocks, lane group connectors are roadblock connectors.
//! * A connector has traffic lights when `traffic_light_stop_line_fids` names any stop polygon. Of
//!   these, its stop lines are those that meet its baseline; when none does, the one nearest to the
//!   start of the baseline.
//! * A connector without traffic lights has the stop-sign polygons that name it in
//!   `lane_connector_fids`; nuPlan's simulation does not use them.

use super::error::{CellFault, CellPlace, NuPlanError, RowName};
use super::layers::{ConnectorRow, Layers, StopRow, largest};
use planagent_world::geometry::{Polygon, Polyline, Pose, Vector};
use planagent_world::{
    Lane, LaneAreas, LaneId, LaneKind, LaneMap, MapParts, Neighbor, Roadblock, RoadblockId,
    StopLine, StopLineId,
};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

/// `stop_polygon_type_fid` of a stop sign (devkit `StopLineType`).
const STOP_SIGN: i64 = 1;

/// The map of a location in local meters.
#[derive(Debug, Clone)]
pub struct NuPlanMap {
    /// Its name holds location, version, projection and origin.
    pub lanes: Arc<LaneMap>,
    /// Easting and northing of the map's (0, 0), m.
    pub origin: Vector,
    /// By fid.
    connectors: BTreeMap<i64, LaneId>,
    /// By fid.
    roadblocks: BTreeMap<i64, RoadblockId>,
    /// By fid.
    roadblock_connectors: BTreeMap<i64, RoadblockId>,
}

impl NuPlanMap {
    /// The roadblock of this fid, else the roadblock connector.
    pub fn roadblock(&self, fid: i64) -> Option<RoadblockId> {
        self.roadblocks
            .get(&fid)
            .or_else(|| self.roadblock_connectors.get(&fid))
            .copied()
    }

    /// The lane connector of this fid.
    pub fn connector(&self, fid: i64) -> Option<LaneId> {
        self.connectors.get(&fid).copied()
    }

    /// A pose of the projection in local meters.
    pub fn to_local(&self, pose: Pose) -> Pose {
        Pose {
            x: pose.x - self.origin.x,
            y: pose.y - self.origin.y,
            ..pose
        }
    }
}

/// Reads a map file; also returns notes for the user.
pub(super) fn read(
    path: &Path,
    location: &str,
    version: &str,
) -> Result<(NuPlanMap, Vec<String>), NuPlanError> {
    let mut layers = Layers::read(path)?;
    let origin = layers.origin;
    let name = format!(
        "{location} {version}, EPSG:{}, origin ({}, {})",
        layers.epsg, origin.x, origin.y
    );
    let ids = Ids::from_layers(path, &layers)?;
    // Connectors follow the lanes, because `Ids` numbers them so.
    let mut lanes = ids.lanes(&mut layers)?;
    lanes.extend(ids.connectors(&mut layers)?);
    let open_ends = ids.link(&layers, &mut lanes);
    let stop_lines = ids.stop(&layers, &mut lanes)?;
    let roadblocks = ids.roadblocks(&mut layers, &lanes);
    let parts = MapParts {
        name,
        lanes,
        lane_areas: LaneAreas::Drawn,
        roadblocks,
        stop_lines,
        intersections: layers.intersections,
        crosswalks: layers.crosswalks,
        road_segments: layers.road_segments,
        generic_drivable: layers.generic_drivable,
        carparks: layers.carparks,
    };
    let lanes = LaneMap::new(parts).map_err(|fault| NuPlanError::file(path, fault.into()))?;
    let Ids {
        connectors,
        lane_groups,
        group_connectors,
        ..
    } = ids;
    let map = NuPlanMap {
        lanes: Arc::new(lanes),
        origin,
        connectors,
        roadblocks: lane_groups,
        roadblock_connectors: group_connectors,
    };
    let note = (open_ends > 0).then(|| {
        format!(
            "{}: {open_ends} ends of lane connectors name lanes that the map does not have",
            path.display()
        )
    });
    Ok((map, note.into_iter().collect()))
}

/// Ids in the map of the rows of each layer, by fid.
struct Ids<'a> {
    path: &'a Path,
    lanes: BTreeMap<i64, LaneId>,
    connectors: BTreeMap<i64, LaneId>,
    lane_groups: BTreeMap<i64, RoadblockId>,
    group_connectors: BTreeMap<i64, RoadblockId>,
    stops: BTreeMap<i64, StopLineId>,
}

impl<'a> Ids<'a> {
    fn from_layers(path: &'a Path, layers: &Layers) -> Result<Self, NuPlanError> {
        let (lanes, blocks) = (layers.lanes.len(), layers.lane_groups.len());
        let lane_fids = layers.lanes.iter().map(|row| row.fid);
        let connector_fids = layers.connectors.iter().map(|row| row.fid);
        let group_fids = layers.lane_groups.iter().map(|(fid, _)| *fid);
        let group_connector_fids = layers.group_connectors.iter().map(|row| row.fid);
        let stop_fids = layers.stops.iter().map(|row| row.fid);
        Ok(Self {
            path,
            lanes: places(path, "lanes_polygons", lane_fids, |n| LaneId(n as u32))?,
            connectors: places(path, "lane_connectors", connector_fids, |n| {
                LaneId((lanes + n) as u32)
            })?,
            lane_groups: places(path, "lane_groups_polygons", group_fids, |n| {
                RoadblockId(n as u32)
            })?,
            group_connectors: places(path, "lane_group_connectors", group_connector_fids, |n| {
                RoadblockId((blocks + n) as u32)
            })?,
            stops: places(path, "stop_polygons", stop_fids, |n| StopLineId(n as u32))?,
        })
    }

    fn lanes(&self, layers: &mut Layers) -> Result<Vec<Lane>, NuPlanError> {
        let rows = std::mem::take(&mut layers.lanes);
        let mut beside: BTreeMap<(i64, i64), LaneId> = BTreeMap::new();
        for row in &rows {
            if let Some(&lane) = self.lanes.get(&row.fid) {
                beside.entry((row.group, row.index)).or_insert(lane);
            }
        }
        let lane = |(place, row): (usize, super::layers::LaneRow)| {
            let fault = |column, fault| self.fault("lanes_polygons", row.fid, column, fault);
            let centerline = layers.lane_baselines.remove(&row.fid).ok_or_else(|| {
                fault(
                    "fid",
                    CellFault::Dangling {
                        target: "its baseline path".to_owned(),
                        table: "baseline_paths",
                    },
                )
            })?;
            let roadblock = self.lane_groups.get(&row.group).copied().ok_or_else(|| {
                let target = format!("lane group {}", row.group);
                fault(
                    "lane_group_fid",
                    CellFault::Dangling {
                        target,
                        table: "lane_groups_polygons",
                    },
                )
            })?;
            let polygon = largest(row.areas).ok_or_else(|| fault("geom", CellFault::Null))?;
            // Neighbors are the lanes of a group with the next index.
            let at = |index: Option<i64>| {
                let lane = index
                    .and_then(|index| beside.get(&(row.group, index)))
                    .copied();
                lane.map(|lane| Neighbor {
                    lane,
                    from_s: 0.0,
                    to_s: centerline.length(),
                })
                .into_iter()
                .collect()
            };
            let (left, right) = (at(row.index.checked_sub(1)), at(row.index.checked_add(1)));
            Ok(Lane {
                id: LaneId(place as u32),
                source_id: row.fid,
                kind: LaneKind::Lane,
                centerline,
                polygon,
                incoming: Vec::new(),
                outgoing: Vec::new(),
                left,
                right,
                roadblock,
                speed_limit: row.speed_limit,
                has_traffic_lights: false,
                stop_lines: Vec::new(),
            })
        };
        rows.into_iter().enumerate().map(lane).collect()
    }

    fn connectors(&self, layers: &mut Layers) -> Result<Vec<Lane>, NuPlanError> {
        let Layers {
            connectors,
            connector_baselines,
            connector_areas,
            ..
        } = layers;
        let connector = |row: &ConnectorRow| {
            let fault = |column, fault| self.fault("lane_connectors", row.fid, column, fault);
            let missing = |target: &str, table| {
                fault(
                    "fid",
                    CellFault::Dangling {
                        target: target.to_owned(),
                        table,
                    },
                )
            };
            // Shapes are moved out: each belongs to one connector, and a city's map is large.
            let centerline = connector_baselines
                .remove(&row.fid)
                .ok_or_else(|| missing("its baseline path", "baseline_paths"))?;
            let polygon = connector_areas
                .remove(&row.fid)
                .and_then(largest)
                .ok_or_else(|| missing("its area", "gen_lane_connectors_scaled_width_polygons"))?;
            let roadblock = self
                .group_connectors
                .get(&row.group)
                .copied()
                .ok_or_else(|| {
                    let target = format!("lane group connector {}", row.group);
                    fault(
                        "lane_group_connector_fid",
                        CellFault::Dangling {
                            target,
                            table: "lane_group_connectors",
                        },
                    )
                })?;
            Ok(Lane {
                id: self
                    .connectors
                    .get(&row.fid)
                    .copied()
                    .expect("every row of the layer has its lane"),
                source_id: row.fid,
                kind: LaneKind::Connector,
                centerline,
                polygon,
                incoming: Vec::new(),
                outgoing: Vec::new(),
                left: Vec::new(),
                right: Vec::new(),
                roadblock,
                speed_limit: row.speed_limit,
                has_traffic_lights: !row.stops.is_empty(),
                stop_lines: Vec::new(),
            })
        };
        connectors.iter().map(connector).collect()
    }

    /// Links lanes and connectors; the number of connector ends whose lanes do not exist.
    fn link(&self, layers: &Layers, lanes: &mut [Lane]) -> usize {
        let mut open_ends = 0;
        for row in &layers.connectors {
            let Some(&connector) = self.connectors.get(&row.fid) else {
                continue;
            };
            match self.lanes.get(&row.from) {
                Some(&from) => {
                    lanes[connector.index()].incoming.push(from);
                    lanes[from.index()].outgoing.push(connector);
                }
                None => open_ends += 1,
            }
            match self.lanes.get(&row.into) {
                Some(&into) => {
                    lanes[connector.index()].outgoing.push(into);
                    lanes[into.index()].incoming.push(connector);
                }
                None => open_ends += 1,
            }
        }
        open_ends
    }

    /// Adds the stop lines to the connectors; returns them with the lanes that stop there.
    fn stop(&self, layers: &Layers, lanes: &mut [Lane]) -> Result<Vec<StopLine>, NuPlanError> {
        self.stop_at_lights(layers, lanes)?;
        self.stop_at_signs(layers, lanes);
        let mut stopping: Vec<Vec<LaneId>> = vec![Vec::new(); layers.stops.len()];
        for lane in lanes.iter() {
            for stop in &lane.stop_lines {
                stopping[stop.index()].push(lane.id);
            }
        }
        let line = |(row, lanes): (&StopRow, Vec<LaneId>)| StopLine {
            polygon: row.area.clone(),
            lanes,
            stop_sign: row.kind == STOP_SIGN,
        };
        Ok(layers.stops.iter().zip(stopping).map(line).collect())
    }

    fn stop_at_lights(&self, layers: &Layers, lanes: &mut [Lane]) -> Result<(), NuPlanError> {
        for row in &layers.connectors {
            let Some(&connector) = self.connectors.get(&row.fid) else {
                continue;
            };
            let mut named = Vec::with_capacity(row.stops.len());
            for stop in &row.stops {
                let id = self.stops.get(stop).copied().ok_or_else(|| {
                    let target = format!("stop polygon {stop}");
                    let table = "stop_polygons";
                    let fault = CellFault::Dangling { target, table };
                    let column = "traffic_light_stop_line_fids";
                    self.fault("lane_connectors", row.fid, column, fault)
                })?;
                named.push(id);
            }
            let lane = &mut lanes[connector.index()];
            lane.stop_lines = stop_lines_of(&lane.centerline, &named, &layers.stops);
        }
        Ok(())
    }

    /// Where a light and a sign stand, the light regulates: a sign would stop the ego at green.
    fn stop_at_signs(&self, layers: &Layers, lanes: &mut [Lane]) {
        let stops = layers.stops.iter().enumerate();
        for (place, row) in stops.filter(|(_, row)| row.kind == STOP_SIGN) {
            let connectors = row.connectors.iter();
            for connector in connectors.filter_map(|fid| self.connectors.get(fid)) {
                let lane = &mut lanes[connector.index()];
                if !lane.has_traffic_lights {
                    lane.stop_lines.push(StopLineId(place as u32));
                }
            }
        }
    }

    fn roadblocks(&self, layers: &mut Layers, lanes: &[Lane]) -> Vec<Roadblock> {
        let block = |kind: LaneKind| {
            move |(id, source_id, areas): (RoadblockId, i64, Vec<Polygon>)| Roadblock {
                id,
                source_id,
                kind,
                lanes: Vec::new(),
                areas,
                incoming: Vec::new(),
                outgoing: Vec::new(),
            }
        };
        let groups = std::mem::take(&mut layers.lane_groups);
        let count = groups.len();
        let groups = groups
            .into_iter()
            .enumerate()
            .map(|(n, (fid, areas))| (RoadblockId(n as u32), fid, areas));
        let connecting = std::mem::take(&mut layers.group_connectors);
        let joints: Vec<(i64, i64)> = connecting.iter().map(|row| (row.from, row.to)).collect();
        let connecting = connecting
            .into_iter()
            .enumerate()
            .map(|(n, row)| (RoadblockId((count + n) as u32), row.fid, row.areas));
        let mut blocks: Vec<Roadblock> = groups.map(block(LaneKind::Lane)).collect();
        blocks.extend(connecting.map(block(LaneKind::Connector)));
        for (n, (from, to)) in joints.into_iter().enumerate() {
            // A link to a group that the map lacks is left out, as open ends of connectors are.
            let connector = RoadblockId((count + n) as u32);
            if let Some(&from) = self.lane_groups.get(&from) {
                blocks[from.index()].outgoing.push(connector);
                blocks[connector.index()].incoming.push(from);
            }
            if let Some(&to) = self.lane_groups.get(&to) {
                blocks[connector.index()].outgoing.push(to);
                blocks[to.index()].incoming.push(connector);
            }
        }
        for lane in lanes {
            blocks[lane.roadblock.index()].lanes.push(lane.id);
        }
        blocks
    }

    fn fault(
        &self,
        table: &'static str,
        fid: i64,
        column: &'static str,
        fault: CellFault,
    ) -> NuPlanError {
        cell(self.path, table, fid, column, fault)
    }
}

fn cell(
    path: &Path,
    table: &'static str,
    fid: i64,
    column: &'static str,
    fault: CellFault,
) -> NuPlanError {
    NuPlanError::cell(
        CellPlace {
            path: path.to_owned(),
            table,
            column,
            row: RowName::Fid(fid),
        },
        fault,
    )
}

/// The id of each row by its fid, which must be unique.
fn places<Id>(
    path: &Path,
    table: &'static str,
    fids: impl Iterator<Item = i64>,
    id: impl Fn(usize) -> Id,
) -> Result<BTreeMap<i64, Id>, NuPlanError> {
    let mut places = BTreeMap::new();
    for (place, fid) in fids.enumerate() {
        if places.insert(fid, id(place)).is_some() {
            return Err(cell(path, table, fid, "fid", CellFault::Twice(fid)));
        }
    }
    Ok(places)
}

/// Of the named stop polygons, those that meet the baseline, else the one nearest to its start.
fn stop_lines_of(baseline: &Polyline, named: &[StopLineId], stops: &[StopRow]) -> Vec<StopLineId> {
    let area = |id: StopLineId| &stops[id.index()].area;
    let met: Vec<StopLineId> = named
        .iter()
        .copied()
        .filter(|&id| area(id).meets_line(baseline))
        .collect();
    if !met.is_empty() {
        return met;
    }
    let distance = |id: StopLineId| area(id).distance_to(baseline.start());
    let nearest = named
        .iter()
        .copied()
        .min_by(|&a, &b| distance(a).total_cmp(&distance(b)));
    nearest.into_iter().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use planagent_world::geometry::Point;

    fn stop(fid: i64, x: f64, y: f64) -> StopRow {
        let ring = [(x, y), (x + 1.0, y), (x + 1.0, y + 3.0), (x, y + 3.0)];
        let area = Polygon::new(ring.map(|(x, y)| Point::new(x, y))).unwrap();
        StopRow {
            fid,
            kind: 2,
            connectors: Vec::new(),
            area,
        }
    }

    #[test]
    fn stop_lines_meet_the_baseline_or_the_nearest_is_taken() {
        let baseline = Polyline::new([Point::new(0.0, 0.0), Point::new(20.0, 0.0)]).unwrap();
        let stops = [
            stop(1, 2.0, -1.0),
            stop(2, 4.0, 1.0),
            stop(3, 18.0, -1.0),
            stop(4, -3.0, 1.0),
        ];
        let lines = |named: &[u32]| {
            let named: Vec<StopLineId> = named.iter().map(|&id| StopLineId(id)).collect();
            stop_lines_of(&baseline, &named, &stops)
                .into_iter()
                .map(|id| id.0)
                .collect::<Vec<_>>()
        };
        assert_eq!(lines(&[0, 1, 2]), [0, 2], "those that meet the baseline");
        assert_eq!(
            lines(&[1, 3]),
            [3],
            "none does: the one nearest to its start"
        );
        assert_eq!(lines(&[]), [0; 0]);
    }
}
