//! The trajectory through a model's waypoints.

use crate::planner::waypoint_path::{Onward, through_waypoints};
use crate::reasoning::Waypoints;
use planagent_world::geometry::Vector;
use planagent_world::{EgoState, Trajectory, TrajectoryError};

/// Steps of 0.1 s between two waypoints.
const STEPS: usize = 10;

/// Through the waypoints of an answer, and straight ahead after the last one.
///
/// # Errors
/// When the state of the ego is not finite.
pub(super) fn through(
    ego: &EgoState,
    waypoints: &Waypoints,
) -> Result<Trajectory, TrajectoryError> {
    let knots = waypoints
        .0
        .map(|waypoint| Vector::new(waypoint.ahead, waypoint.left));
    through_waypoints(ego, &knots, STEPS, Onward::Straight)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reasoning::{WAYPOINT_SECONDS, Waypoint};
    use crate::test_road::ego_at;
    use planagent_world::PACIFICA;

    fn plan(points: [(f64, f64); WAYPOINT_SECONDS]) -> Trajectory {
        let waypoints = Waypoints(points.map(|(ahead, left)| Waypoint { ahead, left }));
        through(&ego_at(7, 5.0, 8.0), &waypoints).unwrap()
    }

    #[test]
    fn the_waypoints_are_passed_second_by_second() {
        let points = [(8.0, 0.0), (15.5, 0.5), (22.0, 2.0), (28.0, 3.5)];
        let trajectory = plan(points);
        assert_eq!((trajectory.start_us(), trajectory.end_us()), (7, 8_000_007));
        let start = PACIFICA.rear_axle_to_center() + 5.0;
        for (second, (ahead, left)) in points.into_iter().enumerate() {
            let rear = trajectory.states()[(second + 1) * STEPS].rear_axle;
            let center = rear.translated(PACIFICA.rear_axle_to_center(), 0.0);
            assert!(
                (center.x - start - ahead).abs() < 1e-9 && (center.y - left).abs() < 1e-9,
                "{second}: {center:?}"
            );
        }
        let speeds = trajectory.states().iter().map(|state| state.velocity.x);
        assert!(speeds.into_iter().all(|speed| (5.0..9.0).contains(&speed)));
    }

    #[test]
    fn a_stop_keeps_the_heading_and_what_lies_behind_is_driven_to_in_reverse() {
        let stop = plan([(5.0, 0.0), (7.0, 0.0), (7.0, 0.0), (7.0, 0.0)]);
        assert!(
            stop.states()
                .iter()
                .all(|state| state.rear_axle.heading.abs() < 1e-9)
        );
        assert!((stop.states()[80].rear_axle.x - 12.0).abs() < 1e-9);
        let back = plan([(4.0, 0.0), (4.0, 0.0), (2.0, 0.0), (0.0, 0.0)]);
        let last = back.states()[80];
        assert!(
            last.velocity.x < -1.9 && last.rear_axle.heading.abs() < 1e-9,
            "{last:?}"
        );
    }
}
