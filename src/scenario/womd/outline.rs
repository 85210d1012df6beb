//! Areas of lanes and connectors.
//!
//! At every station of a lane's centerline and to each side, the lane extends
//! * to its boundary line, if that is at most [`MAX_HALF`] away;
//! * else halfway to the neighboring lane, within the same bound;
//! * else [`DEFAULT_HALF`];
//!
//! but never farther than halfway to the next lane of its level, so that neighbors share a
//! boundary. Overlaps that remain at sharp forks and merges go to the lane that comes first: at
//! most one lane holds a point, as nuPlan's metrics assume. The width of a connector changes
//! linearly between the lanes that it joins.

use super::features::MapFeatures;
use crate::recording::lanes::{RecordedLane, Side, Sides};
use crate::recording::map::{separate, simplified};
use crate::recording::trace::{Ray, Segments};
use planagent_world::geometry::{OrientedBox, Point, Polygon};

/// Half of a lane's width without other information, meters.
pub(super) const DEFAULT_HALF: f64 = 1.75;
/// Maximum half of a lane's width, meters. A line farther away includes a shoulder or parking
/// strip.
const MAX_HALF: f64 = 2.75;
/// Minimum half of a lane's width, meters. A nearer line is the marking of the centerline itself.
const MIN_HALF: f64 = 0.9;
/// Minimum distance of a neighboring centerline, meters. A nearer one forks from this lane or
/// merges with it.
const MIN_LANE_DISTANCE: f64 = 2.0 * MIN_HALF;
/// Distance between stations, meters.
pub(super) const STATION_STEP: f64 = 1.0;
/// Tolerance for the simplification of outlines, meters.
const TOLERANCE: f64 = 0.02;

/// Maximum number of stations of a piece. A strip that returns to itself is no simple polygon.
const MAX_PIECE: usize = 50;

/// Widths of a strip to both sides at its stations.
#[derive(Debug, Clone)]
pub(super) struct Strip {
    /// Arc lengths on the centerline.
    pub(super) stations: Vec<f64>,
    /// Of each station, meters.
    pub(super) reach: Sides<Vec<f64>>,
}

impl Strip {
    pub(super) fn measured(lane: &RecordedLane, measure: impl Fn(Side, f64) -> f64) -> Self {
        let stations = lane.trace.stations(STATION_STEP);
        let reach = Sides::each(|side| stations.iter().map(|&s| measure(side, s)).collect());
        Self { stations, reach }
    }

    /// The area as pieces in driving order; a single one if the strip is short and does not fold.
    pub(super) fn pieces(&self, lane: &RecordedLane) -> Vec<Polygon> {
        let [left, right] = Side::BOTH.map(|side| self.border(lane, side));
        let folded: Vec<bool> = (0..self.stations.len() - 1)
            .map(|i| {
                let along = lane.trace.direction_at(self.stations[i]);
                [&left, &right]
                    .iter()
                    .any(|border| (border[i + 1] - border[i]).dot(&along) < 0.0)
            })
            .collect();
        let mut pieces = Vec::new();
        let mut from = 0;
        while from < folded.len() {
            let same = folded[from..]
                .iter()
                .take_while(|&&f| !f)
                .take(MAX_PIECE)
                .count();
            let to = from + same.max(1);
            let ring = left[from..=to]
                .iter()
                .chain(right[from..=to].iter().rev())
                .copied();
            // Borders that run backwards cross themselves and are no polygon; their hull is one.
            let piece = if folded[from] {
                Polygon::convex_hull(&ring.collect::<Vec<_>>())
            } else {
                Polygon::new(ring)
            };
            pieces.extend(
                piece
                    .ok()
                    .map(|piece| simplified(&piece, TOLERANCE))
                    .filter(|piece| piece.area() > 0.0),
            );
            from = to;
        }
        pieces
    }

    /// The area as one polygon; `None` if it is empty.
    fn area(&self, lane: &RecordedLane) -> Option<Polygon> {
        let mut pieces = self.pieces(lane);
        if pieces.len() > 1 {
            pieces = Polygon::union_of(&pieces);
        }
        pieces
            .into_iter()
            .max_by(|a, b| a.area().total_cmp(&b.area()))
    }

