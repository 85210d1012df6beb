//! Map features of a recording, in local coordinates, with the relations between lanes resolved to places in a list.
//!
//! * Bike lanes are no lanes of the graph: nuPlan's lanes are for motor vehicles. Their surface is drivable where it lies
//!   between a lane and the road edge beside it.
//! * A lane of one point has no length; what leads into it leads to what it leads to.
//! * Relations to lanes that the recording does not contain are dropped.

use super::error::RecordingFault;
use super::proto::{Area, BoundarySegment, FeatureData, LaneCenter, LaneNeighbor, LaneType, MapFeature, StopSign};
use super::trace::{Trace, local_points};
use crate::geometry::{Point, Polygon, Vector};
use std::collections::{BTreeMap, BTreeSet};

/// The two sides of a lane.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Side {
    Left,
    Right,
}

impl Side {
    pub(super) const BOTH: [Self; 2] = [Self::Left, Self::Right];

    /// The unit vector to this side of a direction.
    pub(super) fn of(self, direction: Vector) -> Vector {
        let left = Vector::new(-direction.y, direction.x);
        match self {
            Self::Left => left,
            Self::Right => -left,
        }
    }
}

/// A value for each side.
#[derive(Debug, Clone, Default)]
pub(super) struct Sides<T> {
    pub(super) left: T,
    pub(super) right: T,
}

impl<T> Sides<T> {
    pub(super) fn at(&self, side: Side) -> &T {
        match side {
            Side::Left => &self.left,
            Side::Right => &self.right,
        }
    }

    pub(super) fn each(mut make: impl FnMut(Side) -> T) -> Self {
        Self { left: make(Side::Left), right: make(Side::Right) }
    }
}

/// A lane for motor vehicles as recorded.
#[derive(Debug, Clone)]
pub(super) struct LaneFeature {
    pub(super) id: i64,
    pub(super) trace: Trace,
    pub(super) interpolating: bool,
    /// m/s.
    pub(super) speed_limit: Option<f64>,
    /// Places of the lanes that lead into it.
    pub(super) entries: Vec<usize>,
    /// Places of the lanes that it leads to.
    pub(super) exits: Vec<usize>,
    /// Lines that bound it.
    pub(super) boundaries: Sides<Vec<Boundary>>,
    /// Lanes beside it.
    pub(super) neighbors: Sides<Vec<Beside>>,
}

impl LaneFeature {
    pub(super) fn length(&self) -> f64 {
        self.trace.line.length()
    }
}

/// A line that bounds a part of a lane.
#[derive(Debug, Clone, Copy)]
pub(super) struct Boundary {
    /// Arc lengths on the lane.
    pub(super) from_s: f64,
    pub(super) to_s: f64,
    /// Place among [`MapFeatures::lines`].
    pub(super) line: usize,
}

/// A lane beside a part of another.
#[derive(Debug, Clone, Copy)]
pub(super) struct Beside {
    pub(super) lane: usize,
    /// Arc lengths on this lane.
    pub(super) from_s: f64,
    pub(super) to_s: f64,
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
    pub(super) lanes: Vec<LaneFeature>,
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
                    local_points(id, &lane.polyline, origin)?;
                }
                Some(FeatureData::Lane(lane)) => match Trace::of(id, &lane.polyline, origin)? {
                    Some(trace) => drivable.push((id, lane, trace)),
                    None => drop(passages.insert(id, &lane.exit_lanes)),
                },
                Some(FeatureData::RoadLine(line)) => {
                    if let Some(trace) = Trace::of(id, &line.polyline, origin)? {
                        line_places.insert(id, lines.len());
                        lines.push(trace);
                    }
                }
                Some(FeatureData::RoadEdge(edge)) => {
                    if let Some(trace) = Trace::of(id, &edge.polyline, origin)? {
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
        let places: BTreeMap<i64, usize> = drivable.iter().enumerate().map(|(i, (id, ..))| (*id, i)).collect();
        let signs = signs
            .into_iter()
            .map(|sign| Sign { lanes: sign.lane.iter().filter_map(|id| places.get(id).copied()).collect() })
            .collect();
        let lookup = Lookup { places, passages, line_places };
        let lanes = lookup.lanes(drivable);
        Ok(Self { lanes, lines, edges, crosswalks, driveways, signs })
    }
}

/// Where the lanes and lines of the message went.
struct Lookup<'a> {
    places: BTreeMap<i64, usize>,
    /// Lanes without length, with what they lead to.
    passages: BTreeMap<i64, &'a [i64]>,
    line_places: BTreeMap<i64, usize>,
}

impl Lookup<'_> {
    fn lanes(&self, drivable: Vec<(i64, &LaneCenter, Trace)>) -> Vec<LaneFeature> {
        let mut joints: BTreeSet<(usize, usize)> = BTreeSet::new();
        for (place, (_, lane, _)) in drivable.iter().enumerate() {
            joints.extend(self.reached(&lane.exit_lanes).into_iter().map(|exit| (place, exit)));
            let entries = lane.entry_lanes.iter().filter_map(|id| self.places.get(id));
            joints.extend(entries.map(|&entry| (entry, place)));
        }
        joints.retain(|(from, to)| from != to);
        let features = drivable.into_iter().enumerate().map(|(place, (id, lane, trace))| LaneFeature {
            id,
            interpolating: lane.interpolating,
            speed_limit: metres_per_second(lane.speed_limit_mph),
            entries: joints.iter().filter(|(_, to)| *to == place).map(|(from, _)| *from).collect(),
            exits: joints.iter().filter(|(from, _)| *from == place).map(|(_, to)| *to).collect(),
            boundaries: Sides {
                left: self.boundaries(&trace, &lane.left_boundaries),
                right: self.boundaries(&trace, &lane.right_boundaries),
            },
            neighbors: Sides {
                left: self.beside(place, &trace, &lane.left_neighbors),
                right: self.beside(place, &trace, &lane.right_neighbors),
            },
            trace,
        });
        features.collect()
    }

    /// Lanes with length that are reached over the given ones.
    fn reached(&self, exits: &[i64]) -> BTreeSet<usize> {
        let mut found = BTreeSet::new();
        let mut seen = BTreeSet::new();
        let mut open: Vec<i64> = exits.to_vec();
        while let Some(id) = open.pop() {
            if let Some(&place) = self.places.get(&id) {
                found.insert(place);
            } else if let Some(onward) = self.passages.get(&id).filter(|_| seen.insert(id)) {
                open.extend(onward.iter());
            }
        }
        found
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
            let lane = *self.places.get(&neighbor.feature_id)?;
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
fn outline(feature: i64, area: &Area, origin: Vector) -> Result<Option<Polygon>, RecordingFault> {
    let ring: Vec<Point> = local_points(feature, &area.polygon, origin)?;
    Ok(Polygon::new(ring).ok())
}
