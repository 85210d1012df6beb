//! The lane graph with nuPlan's relations.
//!
//! In nuPlan a lane connector leads from exactly one lane to exactly one lane, and lanes are joined
//! by connectors only. Maps of recordings need not keep these rules. What breaks them is rewritten
//! without changing the drivable geometry:
//!
//! * between directly successive lanes a connector is inserted: the last [`STITCH`] meters of the
//!   first lane, cut off its centerline, or the straight line over a gap;
//! * between successive connectors a lane is inserted, cut off in the same way;
//! * at an open end of a connector a lane of [`OPEN_END`] meters is inserted;
//! * a connector that joins several lanes is written once for each pair.
//!
//! Inserted lanes have areas clear of all other lanes (`overlap`).
//!
//! Maps that keep the rules (all generated ones) pass unchanged. [`ExportChanges`] counts the
//! changes.

use super::ExportChanges;
use super::ids::{FreeIds, feature_ids};
use super::overlap::cut_inserted;
use planagent_world::geometry::{GeometryError, OrientedBox, Point, Polygon, Polyline};
use planagent_world::{Lane, LaneId, LaneMap, RoadblockId};
use std::collections::BTreeMap;

/// Length of a lane or connector that is cut off a predecessor, m.
pub const STITCH: f64 = 0.1;
/// Length of the lane at an open end of a connector, m.
pub(crate) const OPEN_END: f64 = 1.0;
/// Width of inserted lanes and connectors, m.
const WIDTH: f64 = 3.5;
/// Ends nearer than this touch, m.
const TOUCHING: f64 = 1e-3;

/// A row of `lanes_polygons` with its baseline path.
#[derive(Debug, Clone)]
pub(super) struct LaneRow {
    pub(super) fid: i64,
    pub(super) centerline: Polyline,
    pub(super) polygon: Polygon,
    pub(super) group: i64,
    /// The lane of the map; `None` for an inserted one.
    pub(super) source: Option<LaneId>,
}

/// A row of `lane_connectors` with its area and baseline path.
#[derive(Debug, Clone)]
pub(super) struct ConnectorRow {
    pub(super) fid: i64,
    pub(super) centerline: Polyline,
    pub(super) polygon: Polygon,
    pub(super) exit_lane: i64,
    pub(super) entry_lane: i64,
    pub(super) group: i64,
    /// The connector of the map; `None` for an inserted one.
    pub(super) source: Option<LaneId>,
}

/// A row of `lane_groups_polygons`.
#[derive(Debug, Clone)]
pub(super) struct GroupRow {
    pub(super) fid: i64,
    /// The pieces of its area.
    pub(super) areas: Vec<Polygon>,
}

/// A row of `lane_group_connectors`.
#[derive(Debug, Clone)]
pub(super) struct GroupConnectorRow {
    pub(super) fid: i64,
    /// The pieces of its area.
    pub(super) areas: Vec<Polygon>,
    pub(super) from: i64,
    pub(super) to: i64,
    /// The roadblock connector of the map; `None` for an inserted one.
    pub(super) source: Option<RoadblockId>,
}

/// Lanes, connectors and their groups with nuPlan's relations, each in order of its ids.
#[derive(Debug, Clone, Default)]
pub(super) struct Graph {
    pub(super) lanes: Vec<LaneRow>,
    pub(super) connectors: Vec<ConnectorRow>,
    /// Roadblocks.
    pub(super) groups: Vec<GroupRow>,
    /// Roadblock connectors.
    pub(super) group_connectors: Vec<GroupConnectorRow>,
    /// Id of each roadblock and roadblock connector, by its index in the map.
    pub(super) block_fids: Vec<i64>,
    pub(super) changes: ExportChanges,
}

/// The lane at an end of a connector.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum End {
    Lane(LaneId),
    /// The lane inserted between two connectors.
    Between(LaneId, LaneId),
    /// The lane inserted at the open start of this connector.
    OpenStart(LaneId),
    /// The lane inserted at the open end of this connector.
    OpenFinish(LaneId),
}

impl Graph {
    /// Fails when an inserted piece has no extent.
    pub(super) fn from_map(map: &LaneMap) -> Result<Self, GeometryError> {
        GraphBuilder::new(map).fit()
    }

    /// Ids of the rows of each connector of the map.
    pub(super) fn connectors_by_lane(&self) -> BTreeMap<LaneId, Vec<i64>> {
        let mut by_lane: BTreeMap<LaneId, Vec<i64>> = BTreeMap::new();
        for row in &self.connectors {
            if let Some(lane) = row.source {
                by_lane.entry(lane).or_default().push(row.fid);
            }
        }
        by_lane
    }
}

struct GraphBuilder<'m> {
    map: &'m LaneMap,
    lane_fids: Vec<i64>,
    free: FreeIds,
    free_blocks: FreeIds,
    ends: BTreeMap<End, i64>,
    group_of_lane: BTreeMap<i64, i64>,
    group_connectors: BTreeMap<(Option<RoadblockId>, i64, i64), i64>,
    graph: Graph,
}

