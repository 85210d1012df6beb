//! The lanes that PDM-Closed follows: Dijkstra's search along the route (`tuplan_garage`
//! `dijkstra.py`).

use planagent_world::geometry::Pose;
use planagent_world::{LaneId, LaneMap, RoadblockId};
use std::collections::BTreeMap;

/// Number of roadblocks that the search covers, the ego's included.
const SEARCH_DEPTH: usize = 30;
/// Cost of the starting lane, meters.
const START_COST: f64 = 1.0;

/// A lane that the search has reached.
#[derive(Debug, Clone, Copy)]
struct Reached {
    lane: LaneId,
    /// Meters of baseline driven up to its end.
    cost: f64,
    /// Lanes up to here, itself included.
    depth: usize,
}

/// The cheapest chain of lanes of the route from `start` to a lane of the roadblock 29 places
/// further on the route, or of its last one; cost is the length of the baselines. When none leads
/// there, the chain to the cheapest of the lanes that the search found deepest. Of equal costs the
/// one reached first counts.
pub fn lane_chain(
    map: &LaneMap,
    route: &[RoadblockId],
    route_lanes: &[LaneId],
    start: LaneId,
) -> Vec<LaneId> {
    let here = route
        .iter()
        .position(|&block| block == map[start].roadblock)
        .unwrap_or(0);
    let goal = route.get(here + SEARCH_DEPTH - 1).or(route.last());
    let mut parent: BTreeMap<LaneId, LaneId> = BTreeMap::new();
    let mut frontier = vec![Reached {
        lane: start,
        cost: START_COST,
        depth: 1,
    }];
    let mut expanded: Vec<Reached> = Vec::new();
    // A list and not a heap: of equal costs the one reached first must win. The search is short.
    while let Some(place) = cheapest(&frontier) {
        let at = frontier.remove(place);
        if Some(&map[at.lane].roadblock) == goal {
            return chain_to(at.lane, &parent);
        }
        expanded.push(at);
        for &next in map[at.lane]
            .outgoing
            .iter()
            .filter(|next| route_lanes.contains(next))
        {
            let reached = Reached {
                lane: next,
                cost: at.cost + map[next].centerline.length(),
                depth: at.depth + 1,
            };
            if expanded.iter().any(|e| e.lane == next) {
                continue;
            }
            match frontier.iter_mut().find(|f| f.lane == next) {
                Some(known) if known.cost <= reached.cost => continue,
                Some(known) => *known = reached,
                None => frontier.push(reached),
            }
            parent.insert(next, at.lane);
        }
    }
    let deepest = expanded.iter().map(|e| e.depth).max();
    let of_depth = expanded.iter().filter(|e| Some(e.depth) == deepest);
    let end = of_depth
        .min_by(|a, b| a.cost.total_cmp(&b.cost))
        .map_or(start, |found| found.lane);
    chain_to(end, &parent)
}

/// Index of the cheapest, the first of equals.
fn cheapest(frontier: &[Reached]) -> Option<usize> {
    frontier
        .iter()
        .enumerate()
        .min_by(|a, b| a.1.cost.total_cmp(&b.1.cost))
        .map(|(place, _)| place)
}

fn chain_to(end: LaneId, parent: &BTreeMap<LaneId, LaneId>) -> Vec<LaneId> {
    let mut chain = vec![end];
    while let Some(&before) = parent.get(&chain[chain.len() - 1]) {
        chain.push(before);
    }
    chain.reverse();
    chain
}

/// The baselines of the lanes one after the other; where two meet, both poses are kept.
pub fn centerline_poses(map: &LaneMap, lanes: &[LaneId]) -> Vec<Pose> {
    lanes
        .iter()
        .flat_map(|&lane| map[lane].centerline.vertex_poses())
        .collect()
}
