//! Where lanes cross each other.

use super::lanes::RecordedLane;
use super::trace::{SAME_LEVEL, Segments};
use crate::geometry::{Bounds, Point};
use std::collections::BTreeSet;

/// Centrelines that meet at a smaller angle merge or run against each other, radians.
const CROSSING_ANGLE: f64 = std::f64::consts::PI / 12.0;

/// Pairs (smaller place first) of lanes whose centrelines cross on one level at 15° to 165°.
pub(in crate::scenario) fn crossings(lanes: &[RecordedLane]) -> BTreeSet<(usize, usize)> {
    let segments = Segments::of(lanes.iter().map(|lane| &lane.trace));
    let mut pairs = BTreeSet::new();
    for a in segments.list() {
        let along = a.to - a.from;
        for b in segments.within(&Bounds::around(&[a.from, a.to])).filter(|b| b.owner > a.owner) {
            let across = b.to - b.from;
            let angle = along.perp(&across).atan2(along.dot(&across)).abs();
            // Where one lane follows the other they meet in a point, however sharp the bend.
            let follow = lanes[a.owner].exits.contains(&b.owner) || lanes[b.owner].exits.contains(&a.owner);
            let steep = angle > CROSSING_ANGLE && angle < std::f64::consts::PI - CROSSING_ANGLE;
            if steep && !follow && (a.height - b.height).abs() < SAME_LEVEL && cross(a.from, a.to, b.from, b.to) {
                pairs.insert((a.owner, b.owner));
            }
        }
    }
    pairs
}

/// Whether two segments cross; a line through a vertex crosses one of the two segments that meet there.
fn cross(a: Point, b: Point, c: Point, d: Point) -> bool {
    let left = |p: Point, q: Point, r: Point| (q - p).perp(&(r - p)) > 0.0;
    left(c, d, a) != left(c, d, b) && left(a, b, c) != left(a, b, d)
}
