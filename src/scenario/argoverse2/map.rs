//! The lane map of a log: Argoverse 2's lanes and areas, and nuPlan's other layers from
//! `scenario::recording`.
//!
//! * A centerline is the middle between the boundaries, as in Argoverse's map reader: both are
//!   sampled at equal shares of their lengths, and opposite samples are averaged. Argoverse takes
//!   ten samples per lane, this module one per meter and at least ten, since connectors bend. A
//!   boundary may be a single point (the inside of a cul-de-sac).
//! * A lane's area lies between its boundaries, without the areas of earlier lanes
//!   (`recording::map`).
//! * Lanes with `is_intersection` are connectors, and every cluster of them is an intersection.
//! * Bike lanes are not part of the lane graph, since nuPlan's lanes are for motor vehicles. They
//!   stay drivable. Bus lanes are lanes.
//! * Neighbors of the opposite direction are dropped, as in nuPlan.
//! * Relations to lanes outside the map are dropped: each log has the map within 100 m of its ego.
//! * The drivable areas are nuPlan's generic ones. Their borders are road edges, except between two
//!   areas.
//! * There are no speed limits and no traffic lights.

use super::error::LogFault;
use super::map_file::{LaneSegment, LaneType, MapFile, Waypoint, places};
use crate::recording::error::RecordingFault;
use crate::recording::junctions::{Cluster, clusters, crossings};
use crate::recording::lanes::{Beside, Ends, Places, RecordedLane, Sides};
use crate::recording::map::{self, Layers, separate};
use crate::recording::trace::{Place, Trace, local_points};
use planagent_world::LaneMap;
use planagent_world::geometry::{Point, Polygon, Polyline, Vector};
use std::collections::{BTreeMap, BTreeSet};

/// Minimum number of samples of a centerline: Argoverse's number.
const MIN_SAMPLES: usize = 10;
/// Distance between samples of a longer centerline, meters.
const SAMPLE_STEP: f64 = 1.0;

/// Derives the map; `origin` becomes the point (0, 0).
pub(super) fn lane_map(file: &MapFile, city: &str, origin: Vector) -> Result<LaneMap, LogFault> {
    let segments = motor_lanes(file)?;
    let mut lines: Vec<(&LaneSegment, Trace)> = Vec::new();
    let mut links = Places::default();
    for segment in segments {
        match centerline(segment, origin)? {
            Some(trace) => {
                links.lanes.insert(segment.id, lines.len());
                lines.push((segment, trace));
            }
            None => drop(links.passages.insert(segment.id, &segment.successors)),
        }
    }
    let mut areas = lines
        .iter()
        .map(|(segment, _)| area(segment, origin))
        .collect::<Result<Vec<_>, _>>()?;
    let lanes = recorded_lanes(lines, &links);
    let connector: Vec<bool> = lanes.iter().map(|lane| lane.flagged).collect();
    separate(&mut areas, &connector);
    let clusters = clusters(&lanes, &connector, &crossings(&lanes));
    // Argoverse flags the lanes of intersections itself, so each cluster is one, also without a
    // crossing.
    let clusters: Vec<Cluster> = clusters
        .into_iter()
        .map(|cluster| Cluster {
            intersection: true,
            ..cluster
        })
        .collect();
    let drivable = drivable_areas(file, origin)?;
    let layers = Layers {
        name: format!("argoverse 2 {city}, origin ({}, {})", origin.x, origin.y),
        lanes: &lanes,
        connector: &connector,
        areas,
        clusters: &clusters,
        edges: &road_edges(file, &drivable, origin)?,
        lit: BTreeSet::new(),
        stop_lines: Vec::new(),
        crosswalks: crosswalks(file, origin)?,
        generic_drivable: drivable,
    };
    Ok(map::lane_map(layers).map_err(RecordingFault::from)?)
}

/// Number of lanes for motor vehicles with a length.
pub(super) fn lane_count(file: &MapFile) -> usize {
    let lanes = file.lane_segments.values().filter(|segment| {
        let origin = segment
            .left_lane_boundary
            .first()
            .map_or_else(Vector::zeros, |first| Vector::new(first.x, first.y));
        segment.lane_type != LaneType::Bike
            && centerline(segment, origin).is_ok_and(|line| line.is_some())
    });
    lanes.count()
}

/// The lane segments for motor vehicles, in order of id.
fn motor_lanes(file: &MapFile) -> Result<Vec<&LaneSegment>, LogFault> {
    let mut by_id: BTreeMap<i64, &LaneSegment> = BTreeMap::new();
    for segment in file.lane_segments.values() {
        if by_id.insert(segment.id, segment).is_some() {
            return Err(RecordingFault::DuplicateId {
                layer: "lane segment",
                id: segment.id,
            }
            .into());
        }
    }
    Ok(by_id
        .into_values()
        .filter(|segment| segment.lane_type != LaneType::Bike)
        .collect())
}

