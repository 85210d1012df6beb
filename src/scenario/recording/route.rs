//! The route: the chain of roadblocks that the recorded ego followed.
//!
//! A Viterbi search matches the recorded poses to lanes. The cost of a lane at a pose grows with
//! distance and heading difference. A step to another lane costs little along the lane graph, more
//! to a neighbor, and much elsewhere. The route is the lanes' roadblocks, with those in between
//! from the graph. It goes on beyond the recording (`onward`).

use super::onward::onward;
use planagent_world::geometry::{Point, Pose, wrap_angle};
use planagent_world::{Lane, LaneId, LaneMap, RoadblockId};
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// Minimum distance between samples, meters.
const SAMPLE_STEP: f64 = 1.0;
/// Maximum distance of the ego from its centerline, meters.
const REACH: f64 = 6.0;
/// Standard deviation of the distance from the centerline, meters.
const OFFSET_SIGMA: f64 = 1.0;
/// Standard deviation of the heading difference to the lane, radians.
const TURN_SIGMA: f64 = 0.3;
/// Cost of a step along the graph; it prefers routes with fewer lanes.
const FOLLOW: f64 = 0.2;
/// Cost of a lane change.
const CHANGE: f64 = 3.0;
/// Cost of a step off the graph.
const BREAK: f64 = 30.0;
/// Cost of a meter backwards on a lane.
const BACKWARDS: f64 = 3.0;

/// The chain of roadblocks along the poses, at least one.
pub(crate) fn route(map: &LaneMap, poses: &[Pose]) -> Vec<RoadblockId> {
    let samples = spaced(poses);
    let mut matched = matched_lanes(map, &samples);
    if matched.is_empty() {
        // The ego is parked off the road: the route begins with the lane that it would enter.
        matched.extend(samples.first().and_then(|&pose| nearest_lane(map, pose)));
    }
    let end = matched.last().copied().zip(samples.last().copied());
    let mut lanes: Vec<LaneId> = Vec::new();
    for lane in matched {
        if let Some(&last) = lanes.last()
            && last != lane
            && let Some(between) = lanes_between(map, last, lane, f64::INFINITY)
        {
            lanes.extend(between);
        }
        if lanes.last() != Some(&lane) {
            lanes.push(lane);
        }
    }
    let mut blocks: Vec<RoadblockId> = Vec::new();
    for block in lanes.into_iter().map(|lane| map[lane].roadblock) {
        let Some(&last) = blocks.last() else {
            blocks.push(block);
            continue;
        };
        if last != block {
            blocks.extend(blocks_between(map, last, block));
            blocks.push(block);
        }
    }
    if let Some((lane, pose)) = end {
        blocks.extend(onward(map, &blocks, lane, pose));
    }
    blocks
}

/// Poses at least [`SAMPLE_STEP`] apart.
fn spaced(poses: &[Pose]) -> Vec<Pose> {
    let mut samples: Vec<Pose> = Vec::new();
    for &pose in poses {
        if samples
            .last()
            .is_none_or(|last| last.distance(&pose) >= SAMPLE_STEP)
        {
            samples.push(pose);
        }
    }
    samples
}

fn nearest_lane(map: &LaneMap, pose: Pose) -> Option<LaneId> {
    let distance = |lane: &Lane| lane.polygon.distance_to(pose.position());
    map.lanes()
        .iter()
        .min_by(|a, b| distance(a).total_cmp(&distance(b)))
        .map(|lane| lane.id)
}

/// A lane that may hold a pose.
#[derive(Debug, Clone, Copy)]
struct Candidate {
    lane: LaneId,
    s: f64,
    misfit: f64,
}

fn candidates(map: &LaneMap, pose: Pose) -> Vec<Candidate> {
    let near = map
        .lanes_near(pose.position(), REACH)
        .into_iter()
        .filter_map(|lane| {
            let foot = map[lane].centerline.project(pose.position());
            let turn = wrap_angle(foot.heading - pose.heading).abs();
            let misfit =
                (foot.distance / OFFSET_SIGMA).powi(2) / 2.0 + (turn / TURN_SIGMA).powi(2) / 2.0;
            (foot.distance < REACH && turn < std::f64::consts::FRAC_PI_2).then_some(Candidate {
                lane,
                s: foot.s,
                misfit,
            })
        });
    near.collect()
}

