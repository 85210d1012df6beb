//! Lane changes between two lanes of a roadblock (interPlan `lane_changes_to_goal.py`).

use planagent_world::geometry::{Point, borders};
use planagent_world::{LaneAreas, LaneId, LaneKind, LaneMap, RoadblockId};
use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, VecDeque};

/// Maximum distance between the ends of two boundaries that count as one, meters.
const SAME_BOUNDARY: f64 = 0.1;

/// What the count of lane changes needs of a map.
pub(crate) trait LaneRelations {
    /// Lanes that the map calls left and right of a lane.
    fn adjacent(&self, lane: LaneId) -> [Option<LaneId>; 2];
    /// Lanes that lead into a lane.
    fn incoming(&self, lane: LaneId) -> &[LaneId];
    /// Lanes that a lane leads to.
    fn outgoing(&self, lane: LaneId) -> &[LaneId];
    /// The last points of the left and the right boundary.
    fn boundary_ends(&self, lane: LaneId) -> [Point; 2];
    /// The roadblock.
    fn roadblock(&self, lane: LaneId) -> RoadblockId;
    /// Whether adjacency counts only where the boundaries meet. interPlan's rule, for maps with
    /// drawn boundaries.
    fn needs_boundaries(&self) -> bool;
}

impl LaneRelations for LaneMap {
    fn adjacent(&self, lane: LaneId) -> [Option<LaneId>; 2] {
        let end = self[lane].centerline.length();
        let at_end = |side: Option<LaneId>, any: Option<LaneId>| side.or(any);
        let lane = &self[lane];
        [
            at_end(
                lane.left_at(end),
                lane.left.last().map(|neighbor| neighbor.lane),
            ),
            at_end(
                lane.right_at(end),
                lane.right.last().map(|neighbor| neighbor.lane),
            ),
        ]
    }

    fn incoming(&self, lane: LaneId) -> &[LaneId] {
        &self[lane].incoming
    }

    fn outgoing(&self, lane: LaneId) -> &[LaneId] {
        &self[lane].outgoing
    }

    fn boundary_ends(&self, lane: LaneId) -> [Point; 2] {
        let borders = borders(&self[lane].centerline, &self[lane].polygon);
        [borders.left.end(), borders.right.end()]
    }

    fn roadblock(&self, lane: LaneId) -> RoadblockId {
        self[lane].roadblock
    }

    fn needs_boundaries(&self) -> bool {
        self.lane_areas() == LaneAreas::Drawn
            && self.lanes().iter().any(|lane| lane.kind == LaneKind::Lane)
    }
}

/// The lanes left and right of one.
pub(super) fn neighbors(map: &impl LaneRelations, lane: LaneId) -> [Option<LaneId>; 2] {
    let mut beside = Vec::new();
    for &before in map.incoming(lane) {
        let around = map.adjacent(before).into_iter().flatten().chain([before]);
        beside.extend(around.flat_map(|lane| map.outgoing(lane).iter().copied()));
    }
    let ends = map.boundary_ends(lane);
    let adjacent = map.adjacent(lane);
    let nearest = |side: usize| {
        if let Some(known) = adjacent[side].filter(|_| !map.needs_boundaries()) {
            return Some(known);
        }
        let candidates = adjacent[side]
            .into_iter()
            .chain(beside.iter().copied())
            .filter(|&other| other != lane);
        let gap = |other: LaneId| (map.boundary_ends(other)[1 - side] - ends[side]).norm();
        let apart = candidates
            .map(|other| (gap(other), other))
            .min_by(|a, b| a.0.total_cmp(&b.0));
        apart
            .filter(|&(gap, _)| gap <= SAME_BOUNDARY)
            .map(|(_, other)| other)
    };
    [nearest(0), nearest(1)]
}

/// Number of lane changes from `present` to `goal`, searched from the goal; `None` in another
/// roadblock, or without a way.
pub(crate) fn changes_between(
    map: &impl LaneRelations,
    present: LaneId,
    goal: LaneId,
) -> Option<usize> {
    if map.roadblock(present) != map.roadblock(goal) {
        return None;
    }
    let mut changes = BTreeMap::from([(goal, 0)]);
    let mut queue = VecDeque::from([goal]);
    while let Some(lane) = queue.pop_front() {
        let so_far = changes.get(&lane).copied()?;
        if lane == present {
            return Some(so_far);
        }
        for next in neighbors(map, lane).into_iter().flatten() {
            if let Entry::Vacant(unseen) = changes.entry(next) {
                unseen.insert(so_far + 1);
                queue.push_back(next);
            }
        }
    }
    None
}
