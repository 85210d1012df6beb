//! Breadth-first search for a chain of linked roadblocks (`tuplan_garage` `bfs_roadblock.py`).

use planagent_world::{LaneMap, RoadblockId};
use std::collections::{BTreeMap, BTreeSet};

/// Which links a search follows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SearchDirection {
    /// Along the traffic.
    Forward,
    /// Against the traffic.
    Backward,
}

impl SearchDirection {
    fn neighbors(self, map: &LaneMap, block: RoadblockId) -> &[RoadblockId] {
        match self {
            Self::Forward => &map[block].outgoing,
            Self::Backward => &map[block].incoming,
        }
    }
}

/// The chain with fewest links between `start` and any of `targets`, both included, in the
/// direction of traffic for both search directions; `None` when there is none of at most
/// `max_depth` roadblocks.
///
/// Of chains of one length upstream's choice is made: the target that its queue reaches first, each
/// roadblock entered from the one of the level before that its queue expands last. Upstream's queue
/// repeats roadblocks; here each stands once a level, by the place of its first and of its last
/// repetition.
pub fn roadblock_chain(
    map: &LaneMap,
    start: RoadblockId,
    targets: &[RoadblockId],
    direction: SearchDirection,
    max_depth: usize,
) -> Option<Vec<RoadblockId>> {
    let mut level = Level {
        by_first: vec![start],
        by_last: vec![start],
    };
    let mut parents: Vec<BTreeMap<RoadblockId, RoadblockId>> = Vec::new();
    for _ in 0..max_depth {
        // Before the next level is built, so that a start among the targets is a chain of one.
        if let Some(&goal) = level.by_first.iter().find(|block| targets.contains(block)) {
            let mut chain = vec![goal];
            for parent in parents.iter().rev() {
                chain.push(*parent.get(&chain[chain.len() - 1])?);
            }
            if direction == SearchDirection::Forward {
                chain.reverse();
            }
            return Some(chain);
        }
        let (next, parent) = level.next(map, direction);
        if next.by_first.is_empty() {
            return None;
        }
        parents.push(parent);
        level = next;
    }
    None
}

/// The roadblocks of one depth.
struct Level {
    /// In the order of their first place in upstream's queue.
    by_first: Vec<RoadblockId>,
    /// In the order of their last place.
    by_last: Vec<RoadblockId>,
}

impl Level {
    /// The level after, with the roadblock from which each of it is entered.
    fn next(
        &self,
        map: &LaneMap,
        direction: SearchDirection,
    ) -> (Self, BTreeMap<RoadblockId, RoadblockId>) {
        let neighbors = |&block: &RoadblockId| direction.neighbors(map, block).iter().copied();
        let mut seen = BTreeSet::new();
        let by_first = self
            .by_first
            .iter()
            .flat_map(neighbors)
            .filter(|&block| seen.insert(block))
            .collect();
        let mut parent = BTreeMap::new();
        let mut by_last = Vec::new();
        for &block in self.by_last.iter().rev() {
            for next in neighbors(&block).rev() {
                parent.entry(next).or_insert_with(|| {
                    by_last.push(next);
                    block
                });
            }
        }
        by_last.reverse();
        (Self { by_first, by_last }, parent)
    }
}
