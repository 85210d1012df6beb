//! The rules of nuPlan's simulation, each worked out by hand on a small map (nuPlan devkit:
//! `idm_agents_builder.py`, `idm_agent_manager.py`, `idm_agent.py`, `simulation.py`,
//! `log_playback.py`).

mod agents_at_the_start;
mod agents_on_their_way;
mod loops;

use crate::road::Road;
use planagent_world::geometry::{OrientedBox, Pose};
use planagent_world::{
    EgoState, LaneId, LaneKind, LaneMap, ObjectKind, PACIFICA, SignalStatus, TrackToken,
    TrackedObject, TrafficLights,
};
use std::sync::Arc;

/// Length and width of every car, meters.
const CAR: (f64, f64) = (4.6, 2.0);

fn car(token: u32, center: Pose, speed: f64) -> TrackedObject {
    object(token, ObjectKind::Vehicle, center, CAR, speed)
}

fn object(
    token: u32,
    kind: ObjectKind,
    center: Pose,
    (length, width): (f64, f64),
    speed: f64,
) -> TrackedObject {
    let velocity = center.direction() * speed;
    TrackedObject {
        token: TrackToken(token),
        kind,
        shape: OrientedBox::new(center, length, width),
        velocity,
    }
}

/// An ego whose box is centered at a pose.
fn ego(center: Pose, speed: f64) -> EgoState {
    let velocity = planagent_world::geometry::Vector::new(speed, 0.0);
    EgoState::from_log(
        0,
        PACIFICA.rear_axle_of(center),
        velocity,
        planagent_world::geometry::Vector::zeros(),
    )
}

/// An ego that stands beside every road.
fn bystander() -> EgoState {
    ego(Pose::new(50.0, 40.0, 0.0), 0.0)
}

fn lights(lane: LaneId, status: SignalStatus) -> TrafficLights {
    [(lane, status)].into_iter().collect()
}

/// One lane along the x axis from 0 to 300 m with a vertex every meter and a limit of 12 m/s.
fn long_lane() -> Arc<LaneMap> {
    let mut road = Road::default();
    road.dense(LaneKind::Lane, (0.0, 0.0), (300.0, 0.0), Some(12.0));
    Arc::new(road.build())
}

/// The acceleration that nuPlan's agents (v0 as given, s0 = 1 m, T = 1.5 s, a = 1, b = 2 m/s²)
/// choose, written out once more.
fn law(speed: f64, target: f64, gap: f64, lead: f64) -> f64 {
    let desired = 1.0 + 1.5 * speed + speed * (speed - lead) / (2.0 * 2.0f64.sqrt());
    (1.0 - (speed / target).powi(4) - (desired / gap.max(1.0)).powi(2)).clamp(-2.0, 1.0)
}