    /// The outer line of the strip on one side.
    fn border(&self, lane: &RecordedLane, side: Side) -> Vec<Point> {
        let line = &lane.trace.line;
        let stations = self.stations.iter().zip(self.reach.at(side));
        stations
            .map(|(&s, &reach)| line.point_at(s) + side.normal(lane.trace.direction_at(s)) * reach)
            .collect()
    }
}

pub(super) fn lane_areas(map: &MapFeatures, connector: &[bool]) -> Vec<Polygon> {
    let centerlines = Segments::from_traces(map.lanes.iter().map(|lane| &lane.trace));
    let lines = Segments::from_traces(&map.lines);
    let lane_strips: Vec<Option<Strip>> = (0..map.lanes.len())
        .map(|place| {
            (!connector[place]).then(|| lane_strip(map, place, connector, &centerlines, &lines))
        })
        .collect();
    let areas = map
        .lanes
        .iter()
        .zip(&lane_strips)
        .enumerate()
        .map(|(place, (lane, strip))| {
            let strip = strip
                .clone()
                .unwrap_or_else(|| connector_strip(map, place, &lane_strips));
            strip.area(lane).unwrap_or_else(|| minimal_area(lane))
        });
    let mut areas: Vec<Polygon> = areas.collect();
    separate(&mut areas, connector);
    areas
}

fn minimal_area(lane: &RecordedLane) -> Polygon {
    /// Meters.
    const LENGTH: f64 = 0.1;
    OrientedBox::new(lane.trace.line.pose_at(0.0), LENGTH, 2.0 * DEFAULT_HALF).to_polygon()
}

fn lane_strip(
    map: &MapFeatures,
    place: usize,
    connector: &[bool],
    centerlines: &Segments,
    lines: &Segments,
) -> Strip {
    /// Cosine of the maximum angle between neighbors.
    const ALONG: f64 = 0.7;
    let lane = &map.lanes[place];
    Strip::measured(lane, |side, s| {
        let along = lane.trace.direction_at(s);
        let ray = Ray {
            from: lane.trace.line.point_at(s),
            direction: side.normal(along),
            height: lane.trace.height_at(s),
            reach: MAX_HALF,
        };
        let outside = Ray {
            from: ray.from + ray.direction * MIN_LANE_DISTANCE,
            reach: 2.0 * MAX_HALF - MIN_LANE_DISTANCE,
            ..ray
        };
        let beside = centerlines.first_hit(&outside, |other| {
            other.owner != place
                && !connector[other.owner]
                && (other.to - other.from).normalize().dot(&along).abs() > ALONG
        });
        // The ray begins `MIN_LANE_DISTANCE` away from the line, so this is half of the whole
        // distance.
        let half_way = beside.map(|distance| f64::midpoint(distance, MIN_LANE_DISTANCE));
        let bounds: Vec<usize> = map.boundaries[place]
            .at(side)
            .iter()
            .filter(|b| b.from_s - STATION_STEP <= s && s <= b.to_s + STATION_STEP)
            .map(|b| b.line)
            .collect();
        let bound = lines
            .first_hit(&ray, |line| bounds.contains(&line.owner))
            .filter(|&distance| distance > MIN_HALF);
        match (bound, half_way) {
            (Some(bound), Some(half)) => bound.min(half),
            (Some(bound), None) => bound,
            (None, Some(half)) => half,
            (None, None) => DEFAULT_HALF,
        }
    })
}

fn connector_strip(map: &MapFeatures, place: usize, lane_strips: &[Option<Strip>]) -> Strip {
    let lane = &map.lanes[place];
    let joined = |near: &[usize], side: Side, end: fn(&[f64]) -> Option<&f64>| {
        let widths = near
            .iter()
            .filter_map(|&other| end(lane_strips[other].as_ref()?.reach.at(side)));
        widths
            .copied()
            .map(|w| w.max(DEFAULT_HALF))
            .reduce(f64::max)
            .unwrap_or(DEFAULT_HALF)
    };
    let widths = Sides::each(|side| {
        (
            joined(&lane.entries, side, <[f64]>::last),
            joined(&lane.exits, side, <[f64]>::first),
        )
    });
    Strip::measured(lane, |side, s| {
        let (from, to) = *widths.at(side);
        from + (to - from) * s / lane.length()
    })
}
