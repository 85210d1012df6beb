//! The lane map: nuPlan's layers as plain data with checked relations.

use crate::geometry::{Polygon, Polyline, SpatialIndex};
use std::collections::BTreeMap;
use std::ops::Index;

macro_rules! map_id {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize)]
        #[serde(transparent)]
        pub struct $name(pub u32);

        impl $name {
            /// Position in the map's list.
            #[inline]
            pub fn index(self) -> usize {
                self.0 as usize
            }
        }
    };
}

map_id!(
    /// A lane or lane connector: its place in [`LaneMap::lanes`].
    LaneId
);
map_id!(
    /// A roadblock or roadblock connector: its place in [`LaneMap::roadblocks`].
    RoadblockId
);
map_id!(
    /// A stop line: its place in [`LaneMap::stop_lines`].
    StopLineId
);

/// The two kinds of nuPlan's graph edges.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LaneKind {
    /// A lane of a road.
    Lane,
    /// A lane across an intersection.
    Connector,
}

/// Where the areas of a map's lanes come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
pub enum LaneAreas {
    /// The source draws them, and they cover the road, as nuPlan's do.
    Drawn,
    /// Derived from other layers of the source, or of unknown origin: they may leave gaps.
    #[default]
    Derived,
}

/// A neighboring lane of the same direction, along a part of this lane.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Neighbor {
    /// The lane beside.
    pub lane: LaneId,
    /// Where on this lane's centerline the neighborhood begins, meters.
    pub from_s: f64,
    /// Where it ends, meters.
    pub to_s: f64,
}

/// A lane or a lane connector.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Lane {
    /// Its place in the map.
    pub id: LaneId,
    /// Its id in the source (Waymo feature id, nuPlan fid).
    pub source_id: i64,
    /// Lane or connector.
    pub kind: LaneKind,
    /// The baseline path, in driving direction.
    pub centerline: Polyline,
    /// The area of the lane.
    pub polygon: Polygon,
    /// Edges that lead into this one.
    pub incoming: Vec<LaneId>,
    /// Edges that this one leads to.
    pub outgoing: Vec<LaneId>,
    /// Lanes of the same direction to the left.
    pub left: Vec<Neighbor>,
    /// Lanes of the same direction to the right.
    pub right: Vec<Neighbor>,
    /// The roadblock that holds it.
    pub roadblock: RoadblockId,
    /// Speed limit, m/s; connectors of nuPlan have none.
    pub speed_limit: Option<f64>,
    /// Whether a traffic light ever governs it.
    pub has_traffic_lights: bool,
    /// Its stop lines.
    pub stop_lines: Vec<StopLineId>,
}

impl Lane {
    /// Whether this is a lane connector.
    #[inline]
    pub fn is_connector(&self) -> bool {
        self.kind == LaneKind::Connector
    }

    /// The left neighbor at arc length `s`.
    pub fn left_at(&self, s: f64) -> Option<LaneId> {
        neighbor_at(&self.left, s)
    }

    /// The right neighbor at arc length `s`.
    pub fn right_at(&self, s: f64) -> Option<LaneId> {
        neighbor_at(&self.right, s)
    }
}

fn neighbor_at(neighbors: &[Neighbor], s: f64) -> Option<LaneId> {
    neighbors
        .iter()
        .find(|n| n.from_s <= s && s <= n.to_s)
        .map(|n| n.lane)
}

/// Lanes side by side in one direction, or the connectors that join two such sets.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Roadblock {
    /// Its place in the map.
    pub id: RoadblockId,
    /// Its id in the source.
    pub source_id: i64,
    /// Of lanes (a roadblock) or of connectors (a roadblock connector).
    pub kind: LaneKind,
    /// Its lanes.
    pub lanes: Vec<LaneId>,
    /// Its area, as pieces.
    pub areas: Vec<Polygon>,
    /// Roadblocks that lead into it.
    pub incoming: Vec<RoadblockId>,
    /// Roadblocks that it leads to.
    pub outgoing: Vec<RoadblockId>,
}

/// A stop line as a thin polygon across the lane.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct StopLine {
    /// Its area.
    pub polygon: Polygon,
    /// The edges that must stop there.
    pub lanes: Vec<LaneId>,
    /// Whether it belongs to a stop sign rather than a traffic light.
    pub stop_sign: bool,
}

/// The layers of a map before their relations are checked.
#[derive(Debug, Clone, Default, serde::Serialize, serde::Deserialize)]
pub struct MapParts {
    /// Name of the map or its origin.
    pub name: String,
    /// Lanes and connectors; the n-th must have id n.
    pub lanes: Vec<Lane>,
    /// Where their areas come from.
    pub lane_areas: LaneAreas,
    /// Roadblocks and their connectors; the n-th must have id n.
    pub roadblocks: Vec<Roadblock>,
    /// Stop lines.
    pub stop_lines: Vec<StopLine>,
    /// Intersections.
    pub intersections: Vec<Polygon>,
    /// Crosswalks.
    pub crosswalks: Vec<Polygon>,
    /// The road itself, lanes and shoulders (nuPlan: `road_segments`); a part of the drivable area,
    /// unlike roadblocks.
    pub road_segments: Vec<Polygon>,
    /// Drivable area beside road segments and intersections (nuPlan: `generic_drivable_areas`).
    pub generic_drivable: Vec<Polygon>,
    /// Car parks.
    pub carparks: Vec<Polygon>,
}

