//! The kinematic bicycle with actuator lag that moves nuPlan's ego (devkit `kinematic_bicycle.py`).

use crate::geometry::{Pose, Vector, wrap_angle};
use crate::{EgoState, MICROS_PER_SECOND, PACIFICA};
use std::f64::consts::FRAC_PI_3;

/// Largest steering angle to either side, radians.
const MAX_STEERING_ANGLE: f64 = FRAC_PI_3;
/// Time constant of the low-pass filter between commanded and actual acceleration, seconds.
const ACCELERATION_LAG: f64 = 0.2;
/// Time constant of the low-pass filter between commanded and actual steering angle, seconds.
const STEERING_LAG: f64 = 0.05;

/// The command of a tracker for one step.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Command {
    /// Acceleration of the rear axle, m/s².
    pub acceleration: f64,
    /// Rate of the steering angle, rad/s.
    pub steering_rate: f64,
}

/// The ego after `dt_us` microseconds under `command`.
///
/// Explicit Euler: pose and heading move with the old speed and steering angle, speed and steering
/// angle with the lagged command. The speed is not clamped, so a braking vehicle may come to rest
/// slightly below zero, as in nuPlan.
pub fn advance(ego: &EgoState, command: Command, dt_us: i64) -> EgoState {
    let dt = dt_us as f64 / MICROS_PER_SECOND;
    let (speed, steering) = (ego.velocity.x, ego.steering_angle);

    let acceleration = ego.acceleration.x
        + dt / (dt + ACCELERATION_LAG) * (command.acceleration - ego.acceleration.x);
    let ideal_steering = steering + dt * command.steering_rate;
    let lagged_steering = steering + dt / (dt + STEERING_LAG) * (ideal_steering - steering);
    // The lagged angle becomes a rate and then an angle again, as in nuPlan, so that rounding is
    // the same.
    let steering_rate = (lagged_steering - steering) / dt;

    let Pose { x, y, heading } = ego.rear_axle;
    let (sin, cos) = heading.sin_cos();
    let turn = speed * steering.tan() / PACIFICA.wheel_base;

    let new_speed = speed + dt * acceleration;
    let new_steering =
        (steering + dt * steering_rate).clamp(-MAX_STEERING_ANGLE, MAX_STEERING_ANGLE);
    let angular_velocity = new_speed * new_steering.tan() / PACIFICA.wheel_base;
    EgoState {
        time_us: ego.time_us + dt_us,
        rear_axle: Pose::new(
            x + dt * speed * cos,
            y + dt * speed * sin,
            wrap_angle(heading + dt * turn),
        ),
        velocity: Vector::new(new_speed, 0.0),
        acceleration: Vector::new(acceleration, 0.0),
        steering_angle: new_steering,
        steering_rate,
        angular_velocity,
        angular_acceleration: (angular_velocity - ego.angular_velocity) / dt,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn driving(speed: f64, steering_angle: f64) -> EgoState {
        let state =
            EgoState::from_log(0, Pose::default(), Vector::new(speed, 0.0), Vector::zeros());
        EgoState {
            steering_angle,
            ..state
        }
    }

    #[test]
    fn commands_are_filtered_by_a_third_and_two_thirds() {
        let next = advance(
            &driving(5.0, 0.0),
            Command {
                acceleration: 3.0,
                steering_rate: 0.3,
            },
            100_000,
        );
        assert!((next.acceleration.x - 1.0).abs() < 1e-12);
        assert!((next.velocity.x - 5.1).abs() < 1e-12);
        assert!((next.steering_rate - 0.2).abs() < 1e-12);
        assert!(
            (next.rear_axle.x - 0.5).abs() < 1e-12,
            "the position moves with the old speed"
        );
        assert_eq!(next.time_us, 100_000);
    }

    #[test]
    fn a_held_wheel_drives_a_circle() {
        let steering = 0.2;
        let mut ego = driving(6.0, steering);
        for _ in 0..50 {
            ego = advance(&ego, Command::default(), 10_000);
        }
        let turned = 6.0 * steering.tan() / PACIFICA.wheel_base * 0.5;
        assert!((ego.rear_axle.heading - turned).abs() < 1e-9);
        assert!(ego.rear_axle.y > 0.0, "positive steering turns left");
    }

    #[test]
    fn steering_stops_at_its_limit() {
        let next = advance(
            &driving(1.0, 1.0),
            Command {
                acceleration: 0.0,
                steering_rate: 10.0,
            },
            100_000,
        );
        assert!((next.steering_angle - MAX_STEERING_ANGLE).abs() < 1e-12);
    }
}
