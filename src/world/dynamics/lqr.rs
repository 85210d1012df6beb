//! The LQR tracker of nuPlan's two-stage controller (devkit `lqr.py`): longitudinal and lateral
//! errors, decoupled.

use super::bicycle::Command;
use super::profile::{JerkPenalty, MotionProfile};
use crate::geometry::{Pose, wrap_angle};
use crate::{EgoState, MICROS_PER_SECOND, PACIFICA, STEP_S, STEP_US, Trajectory, TrajectoryError};
use nalgebra::Vector3;

/// Horizon of the tracker, steps of 0.1 s.
const HORIZON: usize = 10;
/// Cost of a velocity error.
const Q_VELOCITY: f64 = 10.0;
/// Cost of an acceleration.
const R_ACCELERATION: f64 = 1.0;
/// Costs of lateral error, heading error and steering angle.
const Q_LATERAL: [f64; 3] = [1.0, 10.0, 0.0];
/// Cost of a steering rate.
const R_STEERING_RATE: f64 = 1.0;
/// Gain of the stop, 1/s.
const STOPPING_GAIN: f64 = 0.5;
/// Below this speed, actual and desired, the vehicle stops, m/s.
const STOPPING_VELOCITY: f64 = 0.2;

/// Why a trajectory cannot be tracked.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the message of a variant says what it is")]
#[non_exhaustive]
pub enum TrackingError {
    #[error("the trajectory does not cover the step to be driven")]
    NotCovered(#[from] TrajectoryError),
    #[error(
        "the trajectory lasts {duration_s} s; the tracker needs at least one step of {STEP_S} s"
    )]
    TooShort { duration_s: f64 },
}

/// The command that steers `ego` onto `trajectory` at the time of the ego.
///
/// # Errors
/// When the trajectory does not cover that time or lasts less than 0.1 s.
pub fn track(ego: &EgoState, trajectory: &Trajectory) -> Result<Command, TrackingError> {
    let target = trajectory.at(ego.time_us)?.rear_axle;
    let too_short = || TrackingError::TooShort {
        duration_s: trajectory.duration_s(),
    };
    let profile = MotionProfile::fit(
        &resampled(trajectory)?,
        JerkPenalty::AccelerationDifferences,
    );
    let profile = profile.ok_or_else(too_short)?;
    let now = (ego.time_us - trajectory.start_us()) as f64 / MICROS_PER_SECOND / STEP_S;
    Ok(command(ego, target, &profile, now))
}

/// Poses every 0.1 s from the start of the trajectory to its end.
fn resampled(trajectory: &Trajectory) -> Result<Vec<Pose>, TrajectoryError> {
    (trajectory.start_us()..=trajectory.end_us())
        .step_by(STEP_US as usize)
        .map(|time_us| Ok(trajectory.at(time_us)?.rear_axle))
        .collect()
}

/// The command for an ego that should be at `target`, `steps` steps after the start of the profile.
pub(super) fn command(
    ego: &EgoState,
    target: Pose,
    profile: &MotionProfile,
    steps: f64,
) -> Command {
    let speed = ego.velocity.x;
    let reference = profile.velocity_at(steps + HORIZON as f64);
    if reference <= STOPPING_VELOCITY && speed <= STOPPING_VELOCITY {
        return Command {
            acceleration: -STOPPING_GAIN * (speed - reference),
            steering_rate: 0.0,
        };
    }
    let acceleration = longitudinal(speed, reference);
    Command {
        acceleration,
        steering_rate: lateral(ego, target, acceleration, profile, steps),
    }
}

/// One-step LQR over the whole horizon: v ← v + B·a with B the horizon in seconds.
fn longitudinal(speed: f64, reference: f64) -> f64 {
    let b = HORIZON as f64 * STEP_S;
    -b * Q_VELOCITY / (b * Q_VELOCITY * b + R_ACCELERATION) * (speed - reference)
}

/// One-step LQR for a steering rate held over the horizon, the lateral dynamics linearized along
/// the predicted speeds and the reference curvatures.
fn lateral(
    ego: &EgoState,
    target: Pose,
    acceleration: f64,
    profile: &MotionProfile,
    steps: f64,
) -> f64 {
    let (sin, cos) = target.heading.sin_cos();
    let (dx, dy) = (ego.rear_axle.x - target.x, ego.rear_axle.y - target.y);
    let errors = Vector3::new(
        -dx * sin + dy * cos,
        wrap_angle(ego.rear_axle.heading - target.heading),
        ego.steering_angle,
    );
    // Columns of the product of the steps.
    let mut a = [Vector3::x(), Vector3::y(), Vector3::z()];
    let mut b = Vector3::zeros();
    let mut drift = Vector3::zeros();
    for i in 0..HORIZON {
        let speed = ego.velocity.x + acceleration * STEP_S * i as f64;
        // The matrix of a step is the identity with two numbers above its diagonal.
        let (sideways, turn) = (speed * STEP_S, speed * STEP_S / PACIFICA.wheel_base);
        let step = |v: Vector3<f64>| Vector3::new(v.x + sideways * v.y, v.y + turn * v.z, v.z);
        a = a.map(step);
        b = step(b) + Vector3::new(0.0, 0.0, STEP_S);
        let curvature = profile.curvature_at(steps + i as f64);
        drift = step(drift) - Vector3::new(0.0, speed * curvature * STEP_S, 0.0);
    }
    let mut terminal = a[0] * errors.x + a[1] * errors.y + a[2] * errors.z + drift;
    terminal[1] = wrap_angle(terminal[1]);
    terminal[2] = wrap_angle(terminal[2]);
    let weighted = b.component_mul(&Vector3::from(Q_LATERAL));
    -weighted.dot(&terminal) / (weighted.dot(&b) + R_STEERING_RATE)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::TrajectoryState;
    use crate::geometry::Vector;

    fn straight(start_us: i64, count: usize) -> Trajectory {
        let state = |i: usize| {
            let time_us = start_us + i as i64 * STEP_US;
            TrajectoryState::moving(time_us, Pose::new(i as f64, 0.0, 0.0), 10.0, 0.0)
        };
        Trajectory::new((0..count).map(state).collect()).unwrap()
    }

    fn ego(time_us: i64, y: f64) -> EgoState {
        EgoState::from_log(
            time_us,
            Pose::new(0.0, y, 0.0),
            Vector::new(10.0, 0.0),
            Vector::zeros(),
        )
    }

    #[test]
    fn steers_back_to_the_line() {
        let left = track(&ego(0, 1.0), &straight(0, 41)).unwrap();
        let right = track(&ego(0, -1.0), &straight(0, 41)).unwrap();
        assert!(
            left.steering_rate < -0.01 && (left.steering_rate + right.steering_rate).abs() < 1e-12
        );
        assert!(left.acceleration.abs() < 1e-9);
    }

    #[test]
    fn says_what_is_wrong_with_a_trajectory() {
        assert!(matches!(
            track(&ego(5_000_000, 0.0), &straight(0, 11)),
            Err(TrackingError::NotCovered(_))
        ));
        let blink = Trajectory::new(vec![
            TrajectoryState::moving(0, Pose::default(), 1.0, 0.0),
            TrajectoryState::moving(50_000, Pose::new(0.05, 0.0, 0.0), 1.0, 0.0),
        ])
        .unwrap();
        assert_eq!(
            track(&ego(0, 0.0), &blink),
            Err(TrackingError::TooShort { duration_s: 0.05 })
        );
    }
}
