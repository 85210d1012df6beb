//! The trajectory through a model's waypoints.

use crate::reasoning::{WAYPOINT_SECONDS, Waypoints};
use planagent_world::geometry::{Point, Pose, Vector, wrap_angle};
use planagent_world::{
    EgoState, PACIFICA, STEP_S, STEP_US, Trajectory, TrajectoryError, TrajectoryState,
};
use std::f64::consts::{FRAC_PI_2, PI};

/// Steps of 0.1 s between two waypoints.
const STEPS: usize = 10;
/// Steps of 0.1 s of the trajectory: 8 s, as nuPlan's planners give.
const ALL_STEPS: usize = 80;
/// Below this speed the heading is kept, m/s.
const STANDSTILL: f64 = 0.2;

/// From the present state through the waypoints on cubic Hermite splines, whose slopes at inner
/// waypoints are those of Catmull and Rom; straight ahead after the last one. Waypoints behind the
/// ego are reached in reverse.
///
/// # Errors
/// When the state of the ego is not finite.
pub(super) fn through(
    ego: &EgoState,
    waypoints: &Waypoints,
) -> Result<Trajectory, TrajectoryError> {
    let from = ego.center();
    let mut knots = vec![Vector::zeros()];
    knots.extend(
        waypoints
            .0
            .iter()
            .map(|waypoint| Vector::new(waypoint.ahead, waypoint.left)),
    );
    let slope = |knot: usize| match knot {
        0 => ego.center_velocity(),
        WAYPOINT_SECONDS => knots[knot] - knots[knot - 1],
        _ => (knots[knot + 1] - knots[knot - 1]) / 2.0,
    };
    let mut heading = from.heading;
    let mut speed = ego.speed();
    let mut states = vec![TrajectoryState::from(ego)];
    for step in 1..=ALL_STEPS {
        let knot = (step / STEPS).min(WAYPOINT_SECONDS);
        let (place, velocity) = if knot == WAYPOINT_SECONDS {
            let velocity = slope(knot);
            (
                knots[knot] + velocity * ((step - knot * STEPS) as f64 * STEP_S),
                velocity,
            )
        } else {
            let share = (step % STEPS) as f64 / STEPS as f64;
            hermite(
                [knots[knot], knots[knot + 1]],
                [slope(knot), slope(knot + 1)],
                share,
            )
        };
        let mut along = velocity.norm();
        if along > STANDSTILL {
            let towards = wrap_angle(from.heading + velocity.y.atan2(velocity.x));
            let reverses = wrap_angle(towards - heading).abs() > FRAC_PI_2;
            heading = if reverses {
                wrap_angle(towards + PI)
            } else {
                towards
            };
            along = if reverses { -along } else { along };
        }
        let center = Pose::at(from.to_map(Point::from(place)), heading);
        let time_us = ego.time_us + step as i64 * STEP_US;
        states.push(TrajectoryState::moving(
            time_us,
            PACIFICA.rear_axle_of(center),
            along,
            (along - speed) / STEP_S,
        ));
        speed = along;
    }
    Trajectory::new(states)
}

/// Position and velocity at a fraction between two knots that are one second apart.
fn hermite([start, end]: [Vector; 2], [first, last]: [Vector; 2], u: f64) -> (Vector, Vector) {
    let (u2, u3) = (u * u, u * u * u);
    let place = start * (2.0 * u3 - 3.0 * u2 + 1.0)
        + first * (u3 - 2.0 * u2 + u)
        + end * (3.0 * u2 - 2.0 * u3)
        + last * (u3 - u2);
    let velocity = (end - start) * (6.0 * u - 6.0 * u2)
        + first * (3.0 * u2 - 4.0 * u + 1.0)
        + last * (3.0 * u2 - 2.0 * u);
    (place, velocity)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reasoning::Waypoint;
    use crate::test_road::ego_at;

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
