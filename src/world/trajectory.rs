//! Planned trajectories and their interpolation.

use super::{EgoState, MICROS_PER_SECOND};
use crate::geometry::{Pose, Vector, wrap_angle};

/// One state of a trajectory: the quantities that nuPlan interpolates (devkit
/// `interpolated_trajectory.py`).
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct TrajectoryState {
    /// Time, µs.
    pub time_us: i64,
    /// Rear-axle pose, map frame.
    pub rear_axle: Pose,
    /// Rear-axle velocity in the body frame, m/s.
    pub velocity: Vector,
    /// Rear-axle acceleration in the body frame, m/s².
    pub acceleration: Vector,
    /// Steering angle, radians.
    pub steering_angle: f64,
}

impl TrajectoryState {
    /// A state at a pose that moves straight ahead.
    #[inline]
    pub fn moving(time_us: i64, rear_axle: Pose, speed: f64, acceleration: f64) -> Self {
        Self {
            time_us,
            rear_axle,
            velocity: Vector::new(speed, 0.0),
            acceleration: Vector::new(acceleration, 0.0),
            steering_angle: 0.0,
        }
    }
}

impl From<&EgoState> for TrajectoryState {
    fn from(ego: &EgoState) -> Self {
        Self {
            time_us: ego.time_us,
            rear_axle: ego.rear_axle,
            velocity: ego.velocity,
            acceleration: ego.acceleration,
            steering_angle: ego.steering_angle,
        }
    }
}

/// Why there is no such trajectory or state.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the message of a variant says what it is")]
#[non_exhaustive]
pub enum TrajectoryError {
    #[error("a trajectory needs at least 2 states, got {0}")]
    TooShort(usize),
    #[error("time of state {index} ({time_us} µs) is not after that of the state before")]
    TimeNotIncreasing { index: usize, time_us: i64 },
    #[error("state {0} of the trajectory has a NaN or infinite value")]
    NotFinite(usize),
    #[error("time {time_us} µs lies outside the trajectory ({start_us} to {end_us} µs)")]
    OutOfRange {
        time_us: i64,
        start_us: i64,
        end_us: i64,
    },
}

/// A path in time of the ego's rear axle: at least two states, times increasing, all finite.
#[derive(Debug, Clone, PartialEq)]
pub struct Trajectory {
    states: Vec<TrajectoryState>,
}

impl Trajectory {
    /// A trajectory through the given states.
    ///
    /// # Errors
    /// When there are fewer than two, a time does not grow, or a number is not finite.
    pub fn new(states: Vec<TrajectoryState>) -> Result<Self, TrajectoryError> {
        if states.len() < 2 {
            return Err(TrajectoryError::TooShort(states.len()));
        }
        if let Some(i) = states.windows(2).position(|w| w[1].time_us <= w[0].time_us) {
            return Err(TrajectoryError::TimeNotIncreasing {
                index: i + 1,
                time_us: states[i + 1].time_us,
            });
        }
        if let Some(i) = states
            .iter()
            .position(|s| !s.rear_axle.is_finite() || !s.velocity.norm().is_finite())
        {
            return Err(TrajectoryError::NotFinite(i));
        }
        Ok(Self { states })
    }

    /// The states in order.
    #[inline]
    pub fn states(&self) -> &[TrajectoryState] {
        &self.states
    }

    /// Time of the first state, µs.
    #[inline]
    pub fn start_us(&self) -> i64 {
        self.states[0].time_us
    }

    /// Time of the last state, µs.
    #[inline]
    pub fn end_us(&self) -> i64 {
        self.states[self.states.len() - 1].time_us
    }

    /// State at a time: every channel linear between its neighbors, the heading along the shorter
    /// turn.
    ///
    /// # Errors
    /// When the time lies outside the trajectory.
    pub fn at(&self, time_us: i64) -> Result<TrajectoryState, TrajectoryError> {
        let (start_us, end_us) = (self.start_us(), self.end_us());
        if time_us < start_us || time_us > end_us {
            return Err(TrajectoryError::OutOfRange {
                time_us,
                start_us,
                end_us,
            });
        }
        let after = self.states.partition_point(|s| s.time_us < time_us);
        let b = &self.states[after];
        // A planned state is returned bit for bit; interpolation would round it.
        if b.time_us == time_us {
            return Ok(*b);
        }
        let a = &self.states[after - 1];
        let share = (time_us - a.time_us) as f64 / (b.time_us - a.time_us) as f64;
        let mix = |from: f64, to: f64| from + (to - from) * share;
        Ok(TrajectoryState {
            time_us,
            rear_axle: Pose::new(
                mix(a.rear_axle.x, b.rear_axle.x),
                mix(a.rear_axle.y, b.rear_axle.y),
                wrap_angle(
                    a.rear_axle.heading
                        + wrap_angle(b.rear_axle.heading - a.rear_axle.heading) * share,
                ),
            ),
            velocity: a.velocity.lerp(&b.velocity, share),
            acceleration: a.acceleration.lerp(&b.acceleration, share),
            steering_angle: mix(a.steering_angle, b.steering_angle),
        })
    }

    /// Seconds from first to last state.
    pub fn duration_s(&self) -> f64 {
        (self.end_us() - self.start_us()) as f64 / MICROS_PER_SECOND
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn state(time_us: i64, x: f64, heading: f64) -> TrajectoryState {
        TrajectoryState::moving(time_us, Pose::new(x, 0.0, heading), 1.0, 0.0)
    }

    #[test]
    fn interpolates_heading_the_short_way() {
        let trajectory = Trajectory::new(vec![state(0, 0.0, 3.0), state(100, 1.0, -3.0)]).unwrap();
        let middle = trajectory.at(50).unwrap();
        assert!((middle.rear_axle.x - 0.5).abs() < 1e-12);
        assert!((middle.rear_axle.heading.abs() - std::f64::consts::PI).abs() < 1e-9);
    }

    #[test]
    fn refuses_what_cannot_be_driven() {
        assert_eq!(
            Trajectory::new(vec![state(0, 0.0, 0.0)]),
            Err(TrajectoryError::TooShort(1))
        );
        let same = Trajectory::new(vec![state(5, 0.0, 0.0), state(5, 1.0, 0.0)]);
        assert!(matches!(
            same,
            Err(TrajectoryError::TimeNotIncreasing { index: 1, .. })
        ));
        let nan = Trajectory::new(vec![state(0, 0.0, 0.0), state(5, f64::NAN, 0.0)]);
        assert_eq!(nan, Err(TrajectoryError::NotFinite(1)));
        let fine = Trajectory::new(vec![state(0, 0.0, 0.0), state(5, 1.0, 0.0)]).unwrap();
        assert!(matches!(
            fine.at(6),
            Err(TrajectoryError::OutOfRange { .. })
        ));
    }
}
