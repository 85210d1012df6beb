//! The trajectory through a model's waypoints.

use planagent_world::geometry::{Point, Polyline, Pose, Vector, wrap_angle};
use planagent_world::{
    EgoState, PACIFICA, STEP_S, STEP_US, Trajectory, TrajectoryError, TrajectoryState,
};
use std::f64::consts::{FRAC_PI_2, FRAC_PI_3, PI};

/// Steps of 0.1 s of a trajectory: 8 s, as nuPlan's planners give.
const ALL_STEPS: usize = 80;
/// Below this speed the heading is kept, m/s.
const STANDSTILL: f64 = 0.2;
/// A centerline farther away is none to go on along, meters.
const LANE_REACH: f64 = 4.0;

/// How the ego goes on behind the last waypoint, at its speed there.
#[derive(Debug, Clone, Copy)]
pub enum Onward<'a> {
    /// Straight ahead.
    Straight,
    /// Along the nearest of these centerlines that goes its way, at its distance from it; straight
    /// ahead where none is near.
    Along(&'a [&'a Polyline]),
}

/// From the present state through waypoints (meters ahead and to the left of the ego's center,
/// `steps` steps of 0.1 s apart) on cubic Hermite splines, whose slopes at inner waypoints are those
/// of Catmull and Rom, and on to 8 s. Waypoints behind the ego are reached in reverse.
///
/// # Errors
/// When a state is not finite.
pub fn through_waypoints(
    ego: &EgoState,
    waypoints: &[Vector],
    steps: usize,
    onward: Onward<'_>,
) -> Result<Trajectory, TrajectoryError> {
    let from = ego.center();
    let spline = Spline::new(ego, waypoints, steps);
    let mut heading = from.heading;
    let mut speed = ego.speed();
    let mut states = vec![TrajectoryState::from(ego)];
    let mut way = None;
    for step in 1..=ALL_STEPS {
        let (place, velocity) = spline.at(step);
        let mut along = velocity.norm();
        // The direction of a velocity near zero is noise, so the heading stays.
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
        let mut center = Pose::at(from.to_map(Point::from(place)), heading);
        if step == spline.last_step() {
            way = LaneWay::from(onward, center).map(|way| (way, along));
        } else if let (Some((way, end_speed)), true) = (&way, step > spline.last_step()) {
            let behind_s = (step - spline.last_step()) as f64 * STEP_S;
            (center, along) = (way.at(end_speed * behind_s), *end_speed);
            heading = center.heading;
        }
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

/// A trajectory with states behind its last one, up to 8 s from `now_us`, at the speed there.
///
/// # Errors
/// When a state is not finite.
pub fn prolonged(
    trajectory: &Trajectory,
    now_us: i64,
    onward: Onward<'_>,
) -> Result<Trajectory, TrajectoryError> {
    let mut states = trajectory.states().to_vec();
    let until_us = now_us + ALL_STEPS as i64 * STEP_US;
    if let Some(last) = states.last().copied() {
        let end = last
            .rear_axle
            .translated(PACIFICA.rear_axle_to_center(), 0.0);
        let (way, speed) = (LaneWay::from(onward, end), last.velocity.x);
        let mut behind_s = 0.0;
        let mut time_us = last.time_us;
        while time_us < until_us {
            (time_us, behind_s) = (time_us + STEP_US, behind_s + STEP_S);
            let center = way.as_ref().map_or_else(
                || end.translated(speed * behind_s, 0.0),
                |way| way.at(speed * behind_s),
            );
            let rear_axle = PACIFICA.rear_axle_of(center);
            states.push(TrajectoryState::moving(time_us, rear_axle, speed, 0.0));
        }
    }
    Trajectory::new(states)
}

/// The spline in the frame of the ego's center.
struct Spline {
    knots: Vec<Vector>,
    /// Change per time between two knots.
    slopes: Vec<Vector>,
    steps: usize,
}

impl Spline {
    fn new(ego: &EgoState, waypoints: &[Vector], steps: usize) -> Self {
        let mut knots = vec![Vector::zeros()];
        knots.extend(waypoints);
        let first = ego.center_velocity() * (steps as f64 * STEP_S);
        let inner = knots.windows(3).filter_map(|three| match three {
            [before, _, after] => Some((after - before) / 2.0),
            _ => None,
        });
        let last = match knots.as_slice() {
            [.., before, last] => last - before,
            _ => first,
        };
        let slopes = std::iter::once(first).chain(inner).chain([last]).collect();
        Self {
            knots,
            slopes,
            steps,
        }
    }

    /// The step at the last knot.
    fn last_step(&self) -> usize {
        (self.knots.len() - 1) * self.steps
    }

    /// Place and velocity (m/s) at a step; straight on behind the last knot.
    fn at(&self, step: usize) -> (Vector, Vector) {
        let spacing_s = self.steps as f64 * STEP_S;
        let last = self.knots.len() - 1;
        let knot = (step / self.steps).min(last);
        if knot == last {
            let velocity = self.slopes[last] / spacing_s;
            let behind_s = (step - knot * self.steps) as f64 * STEP_S;
            return (self.knots[last] + velocity * behind_s, velocity);
        }
        let share = (step % self.steps) as f64 / self.steps as f64;
        let (place, change) = hermite(
            [self.knots[knot], self.knots[knot + 1]],
            [self.slopes[knot], self.slopes[knot + 1]],
            share,
        );
        (place, change / spacing_s)
    }
}

/// Position and change at a fraction between two knots.
fn hermite([start, end]: [Vector; 2], [first, last]: [Vector; 2], u: f64) -> (Vector, Vector) {
    let (u2, u3) = (u * u, u * u * u);
    let place = start * (2.0 * u3 - 3.0 * u2 + 1.0)
        + first * (u3 - 2.0 * u2 + u)
        + end * (3.0 * u2 - 2.0 * u3)
        + last * (u3 - u2);
    let change = (end - start) * (6.0 * u - 6.0 * u2)
        + first * (3.0 * u2 - 4.0 * u + 1.0)
        + last * (3.0 * u2 - 2.0 * u);
    (place, change)
}

/// The way along a centerline from a place beside it.
struct LaneWay<'a> {
    line: &'a Polyline,
    s: f64,
    lateral: f64,
}

impl<'a> LaneWay<'a> {
    /// Along the nearest centerline that goes the way of a pose.
    fn from(onward: Onward<'a>, from: Pose) -> Option<Self> {
        let Onward::Along(lines) = onward else {
            return None;
        };
        let ways = lines.iter().map(|line| {
            let on = line.project(from.position());
            let turn = wrap_angle(on.heading - from.heading).abs();
            let way = Self {
                line,
                s: on.s,
                lateral: on.lateral,
            };
            (turn, way)
        });
        ways.filter(|(turn, way)| *turn <= FRAC_PI_3 && way.lateral.abs() <= LANE_REACH)
            .map(|(_, way)| way)
            .min_by(|a, b| a.lateral.abs().total_cmp(&b.lateral.abs()))
    }

    /// The pose after some meters; straight on behind the end of the line.
    fn at(&self, meters: f64) -> Pose {
        let s = (self.s + meters).max(0.0);
        let beyond = (s - self.line.length()).max(0.0);
        let s = s - beyond;
        Pose::at(
            self.line.frenet_to_map(s, self.lateral),
            self.line.heading_at(s),
        )
        .translated(beyond, 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_road::ego_at;

    const HALF: usize = 5;

    fn ahead(points: &[(f64, f64)], onward: Onward<'_>) -> Trajectory {
        let waypoints: Vec<Vector> = points.iter().map(|&(x, y)| Vector::new(x, y)).collect();
        through_waypoints(&ego_at(0, 5.0, 8.0), &waypoints, HALF, onward).unwrap()
    }

    #[test]
    fn the_waypoints_are_passed_every_half_second_and_speeds_are_per_second() {
        let points = [4.0, 8.0, 12.0, 16.0, 20.0, 24.0].map(|x| (x, 0.0));
        let trajectory = ahead(&points, Onward::Straight);
        let start = trajectory.states()[0].rear_axle.x;
        for (i, (x, _)) in points.iter().enumerate() {
            let state = trajectory.states()[(i + 1) * HALF];
            assert!((state.rear_axle.x - start - x).abs() < 1e-9);
        }
        let speeds = trajectory.states().iter().map(|state| state.velocity.x);
        assert!(speeds.into_iter().all(|speed| (speed - 8.0).abs() < 1e-9));
        assert_eq!(trajectory.states().len(), ALL_STEPS + 1);
    }

    #[test]
    fn behind_the_last_waypoint_the_ego_keeps_speed_and_distance_along_the_lane() {
        let points = [4.0, 8.0, 12.0, 16.0, 20.0, 24.0].map(|x| (x, 0.5));
        // The lane turns to the left 40 m after the start.
        let line = Polyline::new([
            Point::new(0.0, 0.0),
            Point::new(40.0, 0.0),
            Point::new(40.0, 200.0),
        ])
        .unwrap();
        let trajectory = ahead(&points, Onward::Along(&[&line]));
        let last = trajectory.states()[ALL_STEPS];
        let center = last
            .rear_axle
            .translated(PACIFICA.rear_axle_to_center(), 0.0);
        assert!((last.velocity.x - 8.0).abs() < 1e-6, "{last:?}");
        assert!(
            (line.project(center.position()).lateral - 0.5).abs() < 1e-6,
            "{center:?}"
        );
        assert!((last.rear_axle.heading - FRAC_PI_2).abs() < 1e-6);
        let far = Polyline::new([Point::new(0.0, 30.0), Point::new(300.0, 30.0)]).unwrap();
        let straight = ahead(&points, Onward::Along(&[&far]));
        assert_eq!(straight, ahead(&points, Onward::Straight));
    }

    #[test]
    fn a_kept_trajectory_reaches_eight_seconds_from_now_again() {
        let points = [4.0, 8.0, 12.0, 16.0, 20.0, 24.0].map(|x| (x, 0.0));
        let trajectory = ahead(&points, Onward::Straight);
        let longer = prolonged(&trajectory, 3_000_000, Onward::Straight).unwrap();
        assert_eq!(longer.end_us(), 11_000_000);
        let speeds = longer.states().iter().map(|state| state.velocity.x);
        assert!(speeds.into_iter().all(|speed| (speed - 8.0).abs() < 1e-9));
        assert_eq!(
            longer.states()[..=ALL_STEPS],
            trajectory.states()[..=ALL_STEPS]
        );
    }
}
