//! The log after the end of a scenario.
//!
//! nuPlan's logs go on after a scenario, and the devkit's log replay and open-loop metrics look
//! eight seconds ahead. The ego's recorded states come first. Then, and for all others at once, the
//! road users keep their last speed: along their lane where they are on one and head along it, else
//! straight. They do not react to each other. Lights keep their last state.

use crate::{Frame, Scenario};
use planagent_world::geometry::{Point, Polyline, Pose, Vector, wrap_angle};
use planagent_world::{
    EgoState, LaneId, LaneMap, MICROS_PER_SECOND, ObjectKind, RoadblockId, STEP_US, TrackedObject,
};

/// Frames after the end: nine seconds at 10 Hz, one more than nuPlan's longest horizon.
pub(super) const FRAMES_AFTER: usize = 90;
/// Slower than this stands, m/s.
const STANDING: f64 = 0.1;
/// A road user on a lane follows it if its heading differs by less than this, rad.
const ALONG: f64 = 0.5;

/// The frames after the last one of a scenario.
pub(super) fn frames_after(scenario: &Scenario) -> Vec<Frame> {
    let Some(last) = scenario.frames.last() else {
        return Vec::new();
    };
    let map = &scenario.map;
    let objects: Vec<(Course, &TrackedObject)> = last
        .objects
        .iter()
        .map(|object| (Course::of_object(map, object), object))
        .collect();
    egos_after(scenario, &last.ego)
        .into_iter()
        .map(|ego| {
            let seconds = (ego.time_us - last.ego.time_us) as f64 / MICROS_PER_SECOND;
            let objects = objects
                .iter()
                .map(|(course, object)| course.moved(object, seconds));
            Frame {
                ego,
                objects: objects.collect(),
                lights: last.lights.clone(),
            }
        })
        .collect()
}

/// The recorded states, then those at the speed of the last of them.
fn egos_after(scenario: &Scenario, last: &EgoState) -> Vec<EgoState> {
    let mut states: Vec<EgoState> = scenario.future.iter().copied().take(FRAMES_AFTER).collect();
    let from = states.last().copied().unwrap_or(*last);
    let course = Course::of_ego(&scenario.map, &scenario.route.roadblocks, &from);
    let missing = FRAMES_AFTER - states.len();
    states.extend((1..=missing as i64).map(|step| {
        let pose = course.pose_after((step * STEP_US) as f64 / MICROS_PER_SECOND);
        let velocity = if course.stands() {
            Vector::zeros()
        } else {
            from.velocity
        };
        EgoState::from_log(
            from.time_us + step * STEP_US,
            pose,
            velocity,
            Vector::zeros(),
        )
    }));
    states
}

/// Where a road user goes at constant speed.
struct Course {
    start: Pose,
    /// Map frame, m/s.
    velocity: Vector,
    lane: Option<Lanes>,
}

/// A course along lanes, as far as they go; then straight on.
struct Lanes {
    line: Polyline,
    /// Arc length of the start, m.
    from: f64,
    /// Offset to the left, m.
    lateral: f64,
    /// Heading relative to the line, rad.
    turned: f64,
}

impl Course {
    fn of_ego(map: &LaneMap, route: &[RoadblockId], ego: &EgoState) -> Self {
        Self::new(
            map,
            route,
            ego.rear_axle,
            ego.rear_axle.rotate(ego.velocity),
        )
    }

    fn of_object(map: &LaneMap, object: &TrackedObject) -> Self {
        let on_lanes = matches!(object.kind, ObjectKind::Vehicle | ObjectKind::Bicycle);
        let (start, velocity) = (object.shape.center, object.velocity);
        if on_lanes {
            Self::new(map, &[], start, velocity)
        } else {
            Self {
                start,
                velocity,
                lane: None,
            }
        }
    }

    fn new(map: &LaneMap, route: &[RoadblockId], start: Pose, velocity: Vector) -> Self {
        let mut course = Self {
            start,
            velocity,
            lane: None,
        };
        if !course.stands() {
            course.lane = Lanes::ahead(map, route, start, velocity.norm() * FRAMES_AFTER as f64);
        }
        course
    }

    /// Whether it stands, or its speed is not known.
    fn stands(&self) -> bool {
        let speed = self.velocity.norm();
        speed.is_nan() || speed < STANDING
    }

    fn pose_after(&self, seconds: f64) -> Pose {
        match &self.lane {
            _ if self.stands() => self.start,
            Some(lanes) => lanes.pose_after(self.velocity.norm() * seconds),
            None => Pose::at(
                self.start.position() + self.velocity * seconds,
                self.start.heading,
            ),
        }
    }

    fn moved(&self, object: &TrackedObject, seconds: f64) -> TrackedObject {
        let center = self.pose_after(seconds);
        let turn = Pose::new(0.0, 0.0, center.heading - self.start.heading);
        TrackedObject {
            shape: object.shape.moved_to(center),
            velocity: turn.rotate(object.velocity),
            ..*object
        }
    }
}

