//! The reactive agents at iteration 0 (devkit `idm_agents_builder.py`).

use super::agent::IdmAgent;
use crate::dynamics::idm::IdmParameters;
use crate::geometry::OrientedBox;
use crate::{EgoState, LaneId, LaneKind, LaneMap, ObjectKind, TrackedObject};

/// The agents of iteration 0 in the order of the log: vehicles on a lane or a connector, snapped to
/// its baseline, unless the snapped box meets the ego, a logged object or an earlier agent, or an
/// earlier agent has the same track.
pub(super) fn agents(
    map: &LaneMap,
    objects: &[TrackedObject],
    open_loop: &[TrackedObject],
    ego: &EgoState,
    law: IdmParameters,
) -> Vec<IdmAgent> {
    let mut taken: Vec<OrientedBox> = open_loop.iter().map(|object| object.shape).collect();
    taken.push(ego.footprint());
    let mut agents = Vec::new();
    // The limit of a lane also becomes the target of the agents after it that have none, as in
    // nuPlan.
    let mut running = law;
    for vehicle in objects
        .iter()
        .filter(|object| object.kind == ObjectKind::Vehicle)
    {
        if agents
            .iter()
            .any(|agent: &IdmAgent| agent.token() == vehicle.token)
        {
            continue;
        }
        let Some(lane) = lane_of(map, vehicle) else {
            continue;
        };
        let nearest = map[lane]
            .centerline
            .nearest_pose(vehicle.shape.center.position());
        let snapped = vehicle.shape.moved_to(nearest);
        if taken.iter().any(|shape| shape.overlaps(&snapped)) {
            continue;
        }
        if let Some(limit) = map[lane].speed_limit.filter(|&limit| limit != 0.0) {
            running.target_velocity = limit;
        }
        let speed = if vehicle.speed().is_finite() {
            vehicle.speed()
        } else {
            ego.speed()
        };
        if let Some(agent) = IdmAgent::snapped(vehicle, speed, map, lane, running) {
            taken.push(snapped);
            agents.push(agent);
        }
    }
    agents
}

/// The lane that contains the center of a vehicle, or in an intersection the connector; of several
/// the one with the nearest heading. nuPlan does not wrap the difference of the headings.
fn lane_of(map: &LaneMap, vehicle: &TrackedObject) -> Option<LaneId> {
    let center = vehicle.shape.center.position();
    let lanes = map.lanes_of_kind_at(center, LaneKind::Lane);
    let candidates = if !lanes.is_empty() {
        lanes
    } else if map.in_intersection(center) {
        map.lanes_of_kind_at(center, LaneKind::Connector)
    } else {
        return None;
    };
    let turn = |lane: &LaneId| {
        (map[*lane].centerline.nearest_pose(center).heading - vehicle.shape.center.heading).abs()
    };
    candidates
        .into_iter()
        .min_by(|a, b| turn(a).total_cmp(&turn(b)))
}
