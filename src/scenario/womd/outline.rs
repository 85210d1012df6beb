//! Areas of lanes and connectors.
//!
//! At every station of a lane's centreline and to each side, the lane reaches
//! * to the line that bounds it there, when that line is at most [`WIDEST_HALF`] away;
//! * else half-way to the lane beside it, when that half is as narrow;
//! * else [`DEFAULT_HALF`];
//!
//! but never farther than half-way to the next lane of its level, so that neighbours share a boundary. What still overlaps,
//! where lanes fork or merge at a sharp angle, is left to the lane that comes first: at most one lane holds a point, as nuPlan's
//! metrics assume. A connector is as wide as the lanes that it joins, in between in proportion.

use super::features::MapFeatures;
use crate::geometry::{OrientedBox, Point, Polygon};
use crate::scenario::recording::exclusive::{separate, simplified};
use crate::scenario::recording::lanes::{RecordedLane, Side, Sides};
use crate::scenario::recording::trace::{Ray, Segments};

/// Half of a lane's width where nothing tells it, metres.
pub(super) const DEFAULT_HALF: f64 = 1.75;
/// A line farther than this bounds a shoulder or a parking strip too, metres.
const WIDEST_HALF: f64 = 2.75;
/// A line nearer than this is the centreline's own marking, metres.
const NARROWEST_HALF: f64 = 0.9;
/// Another centreline nearer than this has not yet parted from this one, or no longer, metres.
const NEAREST_LANE: f64 = 2.0 * NARROWEST_HALF;
/// Distance between stations, metres.
pub(super) const STATION_STEP: f64 = 1.0;
/// Vertices that move an outline by less are left out, metres.
const SIMPLER_BY: f64 = 0.02;

/// Stations of a piece of a strip: a strip that comes back to itself is no simple polygon.
const LONGEST_PIECE: usize = 50;

/// How far a strip reaches to either side at its stations.
#[derive(Debug, Clone)]
pub(super) struct Strip {
    /// Arc lengths on the centreline.
    pub(super) stations: Vec<f64>,
    /// Metres, a number a station.
    pub(super) reach: Sides<Vec<f64>>,
}

impl Strip {
    /// Measures both sides of a lane at every station.
    pub(super) fn measured(lane: &RecordedLane, measure: impl Fn(Side, f64) -> f64) -> Self {
        let stations = lane.trace.stations(STATION_STEP);
        let reach = Sides::each(|side| stations.iter().map(|&s| measure(side, s)).collect());
        Self { stations, reach }
    }

    /// Its area as pieces in driving order; one where the strip is short and does not fold.
    pub(super) fn pieces(&self, lane: &RecordedLane) -> Vec<Polygon> {
        let [left, right] = Side::BOTH.map(|side| self.border(lane, side));
        let folded: Vec<bool> = (0..self.stations.len() - 1)
            .map(|i| {
                let along = lane.trace.direction_at(self.stations[i]);
                [&left, &right].iter().any(|border| (border[i + 1] - border[i]).dot(&along) < 0.0)
            })
            .collect();
        let mut pieces = Vec::new();
        let mut from = 0;
        while from < folded.len() {
            let same = folded[from..].iter().take_while(|&&f| !f).take(LONGEST_PIECE).count();
            let to = from + same.max(1);
            let ring = left[from..=to].iter().chain(right[from..=to].iter().rev()).copied();
            let piece = if folded[from] { Polygon::convex_hull(&ring.collect::<Vec<_>>()) } else { Polygon::new(ring) };
            pieces.extend(piece.ok().map(|piece| simplified(&piece, SIMPLER_BY)).filter(|piece| piece.area() > 0.0));
            from = to;
        }
        pieces
    }

    /// Its area as one polygon; `None` when it has none.
    fn area(&self, lane: &RecordedLane) -> Option<Polygon> {
        let mut pieces = self.pieces(lane);
        if pieces.len() > 1 {
            pieces = Polygon::union_of(&pieces);
        }
        pieces.into_iter().max_by(|a, b| a.area().total_cmp(&b.area()))
    }

    /// The line along which the strip ends on one side.
    fn border(&self, lane: &RecordedLane, side: Side) -> Vec<Point> {
        let line = &lane.trace.line;
        let stations = self.stations.iter().zip(self.reach.at(side));
        stations.map(|(&s, &reach)| line.point_at(s) + side.of(lane.trace.direction_at(s)) * reach).collect()
    }
}

/// Areas of all lanes, in order.
pub(super) fn lane_areas(map: &MapFeatures, connector: &[bool]) -> Vec<Polygon> {
    let centerlines = Segments::of(map.lanes.iter().map(|lane| &lane.trace));
    let lines = Segments::of(&map.lines);
    let lane_strips: Vec<Option<Strip>> = (0..map.lanes.len())
        .map(|place| (!connector[place]).then(|| lane_strip(map, place, connector, &centerlines, &lines)))
        .collect();
    let areas = map.lanes.iter().zip(&lane_strips).enumerate().map(|(place, (lane, strip))| {
        let strip = strip.clone().unwrap_or_else(|| connector_strip(map, place, &lane_strips));
        strip.area(lane).unwrap_or_else(|| speck(lane))
    });
    let mut areas: Vec<Polygon> = areas.collect();
    separate(&mut areas, connector);
    areas
}

/// The area of a lane that is too short to have an outline.
fn speck(lane: &RecordedLane) -> Polygon {
    /// Metres.
    const LENGTH: f64 = 0.1;
    OrientedBox::new(lane.trace.line.pose_at(0.0), LENGTH, 2.0 * DEFAULT_HALF).to_polygon()
}

fn lane_strip(map: &MapFeatures, place: usize, connector: &[bool], centerlines: &Segments, lines: &Segments) -> Strip {
    /// Lanes that run across are no neighbours: cosine of the angle from which on they are.
    const ALONG: f64 = 0.7;
    let lane = &map.lanes[place];
    Strip::measured(lane, |side, s| {
        let along = lane.trace.direction_at(s);
        let ray = Ray {
            from: lane.trace.line.point_at(s),
            direction: side.of(along),
            height: lane.trace.height_at(s),
            reach: WIDEST_HALF,
        };
        let outside =
            Ray { from: ray.from + ray.direction * NEAREST_LANE, reach: 2.0 * WIDEST_HALF - NEAREST_LANE, ..ray };
        let beside = centerlines.first_hit(&outside, |other| {
            other.owner != place
                && !connector[other.owner]
                && (other.to - other.from).normalize().dot(&along).abs() > ALONG
        });
        let half_way = beside.map(|distance| f64::midpoint(distance, NEAREST_LANE));
        let bounds: Vec<usize> = map.boundaries[place]
            .at(side)
            .iter()
            .filter(|b| b.from_s - STATION_STEP <= s && s <= b.to_s + STATION_STEP)
            .map(|b| b.line)
            .collect();
        let bound =
            lines.first_hit(&ray, |line| bounds.contains(&line.owner)).filter(|&distance| distance > NARROWEST_HALF);
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
        let widths = near.iter().filter_map(|&other| end(lane_strips[other].as_ref()?.reach.at(side)));
        widths.copied().map(|w| w.max(DEFAULT_HALF)).reduce(f64::max).unwrap_or(DEFAULT_HALF)
    };
    let widths =
        Sides::each(|side| (joined(&lane.entries, side, <[f64]>::last), joined(&lane.exits, side, <[f64]>::first)));
    Strip::measured(lane, |side, s| {
        let (from, to) = *widths.at(side);
        from + (to - from) * s / lane.length()
    })
}