/// The best chain of lanes, one per sample. Samples without a lane in reach are skipped.
fn matched_lanes(map: &LaneMap, samples: &[Pose]) -> Vec<LaneId> {
    // One function, since both passes of the Viterbi search read these layers and nothing else
    // does.
    struct Layer {
        at: Point,
        candidates: Vec<Candidate>,
        costs: Vec<f64>,
        from: Vec<usize>,
    }
    let mut layers: Vec<Layer> = Vec::new();
    for &pose in samples {
        let found = candidates(map, pose);
        if found.is_empty() {
            continue;
        }
        let (mut costs, mut from) = (Vec::new(), Vec::new());
        for candidate in &found {
            let (cost, best) = match layers.last() {
                None => (0.0, 0),
                Some(last) => {
                    let moved = (pose.position() - last.at).norm();
                    let steps = last.candidates.iter().zip(&last.costs);
                    let steps = steps
                        .map(|(before, cost)| cost + step_cost(map, *before, *candidate, moved));
                    let best = steps.enumerate().min_by(|a, b| a.1.total_cmp(&b.1));
                    best.map_or((0.0, 0), |(i, cost)| (cost, i))
                }
            };
            costs.push(cost + candidate.misfit);
            from.push(best);
        }
        layers.push(Layer {
            at: pose.position(),
            candidates: found,
            costs,
            from,
        });
    }
    let Some(last) = layers.last() else {
        return Vec::new();
    };
    let mut best = last
        .costs
        .iter()
        .enumerate()
        .min_by(|a, b| a.1.total_cmp(b.1))
        .expect("a layer has one candidate at least")
        .0;
    let mut lanes = Vec::with_capacity(layers.len());
    for layer in layers.iter().rev() {
        lanes.push(layer.candidates[best].lane);
        best = layer.from[best];
    }
    lanes.reverse();
    lanes
}

fn step_cost(map: &LaneMap, before: Candidate, after: Candidate, moved: f64) -> f64 {
    /// Maximum excess of the distance along the graph over the driven distance, meters.
    const SLACK: f64 = 4.0;
    if before.lane == after.lane {
        return BACKWARDS * (before.s - after.s - 0.5).max(0.0);
    }
    let left = map[before.lane].centerline.length() - before.s;
    if let Some(between) =
        lanes_between(map, before.lane, after.lane, moved + SLACK - left - after.s)
    {
        return FOLLOW * (between.len() + 1) as f64;
    }
    let beside = map[before.lane].left.iter().chain(&map[before.lane].right);
    if beside
        .into_iter()
        .any(|neighbor| neighbor.lane == after.lane)
    {
        CHANGE
    } else {
        BREAK
    }
}

/// The shortest chain of lanes between two, at most four lanes and `spare` meters; empty if one
/// leads to the other.
fn lanes_between(map: &LaneMap, from: LaneId, to: LaneId, spare: f64) -> Option<Vec<LaneId>> {
    /// Lanes that a step between two samples may skip.
    const MAX_BETWEEN: usize = 4;
    if map[from].outgoing.contains(&to) {
        return (spare >= 0.0).then(Vec::new);
    }
    let mut open: VecDeque<(Vec<LaneId>, f64)> = VecDeque::from([(Vec::new(), 0.0)]);
    while let Some((between, covered)) = open.pop_front() {
        let last = between.last().copied().unwrap_or(from);
        for &next in &map[last].outgoing {
            if next == to {
                return Some(between);
            }
            let covered = covered + map[next].centerline.length();
            if between.len() < MAX_BETWEEN
                && covered <= spare
                && next != from
                && !between.contains(&next)
            {
                open.push_back((between.iter().copied().chain([next]).collect(), covered));
            }
        }
    }
    None
}

/// The shortest chain of roadblocks between two, at most six; empty if the graph does not join
/// them.
fn blocks_between(map: &LaneMap, from: RoadblockId, to: RoadblockId) -> Vec<RoadblockId> {
    /// Roadblocks without a sample that may follow one another.
    const MAX_BETWEEN: usize = 6;
    let mut parent: BTreeMap<RoadblockId, RoadblockId> = BTreeMap::new();
    let mut level = BTreeSet::from([from]);
    for _ in 0..=MAX_BETWEEN {
        let mut next_level = BTreeSet::new();
        for &block in &level {
            for &next in map[block].outgoing.iter().filter(|&&next| next != from) {
                if let std::collections::btree_map::Entry::Vacant(entry) = parent.entry(next) {
                    entry.insert(block);
                    next_level.insert(next);
                }
            }
        }
        if parent.contains_key(&to) {
            break;
        }
        level = next_level;
    }
    let mut between = Vec::new();
    let mut block = to;
    while let Some(&before) = parent.get(&block).filter(|&&before| before != from) {
        between.push(before);
        block = before;
    }
    between.reverse();
    between
}
