//! Neighbors of lanes as nuPlan stores them: an index of each lane in its roadblock, counted from
//! the left.
//!
//! In nuPlan two lanes are neighbors along their whole length and both ways. Where the map has
//! neighbors for parts of a lane, the pair with the longest common part is kept; lanes that are no
//! neighbors get indices that differ by more than one.

use planagent_world::{LaneId, LaneMap, Neighbor, Roadblock};
use std::collections::BTreeMap;

/// Index of each lane of a roadblock.
pub(super) fn lane_indices(map: &LaneMap, block: &Roadblock) -> BTreeMap<LaneId, i64> {
    let right_of = pairs(map, block);
    let mut indices = BTreeMap::new();
    let mut next = 0;
    let leftmost = block
        .lanes
        .iter()
        .filter(|&lane| !right_of.values().any(|right| right == lane));
    for &first in leftmost {
        let mut lane = Some(first);
        while let Some(here) = lane.filter(|here| !indices.contains_key(here)) {
            indices.insert(here, next);
            next += 1;
            lane = right_of.get(&here).copied();
        }
        next += 1;
    }
    // Lanes that are neighbors in a circle have no leftmost one.
    for &lane in &block.lanes {
        indices.entry(lane).or_insert_with(|| {
            next += 2;
            next - 2
        });
    }
    indices
}

/// The right neighbor of each lane; no lane is the right neighbor of two. The pairs with the
/// longest common part win.
fn pairs(map: &LaneMap, block: &Roadblock) -> BTreeMap<LaneId, LaneId> {
    let length = |n: &Neighbor| n.to_s - n.from_s;
    let mut beside: Vec<(f64, LaneId, LaneId)> = Vec::new();
    for &lane in &block.lanes {
        beside.extend(map[lane].right.iter().map(|n| (length(n), lane, n.lane)));
        beside.extend(map[lane].left.iter().map(|n| (length(n), n.lane, lane)));
    }
    beside.retain(|(_, left, right)| {
        left != right && block.lanes.contains(left) && block.lanes.contains(right)
    });
    beside.sort_by(|a, b| b.0.total_cmp(&a.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    let mut right_of: BTreeMap<LaneId, LaneId> = BTreeMap::new();
    for (_, left, right) in beside {
        if !right_of.contains_key(&left) && !right_of.values().any(|&taken| taken == right) {
            right_of.insert(left, right);
        }
    }
    right_of
}

/// Number of neighbor relations of the map that the indices drop, or extend from a part to the
/// whole lane.
pub(super) fn changed_neighbors(map: &LaneMap, indices: &BTreeMap<LaneId, i64>) -> usize {
    let kept = |lane: LaneId, neighbor: &Neighbor, step: i64| {
        let here = &map[lane];
        let whole = neighbor.from_s <= 0.0 && neighbor.to_s >= here.centerline.length();
        let numbers = indices.get(&lane).zip(indices.get(&neighbor.lane));
        whole
            && here.roadblock == map[neighbor.lane].roadblock
            && numbers.is_some_and(|(&a, &b)| b == a + step)
    };
    let changed = |lane: &planagent_world::Lane| {
        let left = lane.left.iter().filter(|n| !kept(lane.id, n, -1)).count();
        left + lane.right.iter().filter(|n| !kept(lane.id, n, 1)).count()
    };
    map.lanes().iter().map(changed).sum()
}
