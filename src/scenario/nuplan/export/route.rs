//! The route of a scenario in ids of the written map.

use super::graph::Graph;
use planagent_world::geometry::wrap_angle;
use planagent_world::{LaneKind, LaneMap, RoadblockId};
use std::collections::{BTreeMap, VecDeque};

/// Maximum number of inserted roadblocks between two of the route: a connector, or a connector, a
/// lane and a connector.
const MAX_GAP: usize = 3;

/// Ids of the roadblocks and roadblock connectors of the route, with the inserted ones between
/// them.
pub(super) fn route_ids(map: &LaneMap, graph: &Graph, route: &[RoadblockId]) -> Vec<i64> {
    let mut onward: BTreeMap<i64, Vec<i64>> = BTreeMap::new();
    for row in &graph.group_connectors {
        onward.entry(row.from).or_default().push(row.fid);
        onward.entry(row.fid).or_default().push(row.to);
    }
    let mut ids: Vec<i64> = Vec::with_capacity(route.len());
    for (place, &block) in route.iter().enumerate() {
        let candidates = written(map, graph, block);
        let after = route
            .get(place + 1)
            .map_or_else(Vec::new, |&next| written(map, graph, next));
        let distance_on = |from: i64| {
            after
                .iter()
                .filter_map(|&to| path_between(&onward, from, to))
                .map(|path| path.len())
                .min()
        };
        // The row nearest to the route so far; of equally near ones, the nearest to the next
        // roadblock.
        let paths = candidates.iter().map(|&fid| {
            (
                fid,
                ids.last()
                    .and_then(|&last| path_between(&onward, last, fid)),
            )
        });
        let best = paths.min_by_key(|(fid, path)| {
            (
                path.as_ref().map_or(usize::MAX, Vec::len),
                distance_on(*fid).unwrap_or(usize::MAX),
            )
        });
        if let Some((fid, between)) = best {
            ids.extend(between.unwrap_or_default());
            ids.push(fid);
        }
    }
    ids
}

/// Appends the next roadblock to a route of one, with the connector between, and returns how many
/// were appended. The devkit's IDM planner demands two. Of several connectors the one that turns
/// least is taken, as a driver without a route would.
pub(super) fn extend_short(route: &mut Vec<i64>, graph: &Graph) -> usize {
    let &[only] = route.as_slice() else { return 0 };
    let ahead = match graph.group_connectors.iter().find(|row| row.fid == only) {
        Some(connector) => vec![connector.to],
        None => straightest_from(graph, only)
            .map_or_else(Vec::new, |(connector, next)| vec![connector, next]),
    };
    route.extend(&ahead);
    ahead.len()
}

/// The roadblock connector from a roadblock that turns least, and where it leads.
fn straightest_from(graph: &Graph, from: i64) -> Option<(i64, i64)> {
    let onward = graph.group_connectors.iter().filter(|row| row.from == from);
    let turn = |group: i64| {
        let lines = graph
            .connectors
            .iter()
            .filter(|row| row.group == group)
            .map(|row| &row.centerline);
        lines
            .map(|l| wrap_angle(l.heading_at(l.length()) - l.heading_at(0.0)).abs())
            .fold(f64::INFINITY, f64::min)
    };
    onward
        .min_by(|a, b| turn(a.fid).total_cmp(&turn(b.fid)))
        .map(|row| (row.fid, row.to))
}

/// The rows of a roadblock.
fn written(map: &LaneMap, graph: &Graph, block: RoadblockId) -> Vec<i64> {
    if map[block].kind == LaneKind::Lane {
        return vec![graph.block_fids[block.index()]];
    }
    graph
        .group_connectors
        .iter()
        .filter(|row| row.source == Some(block))
        .map(|row| row.fid)
        .collect()
}

/// The rows between two rows on the shortest path; `None` for more than [`MAX_GAP`].
fn path_between(onward: &BTreeMap<i64, Vec<i64>>, from: i64, to: i64) -> Option<Vec<i64>> {
    let mut queue = VecDeque::from([vec![from]]);
    while let Some(path) = queue.pop_front() {
        let last = path.last().copied()?;
        let next = onward.get(&last).map_or(&[][..], Vec::as_slice);
        if next.contains(&to) {
            return Some(path[1..].to_vec());
        }
        if path.len() <= MAX_GAP {
            queue.extend(next.iter().map(|&fid| [path.as_slice(), &[fid]].concat()));
        }
    }
    None
}
