//! Which lanes are lane connectors.
//!
//! Waymo flags lanes that only join others as `interpolating`, but in many recordings no lane carries the flag. Lanes are cut
//! where an intersection begins and ends, so that the ways across it can be told. A lane is a connector when
//!
//! 1. it is flagged; or
//! 2. its centreline crosses another's on the same level at 15° to 165°; or
//! 3. a traffic light's stop point or a stop sign stands at its beginning: what follows is the intersection; or
//! 4. it is at most [`LONGEST_CONNECTOR`] long and both leaves a fork and ends in a merge; or
//! 5. it is at most that long and leaves a fork or ends in a merge, and a sibling goes straighter: it bends off, or on; or
//! 6. it runs beside a connector of rule 2 or 3 from the same beginning to the same end.
//!
//! Connectors may overlap each other and lanes; two lanes may not, which the rules 4 and 5 see to.

use super::features::MapFeatures;
use crate::geometry::{Pose, wrap_angle};
use crate::scenario::recording::lanes::{RecordedLane, Side};
use std::collections::BTreeSet;

/// No way across an intersection is longer, metres: the recordings' longest flagged lane is 55 m.
const LONGEST_CONNECTOR: f64 = 60.0;
/// For each lane whether it is a connector; `governed` are the lanes behind a traffic light's stop point.
pub(super) fn classify(
    map: &MapFeatures,
    crossings: &BTreeSet<(usize, usize)>,
    governed: &BTreeSet<usize>,
) -> Vec<bool> {
    let lanes = &map.lanes;
    let mut within: BTreeSet<usize> = crossings.iter().flat_map(|&(a, b)| [a, b]).collect();
    within.extend(governed);
    within.extend(map.signs.iter().flat_map(|sign| &sign.lanes).filter(|&&lane| is_short(&lanes[lane])));
    let beside: Vec<usize> = (0..lanes.len()).filter(|&lane| runs_beside(lanes, lane, &within)).collect();
    within.extend(beside);
    (0..lanes.len())
        .map(|place| lanes[place].flagged || within.contains(&place) || joins_or_bends(lanes, place))
        .collect()
}

fn is_short(lane: &RecordedLane) -> bool {
    lane.length() <= LONGEST_CONNECTOR
}

/// Rule 6.
fn runs_beside(lanes: &[RecordedLane], place: usize, within: &BTreeSet<usize>) -> bool {
    /// Ends nearer than this along the road are the same, metres.
    const SAME_END: f64 = 6.0;
    let lane = &lanes[place];
    let beside = Side::BOTH.into_iter().flat_map(|side| lane.neighbors.at(side));
    beside.filter(|beside| within.contains(&beside.lane)).any(|beside| {
        let other = &lanes[beside.lane];
        let gap = |a: Pose, b: Pose| a.to_local(b.position()).x.abs();
        let (line, other_line) = (&lane.trace.line, &other.trace.line);
        is_short(lane)
            && gap(line.pose_at(0.0), other_line.pose_at(0.0)) < SAME_END
            && gap(line.pose_at(lane.length()), other_line.pose_at(other.length())) < SAME_END
    })
}

/// Rules 4 and 5.
fn joins_or_bends(lanes: &[RecordedLane], place: usize) -> bool {
    let siblings = |near: &[usize], onward: fn(&RecordedLane) -> &Vec<usize>| -> BTreeSet<usize> {
        near.iter().flat_map(|&lane| onward(&lanes[lane])).copied().collect()
    };
    let lane = &lanes[place];
    let forked = siblings(&lane.entries, |entry| &entry.exits);
    let merged = siblings(&lane.exits, |exit| &exit.entries);
    let straightest = |among: &BTreeSet<usize>, deviation: fn(&RecordedLane) -> f64| {
        let best = among.iter().copied().min_by(|&a, &b| deviation(&lanes[a]).total_cmp(&deviation(&lanes[b])));
        best.is_none_or(|best| best == place)
    };
    is_short(lane)
        && ((forked.len() > 1 && merged.len() > 1)
            || !straightest(&forked, leaving_deviation)
            || !straightest(&merged, joining_deviation))
}

/// How far a lane leaves the straight line of its beginning: metres aside plus metres for the turn.
fn leaving_deviation(lane: &RecordedLane) -> f64 {
    let line = &lane.trace.line;
    deviation(line.pose_at(0.0), line.pose_at(COMPARED))
}

/// How far a lane comes from beside the straight line of its end.
fn joining_deviation(lane: &RecordedLane) -> f64 {
    let line = &lane.trace.line;
    deviation(line.pose_at(lane.length()), line.pose_at(lane.length() - COMPARED))
}

/// Siblings are compared over this length, metres.
const COMPARED: f64 = 30.0;

fn deviation(from: Pose, to: Pose) -> f64 {
    /// Metres aside that a radian of turn weighs.
    const METRES_PER_RADIAN: f64 = 10.0;
    from.to_local(to.position()).y.abs() + METRES_PER_RADIAN * wrap_angle(to.heading - from.heading).abs()
}
