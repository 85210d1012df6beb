//! Chains of lanes along the route.

use planagent_world::geometry::{Point, Polyline, Pose};
use planagent_world::{Lane, LaneId, RoadblockId, SceneView};
use std::collections::BTreeSet;

/// Distance between two vertices of a baseline as the originals assume it, meters.
const SPACING: f64 = 0.25;
/// Baselines with a larger mean spacing get vertices at most [`SPACING`] apart, meters. nuPlan's
/// have a quarter of a meter.
const SPARSE: f64 = 0.35;
/// Baselines are followed until they are this long, meters.
const DEPTH: f64 = 120.0;
/// Lanes nearer than this may be the first, meters.
const MAX_DISTANCE: f64 = 4.0;
/// A vertex nearer to the one before is left out, meters.
const MIN_STEP: f64 = 0.1;
/// Shortest candidate, vertices.
const MIN_VERTICES: usize = 3;
/// Maximum number of chains that are followed: a map of many short lanes has too many to plan on.
const MAX_CHAINS: usize = 512;
/// Distances below this count as 0, meters (numpy's `isclose`).
const NOTHING: f64 = 1e-8;

/// A chain of lanes from the ego on.
#[derive(Debug, Clone, PartialEq)]
pub struct Candidate {
    /// A quarter of a meter a vertex, meters.
    pub length: f64,
    /// Distance of its nearest vertex from the rear axle, meters.
    pub distance: f64,
    /// Its lanes.
    pub lanes: Vec<LaneId>,
    /// Its vertices from the one nearest to the rear axle on, in the frame of the map.
    pub vertices: Vec<Pose>,
}

/// The roadblock of the route nearest to the rear axle, the first one under it, and its distance,
/// meters.
pub fn starting_block(scene: &SceneView<'_>) -> Option<(RoadblockId, f64)> {
    let here = scene.ego.rear_axle.position();
    let mut nearest: Option<(RoadblockId, f64)> = None;
    for &block in &scene.route.roadblocks {
        for &lane in &scene.map[block].lanes {
            let distance = scene.map[lane].polygon.distance_to(here);
            if nearest.is_none_or(|(_, least)| distance < least) {
                nearest = Some((block, distance));
            }
        }
        if nearest.is_some_and(|(_, distance)| distance <= NOTHING) {
            break;
        }
    }
    nearest
}

/// The lanes of a roadblock near the rear axle; where none is near, the nearest.
pub(crate) fn starting_lanes(scene: &SceneView<'_>, block: RoadblockId) -> Vec<LaneId> {
    let here = scene.ego.rear_axle.position();
    let distance = |lane: LaneId| scene.map[lane].polygon.distance_to(here);
    let lanes = &scene.map[block].lanes;
    let near: Vec<LaneId> = lanes
        .iter()
        .copied()
        .filter(|&lane| distance(lane) < MAX_DISTANCE)
        .collect();
    if !near.is_empty() {
        return near;
    }
    lanes
        .iter()
        .copied()
        .min_by(|&a, &b| distance(a).total_cmp(&distance(b)))
        .into_iter()
        .collect()
}

/// All chains of lanes of the route from these lanes on.
pub fn candidates(scene: &SceneView<'_>, starts: &[LaneId]) -> Vec<Candidate> {
    let allowed = scene.route.lanes(scene.map);
    let mut chains = Vec::new();
    for &start in starts {
        follow(scene, &allowed, &mut vec![start], 0.0, &mut chains);
    }
    chains
        .into_iter()
        .filter_map(|chain| candidate(scene, chain))
        .collect()
}

/// The vertices of a baseline, a quarter of a meter apart.
pub(super) fn vertices(lane: &Lane) -> Vec<Point> {
    let line: &Polyline = &lane.centerline;
    let count = line.vertices().len();
    if line.length() > SPARSE * (count - 1) as f64 {
        line.densified(SPACING).vertices().to_vec()
    } else {
        line.vertices().to_vec()
    }
}

fn follow(
    scene: &SceneView<'_>,
    allowed: &BTreeSet<LaneId>,
    chain: &mut Vec<LaneId>,
    depth: f64,
    chains: &mut Vec<Vec<LaneId>>,
) {
    let next: Vec<LaneId> = match chain.last() {
        Some(&last) if depth < DEPTH => scene.map[last]
            .outgoing
            .iter()
            .copied()
            .filter(|lane| allowed.contains(lane))
            .collect(),
        _ => Vec::new(),
    };
    if next.is_empty() && chains.len() < MAX_CHAINS {
        chains.push(chain.clone());
    }
    for lane in next {
        if chains.len() >= MAX_CHAINS {
            return;
        }
        chain.push(lane);
        let length = SPACING * vertices(&scene.map[lane]).len() as f64;
        follow(scene, allowed, chain, depth + length, chains);
        chain.pop();
    }
}

fn candidate(scene: &SceneView<'_>, lanes: Vec<LaneId>) -> Option<Candidate> {
    let here = scene.ego.rear_axle.position();
    let all: Vec<Point> = lanes
        .iter()
        .flat_map(|&lane| vertices(&scene.map[lane]))
        .collect();
    let apart = all
        .windows(2)
        .filter(|pair| (pair[1] - pair[0]).norm() >= MIN_STEP)
        .map(|pair| pair[1]);
    let line: Vec<Point> = all.first().copied().into_iter().chain(apart).collect();
    let distances = line.iter().map(|point| (point - here).norm());
    let (start, distance) = distances.enumerate().min_by(|a, b| a.1.total_cmp(&b.1))?;
    let line = &line[start..];
    if line.len() < MIN_VERTICES {
        return None;
    }
    let mut headings: Vec<f64> = line
        .windows(2)
        .map(|pair| pair[1] - pair[0])
        .map(|along| along.y.atan2(along.x))
        .collect();
    headings.extend(headings.last().copied());
    let vertices = line
        .iter()
        .zip(headings)
        .map(|(&point, heading)| Pose::at(point, heading))
        .collect();
    Some(Candidate {
        // As upstream, which counts vertices and measures no lengths.
        length: SPACING * line.len() as f64,
        distance,
        lanes,
        vertices,
    })
}

/// Candidates of at least this length, meters; where all are shorter, the longest.
pub(crate) fn long_enough(candidates: Vec<Candidate>, acceptable: f64) -> Vec<Candidate> {
    let longest = candidates
        .iter()
        .map(|candidate| candidate.length)
        .fold(0.0, f64::max);
    candidates
        .into_iter()
        .filter(|candidate| candidate.length >= acceptable.min(longest))
        .collect()
}