/// Maximum distance between two vertices of a baseline, meters. nuPlan's rules for paths go from
/// vertex to vertex and drop the last one (devkit `idm/utils.py`), so a sparse baseline ends too
/// early. Ours: nuPlan's maps state no spacing; the devkit runs on maps with this one.
pub const BASELINE_SPACING: f64 = 0.5;

impl MapParts {
    /// Gives the centerlines vertices at least every [`BASELINE_SPACING`]: for sources other than
    /// nuPlan's maps, which are taken as they are.
    pub fn with_dense_baselines(mut self) -> Self {
        let sparse: Vec<f64> = self
            .lanes
            .iter()
            .map(|lane| lane.centerline.length())
            .collect();
        for (lane, before) in self.lanes.iter_mut().zip(sparse) {
            lane.centerline = lane.centerline.densified(BASELINE_SPACING);
            // Neighbors along the whole lane stay so whatever the length was rounded to.
            let whole = lane.centerline.length();
            for neighbor in lane
                .left
                .iter_mut()
                .chain(&mut lane.right)
                .filter(|neighbor| neighbor.to_s >= before)
            {
                neighbor.to_s = whole;
            }
        }
        self
    }

    /// Adds the areas of all roadblocks to the road segments: for sources that do not draw that
    /// layer.
    pub fn with_roadblocks_as_road(mut self) -> Self {
        self.road_segments.extend(
            self.roadblocks
                .iter()
                .flat_map(|block| block.areas.iter().cloned()),
        );
        self
    }
}

/// Why layers make no map.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the message of a variant says what it is")]
#[non_exhaustive]
pub enum MapError {
    #[error("the map has no lanes")]
    NoLanes,
    #[error("{layer} number {index} has id {id}")]
    Misplaced {
        layer: &'static str,
        index: usize,
        id: u32,
    },
    #[error(
        "{layer} {id} (source id {source_id}): its {relation} names number {target}, which does not exist"
    )]
    Dangling {
        layer: &'static str,
        id: u32,
        source_id: i64,
        relation: &'static str,
        target: u32,
    },
}

/// A map whose every relation is known to hold, with spatial indices over its layers.
#[derive(Debug, Clone)]
pub struct LaneMap {
    pub(super) parts: MapParts,
    pub(super) by_source: BTreeMap<i64, LaneId>,
    pub(super) lane_index: SpatialIndex,
    pub(super) block_index: SpatialIndex,
    /// Areas of all roadblocks in one list, with the roadblock of each.
    pub(super) block_areas: Vec<(RoadblockId, usize)>,
    pub(super) intersection_index: SpatialIndex,
    pub(super) crosswalk_index: SpatialIndex,
    pub(super) road_index: SpatialIndex,
    pub(super) generic_index: SpatialIndex,
    pub(super) carpark_index: SpatialIndex,
    pub(super) stop_index: SpatialIndex,
}

impl LaneMap {
    /// Checks the relations and builds the indices. Baselines are taken as they are; see
    /// [`MapParts::with_dense_baselines`].
    ///
    /// # Errors
    /// When there is no lane, an id does not match its place, or a relation dangles.
    pub fn new(parts: MapParts) -> Result<Self, MapError> {
        check(&parts)?;
        let by_source = parts
            .lanes
            .iter()
            .map(|lane| (lane.source_id, lane.id))
            .collect();
        let block_areas: Vec<(RoadblockId, usize)> = parts
            .roadblocks
            .iter()
            .flat_map(|b| (0..b.areas.len()).map(move |i| (b.id, i)))
            .collect();
        let areas = |polygons: &[Polygon]| SpatialIndex::new(polygons.iter().map(Polygon::bounds));
        // The indices hold places in `parts`, so `parts` moves in last and is not changed
        // afterwards.
        Ok(Self {
            by_source,
            lane_index: SpatialIndex::new(parts.lanes.iter().map(|lane| lane.polygon.bounds())),
            block_index: SpatialIndex::new(
                parts
                    .roadblocks
                    .iter()
                    .flat_map(|b| b.areas.iter().map(Polygon::bounds)),
            ),
            block_areas,
            intersection_index: areas(&parts.intersections),
            crosswalk_index: areas(&parts.crosswalks),
            road_index: areas(&parts.road_segments),
            generic_index: areas(&parts.generic_drivable),
            carpark_index: areas(&parts.carparks),
            stop_index: SpatialIndex::new(
                parts.stop_lines.iter().map(|line| line.polygon.bounds()),
            ),
            parts,
        })
    }

    /// The same map with dense baselines; see [`MapParts::with_dense_baselines`].
    pub fn with_dense_baselines(mut self) -> Self {
        self.parts = std::mem::take(&mut self.parts).with_dense_baselines();
        self
    }

    /// The layers.
    #[doc(hidden)]
    pub fn parts(&self) -> &MapParts {
        &self.parts
    }