fn recorded_lanes(lines: Vec<(&LaneSegment, Trace)>, links: &Places<'_>) -> Vec<RecordedLane> {
    let ends = lines.iter().map(|(lane, _)| Ends {
        entries: &lane.predecessors,
        exits: &lane.successors,
    });
    let joints = links.joints(ends);
    let lanes = lines
        .into_iter()
        .enumerate()
        .map(|(place, (segment, trace))| {
            let beside = |id: Option<i64>| -> Vec<Beside> {
                let lane = id
                    .and_then(|id| links.lanes.get(&id).copied())
                    .filter(|&lane| lane != place);
                lane.map(|lane| Beside {
                    lane,
                    from_s: 0.0,
                    to_s: trace.line.length(),
                })
                .into_iter()
                .collect()
            };
            RecordedLane {
                id: segment.id,
                flagged: segment.is_intersection,
                speed_limit: None,
                entries: joints.before(place),
                exits: joints.after(place),
                neighbors: Sides {
                    left: beside(segment.left_neighbor_id),
                    right: beside(segment.right_neighbor_id),
                },
                trace,
            }
        });
    let mut lanes: Vec<RecordedLane> = lanes.collect();
    // After all lanes exist: whether a neighbor goes in the same direction is read off its own
    // trace.
    let along: Vec<Sides<Vec<Beside>>> = lanes
        .iter()
        .map(|lane| {
            Sides::each(|side| {
                let listed = lane
                    .neighbors
                    .at(side)
                    .iter()
                    .filter(|beside| beside.one_direction(&lane.trace, &lanes));
                listed.copied().collect()
            })
        })
        .collect();
    for (lane, along) in lanes.iter_mut().zip(along) {
        lane.neighbors = along;
    }
    lanes
}

/// The line between the boundaries; `None` if it has no length.
fn centerline(segment: &LaneSegment, origin: Vector) -> Result<Option<Trace>, LogFault> {
    let sides = [
        places(&segment.left_lane_boundary),
        places(&segment.right_lane_boundary),
    ];
    let mut longest: f64 = 0.0;
    for side in &sides {
        // Invalid points are an error, whatever the length of the boundary.
        let trace = Trace::from_points(segment.id, side, origin)?;
        longest = longest.max(trace.map_or(0.0, |trace| trace.line.length()));
    }
    let count = ((longest / SAMPLE_STEP).ceil() as usize + 1).max(MIN_SAMPLES);
    let [left, right] = sides.map(|side| evenly(&side, count));
    let (Some(left), Some(right)) = (left, right) else {
        return Err(LogFault::NoArea { id: segment.id });
    };
    let middle: Vec<Place> = left
        .iter()
        .zip(&right)
        .map(|(l, r)| nalgebra::center(l, r))
        .collect();
    Ok(Trace::from_points(segment.id, &middle, origin)?)
}

/// `count` points at equal distances along a line, both ends included. All are equal if the line is
/// a point; `None` if it has no point.
fn evenly(line: &[Place], count: usize) -> Option<Vec<Place>> {
    let first = line.first()?;
    let mut arcs = vec![0.0];
    for pair in line.windows(2) {
        arcs.push(arcs[arcs.len() - 1] + (pair[1].xy() - pair[0].xy()).norm());
    }
    let length = arcs[arcs.len() - 1];
    let at = |s: f64| {
        let after = arcs
            .partition_point(|&arc| arc < s)
            .clamp(1, line.len() - 1);
        let step = arcs[after] - arcs[after - 1];
        let share = if step > 0.0 {
            ((s - arcs[after - 1]) / step).clamp(0.0, 1.0)
        } else {
            0.0
        };
        line[after - 1] + (line[after] - line[after - 1]) * share
    };
    if line.len() < 2 || length <= 0.0 {
        return Some(vec![*first; count]);
    }
    Some(
        (0..count)
            .map(|i| at(length * i as f64 / (count - 1) as f64))
            .collect(),
    )
}

/// The area between the boundaries.
fn area(segment: &LaneSegment, origin: Vector) -> Result<Polygon, LogFault> {
    let left = local_points(segment.id, &places(&segment.left_lane_boundary), origin)?;
    let right = local_points(segment.id, &places(&segment.right_lane_boundary), origin)?;
    let ring = left.into_iter().chain(right.into_iter().rev());
    Polygon::new(ring).map_err(|_| LogFault::NoArea { id: segment.id })
}

fn drivable_areas(file: &MapFile, origin: Vector) -> Result<Vec<Polygon>, LogFault> {
    let mut areas = Vec::new();
    for area in file.drivable_areas.values() {
        // Outlines without an area bound nothing.
        areas.extend(
            Polygon::new(local_points(area.id, &places(&area.area_boundary), origin)?).ok(),
        );
    }
    Ok(areas)
}

/// The convex hulls of both edges of each crosswalk.
fn crosswalks(file: &MapFile, origin: Vector) -> Result<Vec<Polygon>, LogFault> {
    let mut areas = Vec::new();
    for crossing in file.pedestrian_crossings.values() {
        let edges: Vec<Waypoint> = crossing
            .edge1
            .iter()
            .chain(&crossing.edge2)
            .copied()
            .collect();
        areas.extend(
            Polygon::convex_hull(&local_points(crossing.id, &places(&edges), origin)?).ok(),
        );
    }
    Ok(areas)
}

/// Borders of the drivable areas with a non-drivable side, segment by segment.
fn road_edges(
    file: &MapFile,
    drivable: &[Polygon],
    origin: Vector,
) -> Result<Vec<Trace>, LogFault> {
    /// Distance of the tested points from a border, meters.
    const BESIDE: f64 = 0.2;
    let holds = |point: Point| drivable.iter().any(|area| area.contains(point));
    let mut edges = Vec::new();
    for area in file.drivable_areas.values() {
        let ring = places(&area.area_boundary);
        for (from, to) in ring.iter().zip(ring.iter().cycle().skip(1)) {
            let Some(trace) = Trace::from_points(area.id, &[*from, *to], origin)? else {
                continue;
            };
            let line: &Polyline = &trace.line;
            let middle = line.length() / 2.0;
            if !(holds(line.frenet_to_map(middle, BESIDE))
                && holds(line.frenet_to_map(middle, -BESIDE)))
            {
                edges.push(trace);
            }
        }
    }
    Ok(edges)
}
