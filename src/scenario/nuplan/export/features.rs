//! The rows of every layer of a map package.

use super::graph::{ConnectorRow, Graph, LaneRow};
use super::lane_order::{changed_neighbors, lane_indices};
use super::package::{Feature, LayerRows};
use super::placement::{Placement, ShapeError};
use super::stops::{StopRow, stop_rows};
use crate::nuplan::geometry_blob::StoredShape;
use crate::nuplan::schema::{self, Table};
use planagent_world::geometry::{Polygon, Polyline, borders};
use planagent_world::{BASELINE_SPACING, LaneId, LaneKind, LaneMap};
use rusqlite::types::Value;
use std::collections::BTreeMap;

/// Intersection types of nuPlan's enumeration: with traffic lights,
const TRAFFIC_LIGHT: i64 = 1;
/// with a stop sign,
const STOP_SIGN: i64 = 2;
/// and with neither.
const PASS_THROUGH: i64 = 5;
/// The intersection of a connector outside all intersections: their ids begin at 1. With NULL,
/// pandas reads the column as floating point, and the devkit finds the intersection of no connector
/// (`roadblock_connector.py`).
const NO_INTERSECTION: i64 = 0;
/// Lane type of nuPlan's enumeration: for vehicles.
const VEHICLE_LANE: i64 = 0;

/// A layer under construction.
struct LayerBuilder(LayerRows);

impl LayerBuilder {
    fn new(layer: Table) -> Self {
        Self(LayerRows {
            layer,
            features: Vec::new(),
            bounds: None,
        })
    }

    fn push(
        &mut self,
        fid: i64,
        (geometry, around): StoredShape,
        values: Vec<(&'static str, Value)>,
    ) {
        let [west, south, east, north] = self.0.bounds.unwrap_or(around);
        let [w, s, e, n] = around;
        self.0.bounds = Some([west.min(w), south.min(s), east.max(e), north.max(n)]);
        self.0.features.push(Feature {
            fid,
            geometry,
            values,
        });
    }

    fn next_fid(&self) -> i64 {
        self.0.features.len() as i64 + 1
    }
}

/// All layers of a map. What they cannot express is counted in `graph.changes`.
pub(super) fn layers(
    map: &LaneMap,
    graph: &mut Graph,
    place: &Placement,
) -> Result<Vec<LayerRows>, ShapeError> {
    let indices: BTreeMap<LaneId, i64> = map
        .roadblocks()
        .iter()
        .filter(|block| block.kind == LaneKind::Lane)
        .flat_map(|block| lane_indices(map, block))
        .collect();
    graph.changes.neighbors_changed += changed_neighbors(map, &indices);
    // Before the connectors, which name the stop lines that govern them.
    let stops = stop_rows(map, graph);
    graph.changes.inserted_stop_lines += stops.iter().filter(|stop| stop.inserted).count();
    let mut lines = Lines {
        place,
        baselines: LayerBuilder::new(schema::BASELINE_PATHS),
        boundaries: LayerBuilder::new(schema::BOUNDARIES),
    };
    let mut edges: BTreeMap<i64, GroupEdges> = BTreeMap::new();
    let lanes = lanes(map, graph, &indices, &mut lines, &mut edges)?;
    let [connectors, connector_areas] = connectors(map, graph, &stops, &mut lines, &mut edges)?;
    let [groups, group_connectors] = groups(map, graph, place, &edges)?;
    let plain = |layer: Table, areas: &[Polygon]| plain(layer, areas, place);
    let mut all = vec![
        lanes,
        connectors,
        connector_areas,
        lines.baselines,
        lines.boundaries,
        groups,
        group_connectors,
    ];
    all.push(intersections(map, place)?);
    all.push(stop_polygons(&stops, place)?);
    all.push(plain(schema::CROSSWALKS, map.crosswalks())?);
    all.push(plain(schema::CARPARK_AREAS, map.carparks())?);
    all.push(plain(schema::ROAD_SEGMENTS, map.road_segments())?);
    all.push(plain(
        schema::GENERIC_DRIVABLE_AREAS,
        map.generic_drivable(),
    )?);
    all.extend(schema::EMPTY_LAYERS.into_iter().map(LayerBuilder::new));
    Ok(all.into_iter().map(|filling| filling.0).collect())
}

/// All layers of a map that has nothing.
pub(super) fn empty_layers() -> Vec<LayerRows> {
    let all = schema::READ_LAYERS
        .into_iter()
        .filter(|layer| *layer != schema::META)
        .chain([schema::BOUNDARIES]);
    all.chain(schema::EMPTY_LAYERS)
        .map(|layer| LayerBuilder::new(layer).0)
        .collect()
}

/// The layers that lanes and connectors share: baseline paths and borders.
struct Lines<'a> {
    place: &'a Placement,
    baselines: LayerBuilder,
    boundaries: LayerBuilder,
}

