//! Where the IDM planner goes: its first lane and the lanes to the end of the route (devkit
//! `idm_planner.py`, `breadth_first_search.py`).

use planagent_world::{EgoState, LaneId, LaneMap, Route};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Map and route from the initialization.
#[derive(Debug, Clone)]
pub(super) struct Road {
    pub(super) map: Arc<LaneMap>,
    pub(super) route: Route,
    pub(super) lanes: BTreeSet<LaneId>,
}

impl Road {
    /// The first lane of the first two roadblocks that holds the ego's center, else the nearest one
    /// to its box.
    pub(super) fn starting_lane(&self, ego: &EgoState) -> Option<LaneId> {
        let center = ego.center().position();
        let footprint = ego.footprint();
        let blocks = self.route.roadblocks.iter().take(2);
        let lanes: Vec<LaneId> = blocks
            .flat_map(|&block| self.map[block].lanes.iter().copied())
            .collect();
        let holding = lanes
            .iter()
            .copied()
            .find(|&lane| self.map[lane].polygon.contains(center));
        let distance = |lane: &LaneId| self.map[*lane].polygon.distance_to_box(&footprint);
        holding.or_else(|| {
            lanes
                .iter()
                .copied()
                .min_by(|a, b| distance(a).total_cmp(&distance(b)))
        })
    }

    /// Breadth-first search along lanes of the route for a lane of its last roadblock at the depth
    /// that the route has; when there is none, the chain to the lane found last.
    pub(super) fn route_plan(&self, start: LaneId) -> Vec<LaneId> {
        let blocks = &self.route.roadblocks;
        let in_second = blocks.get(1) == Some(&self.map[start].roadblock);
        let depth = if in_second {
            blocks.len() - 1
        } else {
            blocks.len()
        };
        let is_goal = |lane: LaneId| blocks.last() == Some(&self.map[lane].roadblock);
        let mut level = Level {
            first_seen: vec![start],
            last_seen: vec![start],
        };
        let mut parents: Vec<BTreeMap<LaneId, LaneId>> = Vec::new();
        let mut end = start;
        for at in 1..=depth {
            // As in nuPlan, a goal that is reached earlier does not count.
            if at == depth
                && let Some(&goal) = level.first_seen.iter().find(|&&lane| is_goal(lane))
            {
                end = goal;
                break;
            }
            let (next, parent) = self.next_level(&level);
            let Some(&last) = next.last_seen.last() else {
                break;
            };
            end = last;
            parents.push(parent);
            level = next;
        }
        chain(end, &parents)
    }

    /// The lanes of the route that a level leads to, each with the one that reaches it last.
    fn next_level(&self, level: &Level) -> (Level, BTreeMap<LaneId, LaneId>) {
        let onward = |lane: LaneId| {
            self.map[lane]
                .outgoing
                .iter()
                .copied()
                .filter(|next| self.lanes.contains(next))
        };
        let (mut next, mut parent) = (Level::default(), BTreeMap::new());
        for lane in level.first_seen.iter().flat_map(|&lane| onward(lane)) {
            if !next.first_seen.contains(&lane) {
                next.first_seen.push(lane);
            }
        }
        for &from in &level.last_seen {
            for lane in onward(from) {
                next.last_seen.retain(|&seen| seen != lane);
                next.last_seen.push(lane);
                parent.insert(lane, from);
            }
        }
        (next, parent)
    }
}

/// The lanes at one depth of the search. nuPlan's queue holds a lane once for each way to it: the
/// first place decides which goal is found, the last one which lane comes before it.
#[derive(Debug, Default)]
struct Level {
    first_seen: Vec<LaneId>,
    last_seen: Vec<LaneId>,
}

/// The lanes from the start to `end`, which lies on the last level that holds it.
fn chain(end: LaneId, parents: &[BTreeMap<LaneId, LaneId>]) -> Vec<LaneId> {
    let mut lanes = vec![end];
    let reached = parents
        .iter()
        .rposition(|parent| parent.contains_key(&end))
        .map_or(0, |level| level + 1);
    let mut lane = end;
    for parent in parents[..reached].iter().rev() {
        let Some(&before) = parent.get(&lane) else {
            break;
        };
        lanes.push(before);
        lane = before;
    }
    lanes.reverse();
    lanes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_road::{Stretch, straight_road, whole_route};
    use planagent_world::{Lane, MapParts, RoadblockId};

    fn road(map: LaneMap, route: Route) -> Road {
        let lanes = map.lanes().iter().map(|lane| lane.id).collect();
        Road {
            map: Arc::new(map),
            route,
            lanes,
        }
    }

    /// A route of one roadblock and a search that never reaches the last one: the longest chain
    /// found.
    #[test]
    fn a_route_with_a_gap_ends_before_it() {
        let map = straight_road(
            &[
                Stretch::Lane(60.0),
                Stretch::Signal(20.0),
                Stretch::Lane(150.0),
            ],
            None,
        );
        let mut route = whole_route(&map);
        route.roadblocks.truncate(2);
        let lanes = route.lanes(&map);
        let road = Road {
            lanes,
            ..road(map, route)
        };
        assert_eq!(road.route_plan(LaneId(0)), [LaneId(0), LaneId(1)]);
        assert_eq!(road.route_plan(LaneId(1)), [LaneId(1)]);
    }

    /// 0 leads to 1 and 2, 1 to 3 and 4, 2 to 3, and both 3 and 4 to 5: nuPlan's queue holds 3, 4,
    /// 3, so 3 comes before 5.
    #[test]
    fn of_two_ways_the_one_that_the_queue_holds_last_is_taken() {
        let straight = straight_road(&[Stretch::Lane(10.0); 6], None);
        let onward: [&[u32]; 6] = [&[1, 2], &[3, 4], &[3], &[5], &[5], &[]];
        let ids = |ids: &[u32]| ids.iter().map(|&id| LaneId(id)).collect::<Vec<_>>();
        let lanes = straight.lanes().iter().zip(onward);
        let lanes = lanes.map(|(lane, onward)| Lane {
            outgoing: ids(onward),
            ..lane.clone()
        });
        let lanes: Vec<Lane> = lanes.collect();
        let roadblocks = straight.roadblocks().to_vec();
        let map = LaneMap::new(MapParts {
            lanes,
            roadblocks,
            ..MapParts::default()
        })
        .unwrap();
        let route = Route {
            roadblocks: [0, 1, 3, 5].map(RoadblockId).to_vec(),
            goal: None,
            goal_lane: None,
        };
        assert_eq!(road(map, route).route_plan(LaneId(0)), ids(&[0, 2, 3, 5]));
    }
}
