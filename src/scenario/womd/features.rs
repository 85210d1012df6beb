//! Map features of a recording in local coordinates. Relations between lanes are indices.
//!
//! * Bike lanes are not part of the lane graph, since nuPlan's lanes are for motor vehicles. They
//!   are drivable where they lie between a lane and the road edge beside it.
//! * A lane of one point has no length. Lanes that lead into it lead to its exits.
//! * Relations to lanes outside the recording are dropped.

use super::proto::{
    Area, BoundarySegment, FeatureData, LaneCenter, LaneNeighbor, LaneType, MapFeature, MapPoint,
    StopSign,
};
use crate::recording::error::RecordingFault;
use crate::recording::lanes::{Beside, Ends, Places, RecordedLane, Sides};
use crate::recording::trace::{Place, Trace, local_points};
use planagent_world::geometry::{Point, Polygon, Vector};
use std::collections::{BTreeMap, BTreeSet};

/// A line along a part of a lane.
#[derive(Debug, Clone, Copy)]
pub(super) struct Boundary {
    /// Arc lengths on the lane.
    pub(super) from_s: f64,
    pub(super) to_s: f64,
    /// Index in [`MapFeatures::lines`].
    pub(super) line: usize,
}

/// A stop sign.
#[derive(Debug, Clone)]
pub(super) struct Sign {
    /// Lanes that it governs.
    pub(super) lanes: Vec<usize>,
}

/// The recorded map.
#[derive(Debug)]
pub(super) struct MapFeatures {
    pub(super) lanes: Vec<RecordedLane>,
    /// Of each lane.
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
    /// Reads the features; `origin` becomes the point (0, 0).
    pub(super) fn read(features: &[MapFeature], origin: Vector) -> Result<Self, RecordingFault> {
        let mut ids = BTreeSet::new();
        if let Some(twice) = features.iter().find(|feature| !ids.insert(feature.id)) {
            return Err(RecordingFault::DuplicateId {
                layer: "map feature",
                id: twice.id,
            });
        }
        let mut drivable: Vec<(i64, &LaneCenter, Trace)> = Vec::new();
        let mut passages: BTreeMap<i64, &[i64]> = BTreeMap::new();
        let mut line_places = BTreeMap::new();
        let (mut lines, mut edges, mut signs): (Vec<Trace>, Vec<Trace>, Vec<&StopSign>) =
            Default::default();
        let (mut crosswalks, mut driveways) = (Vec::new(), Vec::new());
        for feature in features {
            let id = feature.id;
            match &feature.feature_data {
                Some(FeatureData::Lane(lane)) if lane.r#type == LaneType::BikeLane as i32 => {
                    // No lane for motor vehicles; it is read for its faults alone.
                    local_points(id, &places_of(&lane.polyline), origin)?;
                }
                Some(FeatureData::Lane(lane)) => {
                    match Trace::from_points(id, &places_of(&lane.polyline), origin)? {
                        Some(trace) => drivable.push((id, lane, trace)),
                        // A lane of one point has no length: it only leads to its exits.
                        None => drop(passages.insert(id, &lane.exit_lanes)),
                    }
                }
                Some(FeatureData::RoadLine(line)) => {
                    if let Some(trace) = Trace::from_points(id, &places_of(&line.polyline), origin)?
                    {
                        line_places.insert(id, lines.len());
                        lines.push(trace);
                    }
                }
                Some(FeatureData::RoadEdge(edge)) => {
                    if let Some(trace) = Trace::from_points(id, &places_of(&edge.polyline), origin)?
                    {
                        line_places.insert(id, lines.len());
                        lines.push(trace.clone());
                        edges.push(trace);
                    }
                }
                Some(FeatureData::StopSign(sign)) => signs.push(sign),
                Some(FeatureData::Crosswalk(area)) => crosswalks.extend(outline(id, area, origin)?),
                Some(FeatureData::Driveway(area)) => driveways.extend(outline(id, area, origin)?),
                None => {}
            }
        }
        let lanes: BTreeMap<i64, usize> = drivable
            .iter()
            .enumerate()
            .map(|(i, (id, ..))| (*id, i))
            .collect();
        let signs = signs
            .into_iter()
            .map(|sign| Sign {
                lanes: sign
                    .lane
                    .iter()
                    .filter_map(|id| lanes.get(id).copied())
                    .collect(),
            })
            .collect();
        let lookup = Lookup {
            places: Places { lanes, passages },
            line_places,
        };
        let boundaries = drivable.iter().map(|(_, lane, trace)| Sides {
            left: lookup.boundaries(trace, &lane.left_boundaries),
            right: lookup.boundaries(trace, &lane.right_boundaries),
        });
        let boundaries = boundaries.collect();
        let lanes = lookup.lanes(drivable);
        Ok(Self {
            lanes,
            boundaries,
            lines,
            edges,
            crosswalks,
            driveways,
            signs,
        })
    }
}

