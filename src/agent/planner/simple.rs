//! nuPlan's `simple_planner`: straight ahead up to a set speed (devkit `simple_planner.py`).
//! nuPlan's open-loop vectors use it.

use super::{Planner, PlannerError, PlannerInitialization, PlannerInput};
use planagent_world::dynamics::{Command, advance};
use planagent_world::geometry::Vector;
use planagent_world::{EgoState, Trajectory, TrajectoryError, TrajectoryState};

/// The planner that drives straight ahead. The default is nuPlan's `simple_planner.yaml`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SimplePlanner {
    /// Length of a trajectory, µs.
    pub horizon_us: i64,
    /// Time between its states, µs.
    pub sampling_us: i64,
    /// Acceleration up to the speed limit, body frame, m/s².
    pub acceleration: Vector,
    /// Speed limit, m/s. A faster ego brakes by the excess over it, per second.
    pub max_velocity: f64,
    /// Constant steering angle, radians.
    pub steering_angle: f64,
}

impl Default for SimplePlanner {
    fn default() -> Self {
        Self {
            horizon_us: 10_000_000,
            sampling_us: 250_000,
            acceleration: Vector::zeros(),
            max_velocity: 5.0,
            steering_angle: 0.0,
        }
    }
}

impl SimplePlanner {
    /// The trajectory from a state of the ego, by the kinematic bicycle.
    ///
    /// # Errors
    /// When the ego or a setting is not finite, or the horizon is shorter than a sample.
    pub fn trajectory(&self, ego: &EgoState) -> Result<Trajectory, TrajectoryError> {
        let start = EgoState::from_log(ego.time_us, ego.rear_axle, ego.velocity, self.acceleration);
        let mut state = EgoState {
            steering_angle: self.steering_angle,
            ..start
        };
        let mut states = vec![TrajectoryState::from(&state)];
        for _ in 0..self.horizon_us / self.sampling_us.max(1) {
            if state.speed() > self.max_velocity {
                // Kept: the excess is taken for an acceleration whatever the length of a sample,
                // and that acceleration stays when the limit is met. With nuPlan's quarter of a
                // second the speed falls towards the limit from above.
                state.acceleration = Vector::new(self.max_velocity - state.speed(), 0.0);
            }
            let kept = Command {
                acceleration: state.acceleration.x,
                steering_rate: 0.0,
            };
            state = advance(&state, kept, self.sampling_us);
            states.push(TrajectoryState::from(&state));
        }
        Trajectory::new(states)
    }
}

impl Planner for SimplePlanner {
    fn name(&self) -> &'static str {
        "simple"
    }

    fn initialize(&mut self, _: &PlannerInitialization<'_>) -> Result<(), PlannerError> {
        Ok(())
    }

    fn compute_trajectory(&mut self, input: &PlannerInput<'_>) -> Result<Trajectory, PlannerError> {
        Ok(self.trajectory(input.scene.ego)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_road::ego_at;

    #[test]
    fn a_slow_ego_keeps_its_speed() {
        let trajectory = SimplePlanner::default()
            .trajectory(&ego_at(7, 0.0, 4.0))
            .unwrap();
        assert_eq!(trajectory.states().len(), 41);
        assert_eq!(
            (trajectory.start_us(), trajectory.end_us()),
            (7, 10_000_007)
        );
        let last = trajectory.states()[40];
        assert!((last.rear_axle.x - 40.0).abs() < 1e-9 && (last.velocity.x - 4.0).abs() < 1e-9);
    }

    #[test]
    fn a_fast_ego_brakes_by_its_excess_over_the_limit() {
        let trajectory = SimplePlanner::default()
            .trajectory(&ego_at(0, 0.0, 9.0))
            .unwrap();
        // −4 m/s² for a quarter of a second, then −3 m/s², …: the excess shrinks by a quarter a
        // sample.
        for (i, speed) in [9.0, 8.0, 7.25, 6.6875].into_iter().enumerate() {
            assert!(
                (trajectory.states()[i].velocity.x - speed).abs() < 1e-12,
                "{i}"
            );
        }
        // With samples of a second the limit is met at once and the braking goes on below it,
        // through a standstill.
        let coarse = SimplePlanner {
            sampling_us: 1_000_000,
            ..SimplePlanner::default()
        };
        let trajectory = coarse.trajectory(&ego_at(0, 0.0, 9.0)).unwrap();
        for (i, speed) in [9.0, 5.0, 1.0, -3.0, -7.0, -9.0].into_iter().enumerate() {
            assert!(
                (trajectory.states()[i].velocity.x - speed).abs() < 1e-12,
                "{i}"
            );
        }
    }
}
