//! Which lane lies beside which: nuPlan says it with one number a lane within its roadblock, counted from the left.
//!
//! The lane beside counts along its whole length and both ways. Where the map says it for parts of a lane, the lanes that run beside
//! each other longest are neighbours; lanes of a roadblock that are no neighbours get numbers further apart.

use crate::world::{LaneId, LaneMap, Neighbor, Roadblock};
use std::collections::BTreeMap;

/// Number of each lane of a roadblock.
pub(super) fn lane_indices(map: &LaneMap, block: &Roadblock) -> BTreeMap<LaneId, i64> {
    let right_of = pairs(map, block);
    let mut indices = BTreeMap::new();
    let mut next = 0;
    let leftmost = block.lanes.iter().filter(|&lane| !right_of.values().any(|right| right == lane));
    for &first in leftmost {
        let mut lane = Some(first);
        while let Some(here) = lane.filter(|here| !indices.contains_key(here)) {
            indices.insert(here, next);
            next += 1;
            lane = right_of.get(&here).copied();
        }
        next += 1;
    }
    // Lanes that lie beside each other in a circle have no leftmost one.
    for &lane in &block.lanes {
        indices.entry(lane).or_insert_with(|| {
            next += 2;
            next - 2
        });
    }
    indices
}

/// For each lane the one to its right; no lane is right of two. The longest neighbourhoods come first.
fn pairs(map: &LaneMap, block: &Roadblock) -> BTreeMap<LaneId, LaneId> {
    let length = |n: &Neighbor| n.to_s - n.from_s;
    let mut beside: Vec<(f64, LaneId, LaneId)> = Vec::new();
    for &lane in &block.lanes {
        beside.extend(map[lane].right.iter().map(|n| (length(n), lane, n.lane)));
        beside.extend(map[lane].left.iter().map(|n| (length(n), n.lane, lane)));
    }
    beside.retain(|(_, left, right)| left != right && block.lanes.contains(left) && block.lanes.contains(right));
    beside.sort_by(|a, b| b.0.total_cmp(&a.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    let mut right_of: BTreeMap<LaneId, LaneId> = BTreeMap::new();
    for (_, left, right) in beside {
        if !right_of.contains_key(&left) && !right_of.values().any(|&taken| taken == right) {
            right_of.insert(left, right);
        }
    }
    right_of
}

/// How many neighbourhoods of the map the numbers do not say, or say for the whole lane instead of a part.
pub(super) fn changed_neighbors(map: &LaneMap, indices: &BTreeMap<LaneId, i64>) -> usize {
    let kept = |lane: LaneId, neighbor: &Neighbor, step: i64| {
        let here = &map[lane];
        let whole = neighbor.from_s <= 0.0 && neighbor.to_s >= here.centerline.length();
        let numbers = indices.get(&lane).zip(indices.get(&neighbor.lane));
        whole && here.roadblock == map[neighbor.lane].roadblock && numbers.is_some_and(|(&a, &b)| b == a + step)
    };
    let changed = |lane: &crate::world::Lane| {
        let left = lane.left.iter().filter(|n| !kept(lane.id, n, -1)).count();
        left + lane.right.iter().filter(|n| !kept(lane.id, n, 1)).count()
    };
    map.lanes().iter().map(changed).sum()
}