    /// Name of the map.
    pub fn name(&self) -> &str {
        &self.parts.name
    }

    /// All lanes and connectors.
    #[inline]
    pub fn lanes(&self) -> &[Lane] {
        &self.parts.lanes
    }

    /// Where the areas of the lanes come from.
    pub fn lane_areas(&self) -> LaneAreas {
        self.parts.lane_areas
    }

    /// All roadblocks and roadblock connectors.
    #[inline]
    pub fn roadblocks(&self) -> &[Roadblock] {
        &self.parts.roadblocks
    }

    /// All stop lines.
    #[inline]
    pub fn stop_lines(&self) -> &[StopLine] {
        &self.parts.stop_lines
    }

    /// All intersections.
    #[inline]
    pub fn intersections(&self) -> &[Polygon] {
        &self.parts.intersections
    }

    /// All crosswalks.
    #[inline]
    pub fn crosswalks(&self) -> &[Polygon] {
        &self.parts.crosswalks
    }

    /// The road itself, lanes and shoulders.
    pub fn road_segments(&self) -> &[Polygon] {
        &self.parts.road_segments
    }

    /// Drivable area beside road segments and intersections.
    pub fn generic_drivable(&self) -> &[Polygon] {
        &self.parts.generic_drivable
    }

    /// Car parks.
    pub fn carparks(&self) -> &[Polygon] {
        &self.parts.carparks
    }

    /// The lane with this id in the source.
    pub fn lane_by_source(&self, source_id: i64) -> Option<LaneId> {
        self.by_source.get(&source_id).copied()
    }
}

impl Index<LaneId> for LaneMap {
    type Output = Lane;

    #[inline]
    fn index(&self, id: LaneId) -> &Lane {
        &self.parts.lanes[id.index()]
    }
}

impl Index<RoadblockId> for LaneMap {
    type Output = Roadblock;

    #[inline]
    fn index(&self, id: RoadblockId) -> &Roadblock {
        &self.parts.roadblocks[id.index()]
    }
}

impl Index<StopLineId> for LaneMap {
    type Output = StopLine;

    #[inline]
    fn index(&self, id: StopLineId) -> &StopLine {
        &self.parts.stop_lines[id.index()]
    }
}

fn check(parts: &MapParts) -> Result<(), MapError> {
    if parts.lanes.is_empty() {
        return Err(MapError::NoLanes);
    }
    // Ids are places in the lists of the map, so an unknown one would be an index beyond its list.
    let (lanes, blocks, stops) = (
        parts.lanes.len(),
        parts.roadblocks.len(),
        parts.stop_lines.len(),
    );
    for (index, lane) in parts.lanes.iter().enumerate() {
        if lane.id.index() != index {
            return Err(MapError::Misplaced {
                layer: "lane",
                index,
                id: lane.id.0,
            });
        }
        let neighbors = |side: &[Neighbor]| side.iter().map(|n| n.lane.0).collect::<Vec<_>>();
        let ids = |list: &[LaneId]| list.iter().map(|id| id.0).collect::<Vec<_>>();
        for (relation, targets, count) in [
            ("incoming", ids(&lane.incoming), lanes),
            ("outgoing", ids(&lane.outgoing), lanes),
            ("left", neighbors(&lane.left), lanes),
            ("right", neighbors(&lane.right), lanes),
            ("roadblock", vec![lane.roadblock.0], blocks),
            (
                "stop_lines",
                lane.stop_lines.iter().map(|id| id.0).collect(),
                stops,
            ),
        ] {
            if let Some(&target) = targets.iter().find(|&&t| t as usize >= count) {
                let (id, source_id) = (lane.id.0, lane.source_id);
                return Err(MapError::Dangling {
                    layer: "lane",
                    id,
                    source_id,
                    relation,
                    target,
                });
            }
        }
    }
    for (index, block) in parts.roadblocks.iter().enumerate() {
        if block.id.index() != index {
            return Err(MapError::Misplaced {
                layer: "roadblock",
                index,
                id: block.id.0,
            });
        }
        for (relation, targets, count) in [
            (
                "lanes",
                block.lanes.iter().map(|id| id.0).collect::<Vec<_>>(),
                lanes,
            ),
            (
                "incoming",
                block.incoming.iter().map(|id| id.0).collect(),
                blocks,
            ),
            (
                "outgoing",
                block.outgoing.iter().map(|id| id.0).collect(),
                blocks,
            ),
        ] {
            if let Some(&target) = targets.iter().find(|&&t| t as usize >= count) {
                let (id, source_id) = (block.id.0, block.source_id);
                return Err(MapError::Dangling {
                    layer: "roadblock",
                    id,
                    source_id,
                    relation,
                    target,
                });
            }
        }
    }
    for (index, stop) in parts.stop_lines.iter().enumerate() {
        if let Some(lane) = stop.lanes.iter().find(|lane| lane.index() >= lanes) {
            let (id, source_id) = (index as u32, index as i64);
            return Err(MapError::Dangling {
                layer: "stop line",
                id,
                source_id,
                relation: "lanes",
                target: lane.0,
            });
        }
    }
    Ok(())
}
