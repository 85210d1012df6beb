//! Classification of lanes as connectors.
//!
//! Waymo flags lanes that only join others as `interpolating`, but in many recordings no lane has
//! the flag. Lanes are cut where an intersection begins and ends. A lane is a connector if
//!
//! 1. it is flagged; or
//! 2. its centerline crosses another on the same level at 15° to 165°; or
//! 3. the stop point of a traffic light or a stop sign is at its start, since the intersection
//!    follows; or
//! 4. it is at most [`MAX_CONNECTOR`] long and both leaves a fork and ends in a merge; or
//! 5. it is at most that long, leaves a fork or ends in a merge, and a sibling is straighter; or
//! 6. it runs beside a connector of rule 2 or 3 from the same start to the same end.
//!
//! Connectors may overlap each other and lanes. Two lanes may not overlap, hence the rules 4 and 5.

use super::features::MapFeatures;
use crate::recording::lanes::{RecordedLane, Side};
use planagent_world::geometry::{Pose, wrap_angle};
use std::collections::BTreeSet;

/// Maximum length of a connector, meters. The recordings' longest flagged lane is 55 m.
const MAX_CONNECTOR: f64 = 60.0;

/// True for each connector. `governed` are the lanes behind the stop point of a traffic light.
pub(super) fn classify(
    map: &MapFeatures,
    crossings: &BTreeSet<(usize, usize)>,
    governed: &BTreeSet<usize>,
) -> Vec<bool> {
    let lanes = &map.lanes;
    let mut within: BTreeSet<usize> = crossings.iter().flat_map(|&(a, b)| [a, b]).collect();
    within.extend(governed);
    within.extend(
        map.signs
            .iter()
            .flat_map(|sign| &sign.lanes)
            .filter(|&&lane| is_short(&lanes[lane])),
    );
    let beside: Vec<usize> = (0..lanes.len())
        .filter(|&lane| runs_beside(lanes, lane, &within))
        .collect();
    within.extend(beside);
    (0..lanes.len())
        .map(|place| {
            lanes[place].flagged || within.contains(&place) || joins_or_bends(lanes, place)
        })
        .collect()
}

fn is_short(lane: &RecordedLane) -> bool {
    lane.length() <= MAX_CONNECTOR
}

/// Rule 6.
fn runs_beside(lanes: &[RecordedLane], place: usize, within: &BTreeSet<usize>) -> bool {
    /// Ends nearer than this along the road are the same, meters.
    const SAME_END: f64 = 6.0;
    let lane = &lanes[place];
    let beside = Side::BOTH
        .into_iter()
        .flat_map(|side| lane.neighbors.at(side));
    beside
        .filter(|beside| within.contains(&beside.lane))
        .any(|beside| {
            let other = &lanes[beside.lane];
            let gap = |a: Pose, b: Pose| a.to_local(b.position()).x.abs();
            let (line, other_line) = (&lane.trace.line, &other.trace.line);
            is_short(lane)
                && gap(line.pose_at(0.0), other_line.pose_at(0.0)) < SAME_END
                && gap(
                    line.pose_at(lane.length()),
                    other_line.pose_at(other.length()),
                ) < SAME_END
        })
}

/// Rules 4 and 5.
fn joins_or_bends(lanes: &[RecordedLane], place: usize) -> bool {
    let siblings = |near: &[usize], onward: fn(&RecordedLane) -> &Vec<usize>| -> BTreeSet<usize> {
        near.iter()
            .flat_map(|&lane| onward(&lanes[lane]))
            .copied()
            .collect()
    };
    let lane = &lanes[place];
    let forked = siblings(&lane.entries, |entry| &entry.exits);
    let merged = siblings(&lane.exits, |exit| &exit.entries);
    let straightest = |among: &BTreeSet<usize>, deviation: fn(&RecordedLane) -> f64| {
        let best = among
            .iter()
            .copied()
            .min_by(|&a, &b| deviation(&lanes[a]).total_cmp(&deviation(&lanes[b])));
        best.is_none_or(|best| best == place)
    };
    is_short(lane)
        && ((forked.len() > 1 && merged.len() > 1)
            || !straightest(&forked, leaving_deviation)
            || !straightest(&merged, joining_deviation))
}

/// Deviation of a lane from the straight line of its start: lateral meters plus meters for the
/// turn.
fn leaving_deviation(lane: &RecordedLane) -> f64 {
    let line = &lane.trace.line;
    deviation(line.pose_at(0.0), line.pose_at(COMPARED))
}

/// Deviation of a lane from the straight line of its end.
fn joining_deviation(lane: &RecordedLane) -> f64 {
    let line = &lane.trace.line;
    deviation(
        line.pose_at(lane.length()),
        line.pose_at(lane.length() - COMPARED),
    )
}

/// Length over which siblings are compared, meters.
const COMPARED: f64 = 30.0;

fn deviation(from: Pose, to: Pose) -> f64 {
    /// Lateral meters that a radian of turn counts for.
    const METERS_PER_RADIAN: f64 = 10.0;
    from.to_local(to.position()).y.abs()
        + METERS_PER_RADIAN * wrap_angle(to.heading - from.heading).abs()
}
