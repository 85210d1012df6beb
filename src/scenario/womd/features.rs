//! Map features of a recording, in local coordinates, with the relations between lanes resolved to places in a list.
//!
//! * Bike lanes are no lanes of the graph: nuPlan's lanes are for motor vehicles. Their surface is drivable where it lies
//!   between a lane and the road edge beside it.
//! * A lane of one point has no length; what leads into it leads to what it leads to.
//! * Relations to lanes that the recording does not contain are dropped.

use super::error::RecordingFault;
use super::proto::{
    Area, BoundarySegment, FeatureData, LaneCenter, LaneNeighbor, LaneType, MapFeature, MapPoint, StopSign,
};
use crate::geometry::{Point, Polygon, Vector};
use crate::scenario::recording::lanes::{Beside, Ends, Places, RecordedLane, Sides};
use crate::scenario::recording::trace::{LineFault, Place, Trace, local_points};
use std::collections::{BTreeMap, BTreeSet};

/// A line that bounds a part of a lane.
#[derive(Debug, Clone, Copy)]
pub(super) struct Boundary {
    /// Arc lengths on the lane.
    pub(super) from_s: f64,
    pub(super) to_s: f64,
    /// Place among [`MapFeatures::lines`].
    pub(super) line: usize,
}

/// A stop sign.
#[derive(Debug, Clone)]
pub(super) struct Sign {
    /// Places of the lanes that it governs.
    pub(super) lanes: Vec<usize>,
}

/// The map of a recording before anything is derived.
#[derive(Debug)]
pub(super) struct MapFeatures {
    pub(super) lanes: Vec<RecordedLane>,
    /// Lines that bound each lane.
    pub(super) boundaries: Vec<Sides<Vec<Boundary>>>,
    /// Painted lines and road edges.
    pub(super) lines: Vec<Trace>,
    /// Road edges alone.
    pub(super) edges: Vec<Trace>,
    pub(super) crosswalks: Vec<Polygon>,
    pub(super) driveways: Vec<Polygon>,
    pub(super) signs: Vec<Sign>,
}

impl MapFeatures {
    /// Reads the features; `origin` becomes the place (0, 0).
    ///
    /// # Errors
    /// When an id occurs twice or a coordinate is no place.
    pub(super) fn read(features: &[MapFeature], origin: Vector) -> Result<Self, RecordingFault> {
        let mut ids = BTreeSet::new();
        if let Some(twice) = features.iter().find(|feature| !ids.insert(feature.id)) {
            return Err(RecordingFault::DuplicateId { layer: "map feature", id: twice.id });
        }
        let mut drivable: Vec<(i64, &LaneCenter, Trace)> = Vec::new();
        let mut passages: BTreeMap<i64, &[i64]> = BTreeMap::new();
        let mut line_places = BTreeMap::new();
        let (mut lines, mut edges, mut signs): (Vec<Trace>, Vec<Trace>, Vec<&StopSign>) = Default::default();
        let (mut crosswalks, mut driveways) = (Vec::new(), Vec::new());
        for feature in features {
            let id = feature.id;
            match &feature.feature_data {
                Some(FeatureData::Lane(lane)) if lane.r#type == LaneType::BikeLane as i32 => {
                    local_points(id, &places_of(&lane.polyline), origin)?;
                }
                Some(FeatureData::Lane(lane)) => match Trace::of(id, &places_of(&lane.polyline), origin)? {
                    Some(trace) => drivable.push((id, lane, trace)),
                    None => drop(passages.insert(id, &lane.exit_lanes)),
                },
                Some(FeatureData::RoadLine(line)) => {
                    if let Some(trace) = Trace::of(id, &places_of(&line.polyline), origin)? {
                        line_places.insert(id, lines.len());
                        lines.push(trace);
                    }
                }
                Some(FeatureData::RoadEdge(edge)) => {
                    if let Some(trace) = Trace::of(id, &places_of(&edge.polyline), origin)? {
                        line_places.insert(id, lines.len());
                        lines.push(trace.clone());
                        edges.push(trace);
                    }
                }
                Some(FeatureData::StopSign(sign)) => signs.push(sign),
                Some(FeatureData::Crosswalk(area)) => crosswalks.extend(outline(id, area, origin)?),
                Some(FeatureData::Driveway(area)) => driveways.extend(outline(id, area, origin)?),
                Some(FeatureData::SpeedBump(_)) | None => {}
            }
        }
        let lanes: BTreeMap<i64, usize> = drivable.iter().enumerate().map(|(i, (id, ..))| (*id, i)).collect();
        let signs = signs
            .into_iter()
            .map(|sign| Sign { lanes: sign.lane.iter().filter_map(|id| lanes.get(id).copied()).collect() })
            .collect();
        let lookup = Lookup { places: Places { lanes, passages }, line_places };
        let boundaries = drivable.iter().map(|(_, lane, trace)| Sides {
            left: lookup.boundaries(trace, &lane.left_boundaries),
            right: lookup.boundaries(trace, &lane.right_boundaries),
        });
        let boundaries = boundaries.collect();
        let lanes = lookup.lanes(drivable);
        Ok(Self { lanes, boundaries, lines, edges, crosswalks, driveways, signs })
    }
}

