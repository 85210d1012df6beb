//! The emergency brake (`tuplan_garage` `pdm_emergency_brake.py`).

use planagent_world::geometry::Vector;
use planagent_world::{
    EgoState, PACIFICA, STEP_S, STEP_US, Trajectory, TrajectoryError, TrajectoryState,
};

/// The brake acts on at-fault collisions up to this time from now, seconds.
pub const EMERGENCY_TIME_S: f64 = 2.0;
/// The brake overrules at this speed or below, m/s.
/// Why: docs/decisions/104-emergency-brake.md.
pub(crate) const EMERGENCY_SPEED: f64 = 5.0;

/// Up to this speed the brake regulates the acceleration too, m/s.
const CREEPING_SPEED: f64 = 0.2;
/// Change of speed per m/s of speed.
const SPEED_GAIN: f64 = 10.0;
/// The same at creeping speed.
const CREEPING_SPEED_GAIN: f64 = 4.0;
/// Change of speed per m/s² of acceleration, at creeping speed.
const CREEPING_ACCELERATION_GAIN: f64 = 1.0;
/// Bounds of the change: nuPlan's comfort bounds on the acceleration, m/s².
const CONTROL_BOUNDS: (f64, f64) = (-4.05, 2.40);
/// Factor on the remaining speed, as upstream.
const OVERSHOOT: f64 = 1.1;

/// Whether the ego is slow and a collision at its fault is near. `first_at_fault_s` is the time of
/// the first one of the best proposal, seconds from now.
pub fn needs_emergency_brake(first_at_fault_s: Option<f64>, ego: &EgoState) -> bool {
    ego.speed() <= EMERGENCY_SPEED
        && first_at_fault_s.is_some_and(|seconds| seconds <= EMERGENCY_TIME_S)
}

/// The speed at which the braking trajectory moves, m/s; below zero it goes backwards, as
/// upstream's does.
pub fn braking_speed(ego: &EgoState) -> f64 {
    let (speed, acceleration) = (ego.center_velocity().x, ego.center_acceleration().x);
    let (least, most) = CONTROL_BOUNDS;
    if speed > CREEPING_SPEED {
        OVERSHOOT * (speed + (-SPEED_GAIN * speed).clamp(least, most))
    } else {
        (-CREEPING_SPEED_GAIN * speed - CREEPING_ACCELERATION_GAIN * acceleration)
            .clamp(least, most)
    }
}

/// Straight on along the heading at [`braking_speed`], for `steps` steps of 0.1 s. The states
/// stand, as upstream's: nuPlan's tracker reads their poses alone.
///
/// # Errors
/// When the state of the ego is not finite.
pub fn emergency_brake(ego: &EgoState, steps: usize) -> Result<Trajectory, TrajectoryError> {
    let (center, speed) = (ego.center(), braking_speed(ego));
    let state = |step: usize| {
        let offset = center.direction() * (speed * step as f64 * STEP_S);
        let mut moved = center;
        (moved.x, moved.y) = (center.x + offset.x, center.y + offset.y);
        standing(
            ego.time_us + step as i64 * STEP_US,
            PACIFICA.rear_axle_of(moved),
        )
    };
    Trajectory::new((0..=steps).map(state).collect())
}

/// A planned state of which only the pose is known.
pub(super) fn standing(
    time_us: i64,
    rear_axle: planagent_world::geometry::Pose,
) -> TrajectoryState {
    let none = Vector::zeros();
    TrajectoryState {
        time_us,
        rear_axle,
        velocity: none,
        acceleration: none,
        steering_angle: 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use planagent_world::geometry::Pose;

    fn ego(speed: f64, acceleration: f64) -> EgoState {
        EgoState::from_log(
            0,
            Pose::new(1.0, 2.0, 0.0),
            Vector::new(speed, 0.0),
            Vector::new(acceleration, 0.0),
        )
    }

    #[test]
    fn only_a_slow_ego_brakes_and_only_for_what_is_near() {
        assert!(needs_emergency_brake(Some(2.0), &ego(5.0, 0.0)));
        assert!(!needs_emergency_brake(Some(2.1), &ego(5.0, 0.0)));
        assert!(!needs_emergency_brake(Some(0.5), &ego(5.01, 0.0)));
        assert!(!needs_emergency_brake(None, &ego(1.0, 0.0)));
    }

    #[test]
    fn the_speed_is_upstreams() {
        // 1.1·(4.5 − 4.05), 1.1·(0.3 − 3.0), −4·0.1 − 0.5, and the bound from above.
        for (speed, acceleration, expected) in [
            (4.5, 0.0, 0.495),
            (0.3, 0.0, -2.97),
            (0.1, 0.5, -0.9),
            (-0.1, -3.0, 2.40),
        ] {
            assert!(
                (braking_speed(&ego(speed, acceleration)) - expected).abs() < 1e-12,
                "{speed} {acceleration}"
            );
        }
        let trajectory = emergency_brake(&ego(0.3, 0.0), 80).unwrap();
        let last = trajectory.states()[80];
        assert!(
            (last.rear_axle.x - (1.0 - 2.97 * 8.0)).abs() < 1e-9
                && (last.rear_axle.y - 2.0).abs() < 1e-12
        );
        assert_eq!(trajectory.end_us(), 8_000_000);
    }
}