impl Lines<'_> {
    /// Adds the baseline path of a lane or connector; its fid.
    fn baseline(
        &mut self,
        line: &Polyline,
        owner: &'static str,
        fid: i64,
    ) -> Result<i64, ShapeError> {
        let own = self.baselines.next_fid();
        self.baselines.push(
            own,
            self.place.line(&line.densified(BASELINE_SPACING))?,
            vec![(owner, fid.into()), ("path_type_fid", 0.into())],
        );
        Ok(own)
    }

    /// Adds the borders of a lane or connector; the fids of the left and the right one.
    fn borders(&mut self, line: &Polyline, area: &Polygon) -> Result<[i64; 2], ShapeError> {
        let found = borders(line, area);
        let mut enter = |border: &Polyline| -> Result<i64, ShapeError> {
            let own = self.boundaries.next_fid();
            self.boundaries.push(
                own,
                self.place.line(border)?,
                vec![("boundary_type_fid", 0.into())],
            );
            Ok(own)
        };
        Ok([enter(&found.left)?, enter(&found.right)?])
    }
}

/// The outermost borders of a roadblock, each as lane index and fid.
#[derive(Debug, Clone, Copy)]
struct GroupEdges {
    left: (i64, i64),
    right: (i64, i64),
}

impl GroupEdges {
    fn enter(edges: &mut BTreeMap<i64, Self>, group: i64, index: i64, [left, right]: [i64; 2]) {
        let fresh = Self {
            left: (index, left),
            right: (index, right),
        };
        let known = edges.entry(group).or_insert(fresh);
        known.left = known.left.min(fresh.left);
        known.right = if index > known.right.0 {
            fresh.right
        } else {
            known.right
        };
    }
}

fn lanes(
    map: &LaneMap,
    graph: &Graph,
    indices: &BTreeMap<LaneId, i64>,
    lines: &mut Lines<'_>,
    edges: &mut BTreeMap<i64, GroupEdges>,
) -> Result<LayerBuilder, ShapeError> {
    let mut layer = LayerBuilder::new(schema::LANES);
    for row in &graph.lanes {
        let LaneRow {
            fid,
            centerline,
            polygon,
            group,
            source,
        } = row;
        let index = source
            .and_then(|lane| indices.get(&lane).copied())
            .unwrap_or_default();
        // Borders are written before their lane, because its row names them by number.
        let borders = lines.borders(centerline, polygon)?;
        GroupEdges::enter(edges, *group, index, borders);
        lines.baseline(centerline, "lane_fid", *fid)?;
        let mut values = vec![
            ("lane_fid", (*fid).into()),
            ("lane_group_fid", (*group).into()),
            ("lane_index", index.into()),
            ("lane_type_fid", VEHICLE_LANE.into()),
            ("left_boundary_fid", borders[0].into()),
            ("right_boundary_fid", borders[1].into()),
            (
                "speed_limit_mps",
                source.and_then(|lane| map[lane].speed_limit).into(),
            ),
            ("width", (polygon.area() / centerline.length()).into()),
            ("stops", String::new().into()),
        ];
        values.extend(source.map(|lane| ("name", map[lane].source_id.to_string().into())));
        layer.push(*fid, lines.place.polygon(polygon)?, values);
    }
    Ok(layer)
}

/// Lane connectors and their areas.
fn connectors(
    map: &LaneMap,
    graph: &Graph,
    stops: &[StopRow],
    lines: &mut Lines<'_>,
    edges: &mut BTreeMap<i64, GroupEdges>,
) -> Result<[LayerBuilder; 2], ShapeError> {
    let mut layer = LayerBuilder::new(schema::LANE_CONNECTORS);
    let mut areas = LayerBuilder::new(schema::CONNECTOR_AREAS);
    let group_of: BTreeMap<i64, i64> = graph.lanes.iter().map(|row| (row.fid, row.group)).collect();
    for (place, row) in graph.connectors.iter().enumerate() {
        let ConnectorRow {
            fid,
            centerline,
            polygon,
            exit_lane,
            entry_lane,
            group,
            source,
        } = row;
        let borders = lines.borders(centerline, polygon)?;
        GroupEdges::enter(edges, *group, place as i64, borders);
        let baseline = lines.baseline(centerline, "lane_connector_fid", *fid)?;
        // Several stop lines may govern a connector, and nuPlan lists them in one column.
        let governing: Vec<i64> = stops
            .iter()
            .filter(|stop| stop.governs.contains(fid))
            .map(|stop| stop.fid)
            .collect();
        let group_fid = |lane: &i64| group_of.get(lane).copied().into();
        let values = vec![
            ("exit_lane_fid", (*exit_lane).into()),
            ("entry_lane_fid", (*entry_lane).into()),
            ("exit_lane_group_fid", group_fid(exit_lane)),
            ("entry_lane_group_fid", group_fid(entry_lane)),
            ("lane_group_connector_fid", (*group).into()),
            (
                "intersection_fid",
                intersection_of(map, centerline)
                    .unwrap_or(NO_INTERSECTION)
                    .into(),
            ),
            (
                "speed_limit_mps",
                source.and_then(|lane| map[lane].speed_limit).into(),
            ),
            ("traffic_light_stop_line_fids", listed(&governing).into()),
            ("bulb_fids", String::new().into()),
            ("overlap", 0.into()),
        ];
        layer.push(
            *fid,
            lines.place.line(&centerline.densified(BASELINE_SPACING))?,
            values,
        );
        let values = vec![
            ("lane_connector_fid", (*fid).into()),
            ("left_boundary_fid", borders[0].into()),
            ("right_boundary_fid", borders[1].into()),
            ("baseline_path_fid", baseline.into()),
        ];
        areas.push(areas.next_fid(), lines.place.polygon(polygon)?, values);
    }
    Ok([layer, areas])
}