/// How many lanes the map of these features has: those for motor vehicles that have a length.
pub(super) fn lane_count(features: &[MapFeature]) -> usize {
    let lanes = features.iter().filter(|feature| match &feature.feature_data {
        Some(FeatureData::Lane(lane)) if lane.r#type != LaneType::BikeLane as i32 => {
            let places = places_of(&lane.polyline);
            let origin = places.first().map_or_else(Vector::zeros, |place| place.coords.xy());
            Trace::of(feature.id, &places, origin).is_ok_and(|trace| trace.is_some())
        }
        _ => false,
    });
    lanes.count()
}

/// The places of a line or outline.
fn places_of(points: &[MapPoint]) -> Vec<Place> {
    points.iter().map(|p| Place::new(p.x, p.y, p.z)).collect()
}

/// Where the lanes and lines of the message went.
struct Lookup<'a> {
    places: Places<'a>,
    line_places: BTreeMap<i64, usize>,
}

impl Lookup<'_> {
    fn lanes(&self, drivable: Vec<(i64, &LaneCenter, Trace)>) -> Vec<RecordedLane> {
        let ends = drivable.iter().map(|(_, lane, _)| Ends { entries: &lane.entry_lanes, exits: &lane.exit_lanes });
        let joints = self.places.joints(ends);
        let features = drivable.into_iter().enumerate().map(|(place, (id, lane, trace))| RecordedLane {
            id,
            flagged: lane.interpolating,
            speed_limit: metres_per_second(lane.speed_limit_mph),
            entries: joints.iter().filter(|(_, to)| *to == place).map(|(from, _)| *from).collect(),
            exits: joints.iter().filter(|(from, _)| *from == place).map(|(_, to)| *to).collect(),
            neighbors: Sides {
                left: self.beside(place, &trace, &lane.left_neighbors),
                right: self.beside(place, &trace, &lane.right_neighbors),
            },
            trace,
        });
        features.collect()
    }

    fn boundaries(&self, trace: &Trace, segments: &[BoundarySegment]) -> Vec<Boundary> {
        let known = segments.iter().filter_map(|segment| {
            let line = *self.line_places.get(&segment.boundary_feature_id)?;
            let (from_s, to_s) = (trace.s_of(segment.lane_start_index), trace.s_of(segment.lane_end_index));
            Some(Boundary { from_s, to_s, line })
        });
        known.collect()
    }

    fn beside(&self, place: usize, trace: &Trace, neighbors: &[LaneNeighbor]) -> Vec<Beside> {
        let known = neighbors.iter().filter_map(|neighbor| {
            let lane = *self.places.lanes.get(&neighbor.feature_id)?;
            let (from_s, to_s) = (trace.s_of(neighbor.self_start_index), trace.s_of(neighbor.self_end_index));
            (lane != place && to_s > from_s).then_some(Beside { lane, from_s, to_s })
        });
        known.collect()
    }
}

/// Waymo writes 0 where the limit is unknown.
fn metres_per_second(miles_per_hour: f64) -> Option<f64> {
    /// m/s of a mile per hour.
    const MILE_PER_HOUR: f64 = 0.447_04;
    (miles_per_hour > 0.0 && miles_per_hour.is_finite()).then_some(miles_per_hour * MILE_PER_HOUR)
}

/// The outline of an area; `None` when it has none.
fn outline(feature: i64, area: &Area, origin: Vector) -> Result<Option<Polygon>, LineFault> {
    let ring: Vec<Point> = local_points(feature, &places_of(&area.polygon), origin)?;
    Ok(Polygon::new(ring).ok())
}