impl<'m> GraphBuilder<'m> {
    fn new(map: &'m LaneMap) -> Self {
        let lane_fids = feature_ids(map.lanes().iter().map(|lane| (lane.kind, lane.source_id)));
        let block_fids = feature_ids(
            map.roadblocks()
                .iter()
                .map(|block| (block.kind, block.source_id)),
        );
        Self {
            map,
            free: FreeIds::after(&lane_fids),
            free_blocks: FreeIds::after(&block_fids),
            lane_fids,
            ends: BTreeMap::new(),
            group_of_lane: BTreeMap::new(),
            group_connectors: BTreeMap::new(),
            graph: Graph {
                block_fids,
                ..Graph::default()
            },
        }
    }

    fn fit(mut self) -> Result<Graph, GeometryError> {
        for block in self
            .map
            .roadblocks()
            .iter()
            .filter(|block| block.kind == planagent_world::LaneKind::Lane)
        {
            let fid = self.graph.block_fids[block.id.index()];
            self.graph.groups.push(GroupRow {
                fid,
                areas: block.areas.clone(),
            });
        }
        // All lanes before any connector: a connector names both of its lanes.
        for lane in self.map.lanes().iter().filter(|lane| !lane.is_connector()) {
            self.add_lane(lane);
        }
        for lane in self.map.lanes() {
            if lane.is_connector() {
                self.add_connector(lane)?;
            } else {
                self.join_directly(lane)?;
            }
        }
        let graph = &mut self.graph;
        graph.lanes.sort_by_key(|row| row.fid);
        graph.connectors.sort_by_key(|row| row.fid);
        graph.groups.sort_by_key(|row| row.fid);
        graph.group_connectors.sort_by_key(|row| row.fid);
        cut_inserted(&mut graph.lanes, &mut graph.groups);
        Ok(self.graph)
    }

    /// Adds a lane of the map, shortened where a connector is cut off it.
    fn add_lane(&mut self, lane: &Lane) {
        let stitched = lane.outgoing.iter().any(|&next| {
            let next = &self.map[next];
            !next.is_connector() && touch(lane, next)
        });
        let whole = &lane.centerline;
        let cut = stitched
            .then(|| whole.slice(0.0, whole.length() - stitch(lane)))
            .flatten();
        let fid = self.lane_fids[lane.id.index()];
        let group = self.graph.block_fids[lane.roadblock.index()];
        self.ends.insert(End::Lane(lane.id), fid);
        self.group_of_lane.insert(fid, group);
        let centerline = cut.unwrap_or_else(|| whole.clone());
        self.graph.lanes.push(LaneRow {
            fid,
            centerline,
            polygon: lane.polygon.clone(),
            group,
            source: Some(lane.id),
        });
    }

    /// Inserts connectors from a lane to its direct successors.
    fn join_directly(&mut self, lane: &Lane) -> Result<(), GeometryError> {
        for &next in lane
            .outgoing
            .iter()
            .filter(|&&next| !self.map[next].is_connector())
        {
            let centerline = joint(lane, &self.map[next])?;
            let fid = self.free.take();
            let (exit_lane, entry_lane) = (
                self.lane_fids[lane.id.index()],
                self.lane_fids[next.index()],
            );
            let polygon = strip(&centerline)?;
            let group =
                self.group_connector(None, exit_lane, entry_lane, std::slice::from_ref(&polygon));
            self.graph.changes.inserted_connectors += 1;
            let row = ConnectorRow {
                fid,
                centerline,
                polygon,
                exit_lane,
                entry_lane,
                group,
                source: None,
            };
            self.graph.connectors.push(row);
        }
        Ok(())
    }

    /// Adds a connector of the map, once for each pair of lanes that it joins.
    fn add_connector(&mut self, lane: &Lane) -> Result<(), GeometryError> {
        let end = |id: LaneId, between: End| {
            if self.map[id].is_connector() {
                between
            } else {
                End::Lane(id)
            }
        };
        let mut starts: Vec<End> = lane
            .incoming
            .iter()
            .map(|&i| end(i, End::Between(i, lane.id)))
            .collect();
        let mut finishes: Vec<End> = lane
            .outgoing
            .iter()
            .map(|&o| end(o, End::Between(lane.id, o)))
            .collect();
        if starts.is_empty() {
            starts.push(End::OpenStart(lane.id));
        }
        if finishes.is_empty() {
            finishes.push(End::OpenFinish(lane.id));
        }
        // The first copy keeps the number, so that a map which obeys nuPlan's rules keeps all of
        // its own.
        let mut own = Some(self.lane_fids[lane.id.index()]);
        for &start in &starts {
            for &finish in &finishes {
                let (exit_lane, entry_lane) = (self.end_lane(start)?, self.end_lane(finish)?);
                let fid = own.take().unwrap_or_else(|| {
                    self.graph.changes.connectors_repeated += 1;
                    self.free.take()
                });
                let areas = &self.map[lane.roadblock].areas;
                let group =
                    self.group_connector(Some(lane.roadblock), exit_lane, entry_lane, areas);
                let whole = &lane.centerline;
                let cut = match finish {
                    End::Between(_, next) if touch(lane, &self.map[next]) => {
                        whole.slice(0.0, whole.length() - stitch(lane))
                    }
                    _ => None,
                };
                self.graph.connectors.push(ConnectorRow {
                    fid,
                    centerline: cut.unwrap_or_else(|| whole.clone()),
                    polygon: lane.polygon.clone(),
                    exit_lane,
                    entry_lane,
                    group,
                    source: Some(lane.id),
                });
            }
        }
        Ok(())
    }