/// Number of lanes for motor vehicles with a length.
pub(super) fn lane_count(features: &[MapFeature]) -> usize {
    let lanes = features
        .iter()
        .filter(|feature| match &feature.feature_data {
            Some(FeatureData::Lane(lane)) if lane.r#type != LaneType::BikeLane as i32 => {
                let places = places_of(&lane.polyline);
                let origin = places
                    .first()
                    .map_or_else(Vector::zeros, |place| place.coords.xy());
                Trace::from_points(feature.id, &places, origin).is_ok_and(|trace| trace.is_some())
            }
            _ => false,
        });
    lanes.count()
}

fn places_of(points: &[MapPoint]) -> Vec<Place> {
    points.iter().map(|p| Place::new(p.x, p.y, p.z)).collect()
}

/// Indices of lanes and lines.
struct Lookup<'a> {
    places: Places<'a>,
    line_places: BTreeMap<i64, usize>,
}

impl Lookup<'_> {
    fn lanes(&self, drivable: Vec<(i64, &LaneCenter, Trace)>) -> Vec<RecordedLane> {
        let ends = drivable.iter().map(|(_, lane, _)| Ends {
            entries: &lane.entry_lanes,
            exits: &lane.exit_lanes,
        });
        let joints = self.places.joints(ends);
        let features = drivable
            .into_iter()
            .enumerate()
            .map(|(place, (id, lane, trace))| RecordedLane {
                id,
                flagged: lane.interpolating,
                speed_limit: meters_per_second(lane.speed_limit_mph),
                entries: joints.before(place),
                exits: joints.after(place),
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
            let (from_s, to_s) = (
                trace.s_of(segment.lane_start_index),
                trace.s_of(segment.lane_end_index),
            );
            Some(Boundary { from_s, to_s, line })
        });
        known.collect()
    }

    fn beside(&self, place: usize, trace: &Trace, neighbors: &[LaneNeighbor]) -> Vec<Beside> {
        let known = neighbors.iter().filter_map(|neighbor| {
            let lane = *self.places.lanes.get(&neighbor.feature_id)?;
            let (from_s, to_s) = (
                trace.s_of(neighbor.self_start_index),
                trace.s_of(neighbor.self_end_index),
            );
            (lane != place && to_s > from_s).then_some(Beside { lane, from_s, to_s })
        });
        known.collect()
    }
}

/// Waymo writes 0 for an unknown limit.
fn meters_per_second(miles_per_hour: f64) -> Option<f64> {
    /// m/s of a mile per hour.
    const MILE_PER_HOUR: f64 = 0.447_04;
    (miles_per_hour > 0.0 && miles_per_hour.is_finite()).then_some(miles_per_hour * MILE_PER_HOUR)
}

/// The outline of an area; `None` if it has no extent.
fn outline(feature: i64, area: &Area, origin: Vector) -> Result<Option<Polygon>, RecordingFault> {
    let ring: Vec<Point> = local_points(feature, &places_of(&area.polygon), origin)?;
    Ok(Polygon::new(ring).ok())
}