impl Lanes {
    /// The lanes from a pose on, at least `length` meters where they go so far. `None` beside the
    /// lanes or across them.
    fn ahead(map: &LaneMap, route: &[RoadblockId], start: Pose, length: f64) -> Option<Self> {
        let along = |&lane: &LaneId| {
            let foot = map[lane].centerline.project(start.position());
            wrap_angle(foot.heading - start.heading).abs() < ALONG
        };
        let here: Vec<LaneId> = map
            .lanes_at(start.position())
            .into_iter()
            .filter(along)
            .collect();
        let on_route: Vec<LaneId> = here
            .iter()
            .copied()
            .filter(|&id| route.contains(&map[id].roadblock))
            .collect();
        // Lanes overlap in junctions; of several, the one on the route is what the ego follows.
        let mut lane = map.best_fit(
            if on_route.is_empty() {
                &here
            } else {
                &on_route
            },
            start,
        )?;
        let mut line = map[lane].centerline.clone();
        let foot = line.project(start.position());
        let turned = wrap_angle(start.heading - line.smooth_pose_at(foot.s).heading);
        while line.length() < foot.s + length {
            let Some(next) = next_lane(map, route, lane) else {
                break;
            };
            lane = next;
            line = line.joined(&map[lane].centerline);
        }
        Some(Self {
            from: foot.s,
            lateral: foot.lateral,
            turned,
            line,
        })
    }

    fn pose_after(&self, distance: f64) -> Pose {
        let s = self.from + distance;
        let beyond = (s - self.line.length()).max(0.0);
        let on_line = self.line.smooth_pose_at(s);
        let there = on_line.to_map(Point::new(beyond, self.lateral));
        Pose::at(there, wrap_angle(on_line.heading + self.turned))
    }
}

/// The lane after a lane: one on the route, else the one that turns least.
fn next_lane(map: &LaneMap, route: &[RoadblockId], lane: LaneId) -> Option<LaneId> {
    let onward = &map[lane].outgoing;
    let on_route = onward
        .iter()
        .copied()
        .find(|&next| route.contains(&map[next].roadblock));
    let turn = |next: &LaneId| {
        let line = &map[*next].centerline;
        wrap_angle(line.heading_at(line.length()) - line.heading_at(0.0)).abs()
    };
    on_route.or_else(|| {
        onward
            .iter()
            .copied()
            .min_by(|a, b| turn(a).total_cmp(&turn(b)))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generator::{Spec, generate, types};

    #[test]
    fn recorded_states_come_first_and_then_the_last_speed_goes_on() {
        let mut scenario = generate(&Spec::new(types::high_magnitude_speed::TYPE, 1)).unwrap();
        scenario.future.truncate(7);
        let (last, recorded) = (
            scenario.frames.last().unwrap().clone(),
            scenario.future.clone(),
        );
        let after = frames_after(&scenario);
        assert_eq!(after.len(), FRAMES_AFTER);
        let egos: Vec<EgoState> = after.iter().map(|frame| frame.ego).collect();
        assert_eq!(egos[..7], recorded[..]);
        assert!(
            after
                .iter()
                .enumerate()
                .all(|(i, f)| f.ego.time_us == last.ego.time_us + (i as i64 + 1) * STEP_US)
        );
        let speed = recorded[6].speed();
        assert!(speed > 5.0);
        for pair in egos[6..].windows(2) {
            let moved = pair[0].rear_axle.distance(&pair[1].rear_axle);
            assert!(
                (moved / 0.1 - speed).abs() < 0.2,
                "{moved} m at {speed} m/s"
            );
            assert!(wrap_angle(pair[1].rear_axle.heading - pair[0].rear_axle.heading).abs() < 0.1);
        }
        assert!(
            after
                .iter()
                .all(|frame| frame.lights == last.lights
                    && frame.objects.len() == last.objects.len())
        );
        for (first, end) in last
            .objects
            .iter()
            .zip(after[FRAMES_AFTER - 1].objects.iter())
        {
            let distance = (end.shape.center.position() - first.shape.center.position()).norm();
            assert!(
                distance <= first.speed() * 9.0 + 4.0,
                "{first:?} moved {distance} m"
            );
            assert!((end.speed() - first.speed()).abs() < 1e-9);
            assert!(first.speed() >= STANDING || distance < 1e-12);
        }
    }

    #[test]
    fn a_lane_that_ends_goes_straight_on() {
        let line = Polyline::new([Point::new(0.0, 0.0), Point::new(10.0, 0.0)]).unwrap();
        let lanes = Lanes {
            line,
            from: 4.0,
            lateral: 1.0,
            turned: 0.1,
        };
        for (distance, x) in [(3.0, 7.0), (16.0, 20.0)] {
            let pose = lanes.pose_after(distance);
            assert!(
                pose.distance(&Pose::new(x, 1.0, 0.1)) < 1e-12
                    && (pose.heading - 0.1).abs() < 1e-12,
                "{pose:?}"
            );
        }
    }
}