fn groups(
    map: &LaneMap,
    graph: &Graph,
    place: &Placement,
    edges: &BTreeMap<i64, GroupEdges>,
) -> Result<[LayerBuilder; 2], ShapeError> {
    let borders = |fid: i64| {
        let known = edges.get(&fid);
        let (left, right) = (
            known.map(|edges| edges.left.1),
            known.map(|edges| edges.right.1),
        );
        [
            ("left_boundary_fid", left.into()),
            ("right_boundary_fid", right.into()),
        ]
    };
    let mut layer = LayerBuilder::new(schema::LANE_GROUPS);
    for row in &graph.groups {
        layer.push(row.fid, place.union(&row.areas)?, borders(row.fid).to_vec());
    }
    let mut connecting = LayerBuilder::new(schema::LANE_GROUP_CONNECTORS);
    for row in &graph.group_connectors {
        // A group has one intersection in nuPlan's tables, so its first connector decides.
        let first = graph
            .connectors
            .iter()
            .find(|connector| connector.group == row.fid);
        let intersection = first.and_then(|connector| intersection_of(map, &connector.centerline));
        let mut values = vec![
            (
                "intersection_fid",
                intersection.unwrap_or(NO_INTERSECTION).into(),
            ),
            ("from_lane_group_fid", row.from.into()),
            ("to_lane_group_fid", row.to.into()),
        ];
        values.extend(borders(row.fid));
        connecting.push(row.fid, place.union(&row.areas)?, values);
    }
    Ok([layer, connecting])
}

/// Fid of the intersection that holds the midpoint of a connector.
fn intersection_of(map: &LaneMap, centerline: &Polyline) -> Option<i64> {
    let middle = centerline.point_at(centerline.length() / 2.0);
    map.intersections()
        .iter()
        .position(|area| area.contains(middle))
        .map(|place| place as i64 + 1)
}

/// Intersections, with the type that follows from their connectors.
fn intersections(map: &LaneMap, place: &Placement) -> Result<LayerBuilder, ShapeError> {
    let mut layer = LayerBuilder::new(schema::INTERSECTIONS);
    for area in map.intersections() {
        let fid = layer.next_fid();
        let inside = map.lanes().iter().filter(|lane| {
            lane.is_connector() && intersection_of(map, &lane.centerline) == Some(fid)
        });
        let kind = inside.fold(PASS_THROUGH, |kind, lane| {
            let signed = lane.stop_lines.iter().any(|&stop| map[stop].stop_sign);
            match kind {
                _ if lane.has_traffic_lights => TRAFFIC_LIGHT,
                PASS_THROUGH if signed => STOP_SIGN,
                _ => kind,
            }
        });
        layer.push(
            fid,
            place.polygon(area)?,
            vec![
                ("intersection_type_fid", kind.into()),
                ("is_mini", false.into()),
            ],
        );
    }
    Ok(layer)
}

fn stop_polygons(stops: &[StopRow], place: &Placement) -> Result<LayerBuilder, ShapeError> {
    let mut layer = LayerBuilder::new(schema::STOP_POLYGONS);
    for stop in stops {
        let values = vec![
            ("stop_polygon_type_fid", stop.kind.into()),
            ("lane_fids", listed(&stop.lanes).into()),
            ("lane_connector_fids", listed(&stop.connectors).into()),
        ];
        layer.push(stop.fid, place.polygon(&stop.polygon)?, values);
    }
    Ok(layer)
}

/// A layer of areas without further columns.
fn plain(layer: Table, areas: &[Polygon], place: &Placement) -> Result<LayerBuilder, ShapeError> {
    let mut filling = LayerBuilder::new(layer);
    for area in areas {
        filling.push(filling.next_fid(), place.polygon(area)?, Vec::new());
    }
    Ok(filling)
}

/// Ids as nuPlan lists them: separated by commas.
fn listed(ids: &[i64]) -> String {
    ids.iter()
        .map(ToString::to_string)
        .collect::<Vec<_>>()
        .join(",")
}
