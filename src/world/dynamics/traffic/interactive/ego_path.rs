//! The path of the ego in the next seconds, and which vehicles yield to it (interPlan
//! `agent_utils.py`, `idm_modified_agent_manager.py`).

use super::super::agent::IdmAgent;
use super::super::footprint::Footprint;
use super::is_behind;
use crate::geometry::{Point, Pose};
use crate::{DriverBehavior, EgoState, LaneId, LaneMap, PACIFICA};

/// Horizon, seconds.
const HORIZON_S: f64 = 3.0;

/// The box of the ego, and the strip that it covers at constant velocity.
#[derive(Debug, Clone)]
pub(super) struct EgoPath {
    footprint: Footprint,
}

impl EgoPath {
    /// The path from this state.
    pub(super) fn new(ego: &EgoState) -> Self {
        let own = Footprint::of_box(ego.footprint());
        let line = line(ego.center(), ego.center_velocity(), PACIFICA.length());
        let footprint = match Footprint::of_strip(&line, PACIFICA.width / 2.0) {
            Some(strip) => own.united(strip),
            None => own,
        };
        Self { footprint }
    }

    /// Its area.
    pub(super) fn footprint(&self) -> &Footprint {
        &self.footprint
    }

    /// Whether the path is an obstacle for a vehicle.
    pub(super) fn counts_for(
        &self,
        map: &LaneMap,
        agent: &IdmAgent,
        behavior: DriverBehavior,
        ego: &EgoState,
    ) -> bool {
        let center = ego.center().position();
        // interPlan fails where the center of a vehicle lies in no lane of its route. Here such a
        // vehicle sees the box alone.
        let Some(lane) = lane_of(map, agent) else {
            return false;
        };
        if map[lane].polygon.contains(center) {
            return false;
        }
        if map.roadblock_holds(map[lane].roadblock, center) {
            return !is_behind(center, agent) && behavior != DriverBehavior::Assertive;
        }
        behavior != DriverBehavior::Default
            && !self.footprint.meets(&Footprint::of_box(agent.shape()))
    }
}

/// The lane of an agent's route that holds its center.
fn lane_of(map: &LaneMap, agent: &IdmAgent) -> Option<LaneId> {
    let center = agent.pose().position();
    agent
        .route()
        .find(|&lane| map[lane].polygon.contains(center))
}

/// From the rear end through the box and on at constant velocity, longer by half a width at both
/// ends: shapely's square caps.
fn line(center: Pose, velocity: crate::geometry::Vector, length: f64) -> Vec<Pose> {
    let (half, cap) = (length / 2.0, PACIFICA.width / 2.0);
    let front = center.translated(half, 0.0);
    let moved = center.rotate(velocity) * HORIZON_S;
    let mut points: Vec<Point> = vec![
        center.translated(-half - cap, 0.0).position(),
        front.position(),
    ];
    if moved.norm() > f64::EPSILON {
        points.push(front.position() + moved + moved.normalize() * cap);
    } else {
        points[1] = center.translated(half + cap, 0.0).position();
    }
    points
        .into_iter()
        .map(|point| Pose::at(point, center.heading))
        .collect()
}
