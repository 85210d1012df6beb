//! Repairs the route before the first plan (`tuplan_garage` `route_utils.py`).

use super::current_lane::starting_block;
use super::search::{SearchDirection, roadblock_chain};
use planagent_world::geometry::{Polygon, Pose};
use planagent_world::{LaneKind, LaneMap, RoadblockId};
use std::collections::BTreeSet;

/// Maximum length of a chain back from the route to the ego, roadblocks.
const MAX_DEPTH_BACKWARD: usize = 15;
/// Maximum length of a chain from the ego to the route, or over a gap in it, roadblocks.
const MAX_DEPTH_FORWARD: usize = 30;
/// Number of roadblocks at the start of the route that a chain may end at.
const ENTRIES: usize = 3;
/// Connectors that share more than this are a loop, m².
const LOOP_AREA: f64 = 1.0;

/// The route of an ego whose rear axle is at `rear_axle`: started at the ego, its gaps closed, cut
/// before its first loop. What cannot be repaired stays as it is; an empty route stays empty.
pub fn corrected_route(map: &LaneMap, route: &[RoadblockId], rear_axle: Pose) -> Vec<RoadblockId> {
    let mut seen = BTreeSet::new();
    let route: Vec<RoadblockId> = route
        .iter()
        .copied()
        .filter(|&block| seen.insert(block))
        .collect();
    let begun = begun_at(map, route, rear_axle);
    without_loops(map, &without_gaps(map, &begun))
}

/// The route, started at the roadblock under the ego: back from its first roadblock, or forward to
/// one of its first three.
fn begun_at(map: &LaneMap, route: Vec<RoadblockId>, rear_axle: Pose) -> Vec<RoadblockId> {
    let (Some(&first), Some(start)) = (route.first(), starting_block(map, &route, rear_axle))
    else {
        return route;
    };
    if route.contains(&start.block) {
        return route;
    }
    if let Some(mut chain) = roadblock_chain(
        map,
        first,
        &start.candidates,
        SearchDirection::Backward,
        MAX_DEPTH_BACKWARD,
    ) {
        // The chain ends with the first roadblock of the route, which would stand twice.
        chain.pop();
        return [chain, route].concat();
    }
    let entries = &route[..route.len().min(ENTRIES)];
    let Some(chain) = roadblock_chain(
        map,
        start.block,
        entries,
        SearchDirection::Forward,
        MAX_DEPTH_FORWARD,
    ) else {
        return route;
    };
    let entry = route
        .iter()
        .position(|block| chain.last() == Some(block))
        .expect("the chain ends on the route");
    [&chain[..], &route[entry + 1..]].concat()
}

/// The route with the roadblocks that lead over each gap put in.
fn without_gaps(map: &LaneMap, route: &[RoadblockId]) -> Vec<RoadblockId> {
    let mut whole: Vec<RoadblockId> = route.first().copied().into_iter().collect();
    for pair in route.windows(2) {
        if !map[pair[1]].incoming.contains(&pair[0]) {
            let chain = roadblock_chain(
                map,
                pair[0],
                &pair[1..],
                SearchDirection::Forward,
                MAX_DEPTH_FORWARD,
            );
            let between = chain
                .as_deref()
                .and_then(|chain| chain.get(1..chain.len() - 1));
            whole.extend(between.unwrap_or_default());
        }
        whole.push(pair[1]);
    }
    whole
}

/// The route up to the first connector that crosses an earlier one.
fn without_loops(map: &LaneMap, route: &[RoadblockId]) -> Vec<RoadblockId> {
    let mut crossed: Vec<Vec<Polygon>> = Vec::new();
    for (place, &block) in route.iter().enumerate() {
        if map[block].kind != LaneKind::Connector {
            continue;
        }
        let area = outline(&map[block].areas);
        if crossed
            .iter()
            .any(|earlier| shared_area(earlier, &area) > LOOP_AREA)
        {
            return route[..place].to_vec();
        }
        crossed.push(area);
    }
    route.to_vec()
}

/// The pieces of an area, none overlapping another.
fn outline(areas: &[Polygon]) -> Vec<Polygon> {
    if areas.len() > 1 {
        Polygon::union_of(areas)
    } else {
        areas.to_vec()
    }
}

fn shared_area(a: &[Polygon], b: &[Polygon]) -> f64 {
    a.iter()
        .flat_map(|a| b.iter().map(|b| a.shared_area(b)))
        .sum()
}