    /// The lane at an end of a connector, inserted if it is missing.
    fn end_lane(&mut self, end: End) -> Result<i64, GeometryError> {
        if let Some(&fid) = self.ends.get(&end) {
            return Ok(fid);
        }
        let centerline = match end {
            // Every lane of the map was added before.
            End::Lane(lane) => return Ok(self.lane_fids[lane.index()]),
            End::Between(first, second) => {
                self.graph.changes.inserted_lanes += 1;
                joint(&self.map[first], &self.map[second])?
            }
            End::OpenStart(lane) => {
                self.graph.changes.open_ends_closed += 1;
                let start = self.map[lane].centerline.pose_at(0.0);
                Polyline::new([
                    start.translated(-OPEN_END, 0.0).position(),
                    start.position(),
                ])?
            }
            End::OpenFinish(lane) => {
                self.graph.changes.open_ends_closed += 1;
                let line = &self.map[lane].centerline;
                let finish = line.pose_at(line.length());
                Polyline::new([
                    finish.position(),
                    finish.translated(OPEN_END, 0.0).position(),
                ])?
            }
        };
        let (fid, group) = (self.free.take(), self.free_blocks.take());
        let polygon = strip(&centerline)?;
        self.graph.groups.push(GroupRow {
            fid: group,
            areas: vec![polygon.clone()],
        });
        self.graph.lanes.push(LaneRow {
            fid,
            centerline,
            polygon,
            group,
            source: None,
        });
        self.ends.insert(end, fid);
        self.group_of_lane.insert(fid, group);
        Ok(fid)
    }

    /// The roadblock connector of `source` between the roadblocks of two lanes.
    fn group_connector(
        &mut self,
        source: Option<RoadblockId>,
        exit: i64,
        entry: i64,
        areas: &[Polygon],
    ) -> i64 {
        let group = |lane: i64| {
            self.group_of_lane
                .get(&lane)
                .copied()
                .expect("every lane of the graph has a group")
        };
        let (from, to) = (group(exit), group(entry));
        if let Some(&fid) = self.group_connectors.get(&(source, from, to)) {
            return fid;
        }
        // As with connectors: the first copy keeps the roadblock's number.
        let taken = self
            .graph
            .group_connectors
            .iter()
            .any(|row| row.source == source);
        let own = source
            .filter(|_| !taken)
            .map(|block| self.graph.block_fids[block.index()]);
        let fid = own.unwrap_or_else(|| self.free_blocks.take());
        self.group_connectors.insert((source, from, to), fid);
        self.graph.group_connectors.push(GroupConnectorRow {
            fid,
            areas: areas.to_vec(),
            from,
            to,
            source,
        });
        fid
    }
}

/// Whether the second lane starts where the first ends.
fn touch(lane: &Lane, next: &Lane) -> bool {
    (next.centerline.start() - lane.centerline.end()).norm() < TOUCHING
}

/// Length to cut off the end of a lane.
fn stitch(lane: &Lane) -> f64 {
    STITCH.min(lane.centerline.length() / 2.0)
}

/// The piece between two successive lanes: the end of the first, or the line over the gap.
fn joint(lane: &Lane, next: &Lane) -> Result<Polyline, GeometryError> {
    let whole = &lane.centerline;
    if touch(lane, next) {
        let from = whole.point_at(whole.length() - stitch(lane));
        whole
            .slice(whole.length() - stitch(lane), whole.length())
            .map_or_else(|| Polyline::new([from, whole.end()]), Ok)
    } else {
        Polyline::new([whole.end(), next.centerline.start()])
    }
}

/// The area around a short line.
fn strip(line: &Polyline) -> Result<Polygon, GeometryError> {
    let (from, to): (Point, Point) = (line.start(), line.end());
    let along = to - from;
    let middle =
        planagent_world::geometry::Pose::at(nalgebra::center(&from, &to), along.y.atan2(along.x));
    Polygon::new(OrientedBox::new(middle, along.norm(), WIDTH).corners())
}
