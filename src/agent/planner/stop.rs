//! The stop of an ego that has no plan.

use planagent_world::{EgoState, STEP_S, STEP_US, Trajectory, TrajectoryError, TrajectoryState};

/// Deceleration of a stop that no plan asks for, m/s²: within nuPlan's comfort bound of 4.05.
const DECELERATION: f64 = 4.0;

/// Straight ahead, braking to a stop, over `steps` steps of 0.1 s.
///
/// # Errors
/// When the ego's state is not finite.
pub fn comfortable_stop(ego: &EgoState, steps: usize) -> Result<Trajectory, TrajectoryError> {
    let mut speed = ego.velocity.x.max(0.0);
    let mut distance = 0.0;
    let mut states = vec![TrajectoryState::from(ego)];
    for step in 1..=steps {
        distance += speed * STEP_S;
        speed = (speed - DECELERATION * STEP_S).max(0.0);
        let pose = ego.rear_axle.translated(distance, 0.0);
        states.push(TrajectoryState::moving(
            ego.time_us + step as i64 * STEP_US,
            pose,
            speed,
            -DECELERATION,
        ));
    }
    Trajectory::new(states)
}
