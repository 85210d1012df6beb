//! Roadblocks: lanes side by side in one direction, and the connectors that join two such sets.
//!
//! Neighboring lanes of one direction share a roadblock, pairs with the longest common part first.
//! A pair that would put a lane and its successor into one block is skipped, so a long lane beside
//! two short ones joins the one with the longer common part. Connectors share a roadblock connector
//! if they join the same roadblocks, or the same connectors where one follows another.

use super::lanes::{RecordedLane, Side};
use planagent_world::geometry::Polygon;
use planagent_world::{LaneId, LaneKind, Roadblock, RoadblockId};
use std::collections::{BTreeMap, BTreeSet};

/// An end of a connector: a roadblock, or a single other connector.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Joint {
    Block(usize),
    Connector(usize),
}

/// The roadblocks, and the roadblock of each lane.
pub(crate) fn roadblocks(
    lanes: &[RecordedLane],
    connector: &[bool],
    areas: &[Polygon],
) -> (Vec<Roadblock>, Vec<RoadblockId>) {
    let mut groups = lane_groups(lanes, connector);
    let mut block_of: Vec<usize> = vec![usize::MAX; lanes.len()];
    // Connectors are grouped by the blocks that they join, so those of lanes come first.
    mark(&groups, &mut block_of);
    groups.extend(connector_groups(lanes, connector, &block_of));
    mark(&groups, &mut block_of);
    let blocks = groups.iter().enumerate().map(|(number, members)| {
        let around = |near: fn(&RecordedLane) -> &Vec<usize>| -> Vec<RoadblockId> {
            let others: BTreeSet<usize> = members
                .iter()
                .flat_map(|&lane| near(&lanes[lane]))
                .map(|&lane| block_of[lane])
                .collect();
            others
                .into_iter()
                .filter(|&other| other != number)
                .map(|other| RoadblockId(other as u32))
                .collect()
        };
        Roadblock {
            id: RoadblockId(number as u32),
            source_id: lanes[*members.first().expect("a group has one lane at least")].id,
            kind: if members.iter().any(|&lane| connector[lane]) {
                LaneKind::Connector
            } else {
                LaneKind::Lane
            },
            lanes: members.iter().map(|&lane| LaneId(lane as u32)).collect(),
            areas: members.iter().map(|&lane| areas[lane].clone()).collect(),
            incoming: around(|lane| &lane.entries),
            outgoing: around(|lane| &lane.exits),
        }
    });
    let blocks = blocks.collect();
    (
        blocks,
        block_of
            .into_iter()
            .map(|block| RoadblockId(block as u32))
            .collect(),
    )
}

fn mark(groups: &[Vec<usize>], block_of: &mut [usize]) {
    for (number, members) in groups.iter().enumerate() {
        for &lane in members {
            block_of[lane] = number;
        }
    }
}

/// Groups of lanes side by side, in order of their first lane.
fn lane_groups(lanes: &[RecordedLane], connector: &[bool]) -> Vec<Vec<usize>> {
    let mut beside: Vec<(f64, usize, usize)> = Vec::new();
    for (place, lane) in lanes
        .iter()
        .enumerate()
        .filter(|&(place, _)| !connector[place])
    {
        for other in Side::BOTH
            .into_iter()
            .flat_map(|side| lane.neighbors.at(side))
        {
            if !connector[other.lane] {
                beside.push((
                    other.to_s - other.from_s,
                    place.min(other.lane),
                    place.max(other.lane),
                ));
            }
        }
    }
    // Ties by place, so that the groups do not depend on the sort.
    beside.sort_by(|a, b| b.0.total_cmp(&a.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    let mut group_of: Vec<usize> = (0..lanes.len()).collect();
    let mut members: Vec<Vec<usize>> = (0..lanes.len()).map(|lane| vec![lane]).collect();
    for (_, a, b) in beside {
        let (into, from) = (group_of[a].min(group_of[b]), group_of[a].max(group_of[b]));
        if into == from || follow_each_other(lanes, &members[into], &members[from]) {
            continue;
        }
        let moved = std::mem::take(&mut members[from]);
        for &lane in &moved {
            group_of[lane] = into;
        }
        members[into].extend(moved);
    }
    let mut groups: Vec<Vec<usize>> = members
        .into_iter()
        .filter(|m| m.iter().any(|&lane| !connector[lane]))
        .collect();
    for group in &mut groups {
        group.sort_unstable();
    }
    groups
}

/// True if a lane of one group leads, directly or over one more lane, to a lane of the other.
fn follow_each_other(lanes: &[RecordedLane], a: &[usize], b: &[usize]) -> bool {
    let leads = |from: &[usize], to: &[usize]| {
        from.iter()
            .flat_map(|&lane| &lanes[lane].exits)
            .any(|exit| {
                to.contains(exit) || lanes[*exit].exits.iter().any(|next| to.contains(next))
            })
    };
    leads(a, b) || leads(b, a)
}

fn connector_groups(
    lanes: &[RecordedLane],
    connector: &[bool],
    block_of: &[usize],
) -> Vec<Vec<usize>> {
    let joint = |lane: &usize| {
        if connector[*lane] {
            Joint::Connector(*lane)
        } else {
            Joint::Block(block_of[*lane])
        }
    };
    let mut groups: BTreeMap<(Vec<Joint>, Vec<Joint>), Vec<usize>> = BTreeMap::new();
    let mut loose = Vec::new();
    for (place, lane) in lanes
        .iter()
        .enumerate()
        .filter(|&(place, _)| connector[place])
    {
        let joints = |near: &[usize]| {
            near.iter()
                .map(joint)
                .collect::<BTreeSet<_>>()
                .into_iter()
                .collect::<Vec<_>>()
        };
        if lane.entries.is_empty() || lane.exits.is_empty() {
            // An open end says nothing about where a connector leads, so it shares a block with no
            // other.
            loose.push(vec![place]);
        } else {
            groups
                .entry((joints(&lane.entries), joints(&lane.exits)))
                .or_default()
                .push(place);
        }
    }
    let mut groups: Vec<Vec<usize>> = groups.into_values().chain(loose).collect();
    groups.sort();
    groups
}
