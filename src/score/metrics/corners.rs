//! Whether the four corners of the ego are in one lane (devkit `route_extractor.py`,
//! `extract_corners_route` and `get_common_or_connected_route_objs_of_corners`).

use super::route::{driven_route, lanes_at, lanes_from};
use planagent_world::geometry::Pose;
use planagent_world::{EgoState, LaneId, LaneMap};
use std::collections::BTreeSet;

/// Lanes at the corners: front left, rear left, rear right, front right.
pub type CornerLanes = [Vec<LaneId>; 4];

/// Whether the corners of the ego are in one lane.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum CornerAgreement {
    /// No corner is in any lane (nuPlan: the empty set).
    Outside,
    /// The corners share these lanes, or are in lanes that follow one another.
    Shared(BTreeSet<LaneId>),
    /// The corners are in different lanes, or some of them in none (nuPlan: `None`).
    Split,
}

/// The lanes that a driven path used: at the center, at the corners, and whether the corners agree,
/// for every sample.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DrivenLanes {
    /// At the center of the ego.
    pub center: Vec<Vec<LaneId>>,
    /// At its corners.
    pub corners: Vec<CornerLanes>,
    /// Whether the corners agree.
    pub agreement: Vec<CornerAgreement>,
}

impl DrivenLanes {
    /// The lanes along a sequence of ego states.
    pub fn from_states(map: &LaneMap, states: &[EgoState]) -> Self {
        let centers: Vec<Pose> = states.iter().map(EgoState::center).collect();
        let corners = corner_routes(map, states);
        let agreement = corners.iter().map(|lanes| agreement(map, lanes)).collect();
        Self {
            center: driven_route(map, &centers),
            corners,
            agreement,
        }
    }

    /// Whether all corners are in one lane, or in lanes that follow one another, at this sample.
    /// Elsewhere the ego counts as in multiple lanes or off the road.
    pub fn in_common(&self, sample: usize) -> bool {
        matches!(self.agreement.get(sample), Some(CornerAgreement::Shared(_)))
    }
}

fn corner_routes(map: &LaneMap, states: &[EgoState]) -> Vec<CornerLanes> {
    let mut candidates: Vec<LaneId> = Vec::new();
    let mut route = Vec::with_capacity(states.len());
    for (i, state) in states.iter().enumerate() {
        let shape = state.footprint();
        let mut next: Vec<LaneId> = Vec::new();
        let lanes = shape.corners().map(|corner| {
            let mut here = if candidates.is_empty() {
                Vec::new()
            } else {
                lanes_from(map, &candidates, corner, shape.center)
            };
            if here.is_empty() {
                here = lanes_at(map, corner, shape.center);
                // nuPlan means the first sample here but tests for the second.
                if i == 1 {
                    add_new(&mut candidates, &here);
                }
            }
            add_new(&mut next, &here);
            here
        });
        route.push(lanes);
        candidates = next;
    }
    route
}

fn add_new(list: &mut Vec<LaneId>, more: &[LaneId]) {
    for id in more {
        if !list.contains(id) {
            list.push(*id);
        }
    }
}

fn agreement(map: &LaneMap, corners: &CornerLanes) -> CornerAgreement {
    if corners.iter().all(Vec::is_empty) {
        return CornerAgreement::Outside;
    }
    if corners.iter().any(Vec::is_empty) {
        return CornerAgreement::Split;
    }
    let [fl, rl, rr, fr] = corners
        .each_ref()
        .map(|lanes| lanes.iter().copied().collect::<BTreeSet<LaneId>>());
    let common: BTreeSet<LaneId> = fl
        .iter()
        .copied()
        .filter(|id| rl.contains(id) && rr.contains(id) && fr.contains(id))
        .collect();
    if !common.is_empty() {
        return CornerAgreement::Shared(common);
    }
    let with_next = |ids: &BTreeSet<LaneId>| extended(ids, |id| map[id].outgoing.as_slice());
    let with_before = |ids: &BTreeSet<LaneId>| extended(ids, |id| map[id].incoming.as_slice());
    let rears_meet = !rl.is_disjoint(&with_next(&rr)) || !rr.is_disjoint(&with_next(&rl));
    if !rears_meet {
        return CornerAgreement::Split;
    }
    // As in the devkit: a lane connects the corners only where both diagonals pass over it.
    let one: BTreeSet<LaneId> = with_before(&fl)
        .intersection(&with_next(&rr))
        .copied()
        .collect();
    let other: BTreeSet<LaneId> = with_before(&fr)
        .intersection(&with_next(&rl))
        .copied()
        .collect();
    let connecting: BTreeSet<LaneId> = one.intersection(&other).copied().collect();
    if connecting.is_empty() {
        CornerAgreement::Split
    } else {
        CornerAgreement::Shared(connecting)
    }
}

fn extended<'m>(
    ids: &BTreeSet<LaneId>,
    edges: impl Fn(LaneId) -> &'m [LaneId],
) -> BTreeSet<LaneId> {
    ids.iter()
        .copied()
        .chain(ids.iter().flat_map(|&id| edges(id).iter().copied()))
        .collect()
}
