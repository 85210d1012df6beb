//! The facts of a scene in GPT-Driver's prompt (Mao et al. 2023), from a nuPlan planner's input.
//!
//! Its user message has four parts: every object with its place now and in 3 s; the motion of the
//! ego in six lines, per half second; the ego's places in the last two seconds; the mission goal. x
//! points to the right, y ahead, from the ego's center. An object is left out when it is farther
//! than 20 m sideways or along now or at any half second of the next three, or behind the ego now
//! and at all of them. Upstream takes the forecast from a perception model; here objects keep their
//! velocity.
//!
//! Units are upstream's, which differ from line to line. Velocity and speed are per half second,
//! the change of motion is per half second squared, the yaw rate is per second. The pair of the
//! vehicle bus is in m/s² with the forward component first, unlike every other pair. Steering is
//! twice the angle of the steering wheel over the wheelbase of its car. Angles are positive to the
//! left; of steering, sources disagree on the sign.
//!
//! The goal is upstream's label of a logged future: whether the ego is more than 2 m to a side
//! after 3 s. Here it is read off the route, at the ego's speed.

use super::{decimal, place};
use crate::environment::lane_graph::LaneGraph;
use planagent_world::geometry::{Point, Pose};
use planagent_world::{EgoState, SceneView, TrackedObject};
use std::fmt::Write;

/// Farther objects are left out, meters along either axis.
const REACH: f64 = 20.0;
/// Half seconds of the forecast.
const FORECAST_STEPS: usize = 6;
/// Length of one of them, seconds.
const HALF_SECOND: f64 = 0.5;
/// Samples of the history in half a second.
const SAMPLES: usize = 5;
/// Half seconds of the past in the text.
const PAST_STEPS: usize = 4;
/// Wheelbase of upstream's car, meters.
const UPSTREAM_WHEELBASE: f64 = 2.588;
/// Angle of the steering wheel over that of the front wheels, which our states have: typical of
/// passenger cars.
const STEERING_RATIO: f64 = 16.0;
/// A place on the route within this distance to a side is ahead, meters.
const GOAL_SIDE: f64 = 2.0;
/// How far ahead the goal is looked for, seconds.
const GOAL_SECONDS: f64 = 3.0;

/// GPT-Driver's description of a scene.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GptDriverText {
    /// A line an object.
    pub objects: String,
    /// Motion of the ego, its past, its goal.
    pub ego: String,
}

impl GptDriverText {
    /// Describes a scene with its lane graph.
    pub fn from_scene(scene: &SceneView<'_>, graph: &LaneGraph) -> Self {
        Self {
            objects: objects(scene),
            ego: EgoFacts::from_scene(scene, graph).text(),
        }
    }

    /// Both parts: the whole user message.
    pub fn whole(&self) -> String {
        format!("{}\n{}", self.objects, self.ego)
    }
}

/// A point as seen from the ego: meters to the right, meters ahead.
fn seen(from: &Pose, point: Point) -> (f64, f64) {
    let local = from.to_local(point);
    (-local.y, local.x)
}

/// The objects in the text, with the places of each now and after every half second: meters to the
/// right, meters ahead.
pub fn seen_objects<'a>(
    scene: &SceneView<'a>,
) -> impl Iterator<Item = (&'a TrackedObject, [(f64, f64); FORECAST_STEPS + 1])> {
    let ego = scene.ego.center();
    scene.objects.iter().filter_map(move |object| {
        let places: [(f64, f64); FORECAST_STEPS + 1] =
            std::array::from_fn(|step| seen(&ego, place_after(object, step)));
        let near = places
            .iter()
            .all(|(x, y)| x.abs() <= REACH && y.abs() <= REACH);
        let ahead = places.iter().any(|&(_, y)| y > 0.0);
        (near && ahead).then_some((object, places))
    })
}

fn objects(scene: &SceneView<'_>) -> String {
    let mut text = "Objects, seen and expected:".to_owned();
    for (object, places) in seen_objects(scene) {
        let [now, .., later] = places;
        let class = object.kind;
        let _ = write!(
            text,
            "\n- {class} at {}, moving to {}.",
            place(now.0, now.1),
            place(later.0, later.1)
        );
    }
    text
}

/// Where the center of an object is after a number of half seconds.
fn place_after(object: &TrackedObject, step: usize) -> Point {
    object.shape.center.position() + object.velocity * (step as f64 * HALF_SECOND)
}

/// Where the route leads within three seconds.
fn goal(scene: &SceneView<'_>, graph: &LaneGraph) -> &'static str {
    let lane = graph.ego_lane();
    let s = lane.ego_s + scene.ego.speed() * GOAL_SECONDS;
    let (right, _) = seen(&scene.ego.center(), lane.path.centerline.point_at(s));
    match right {
        right if right > GOAL_SIDE => "RIGHT",
        right if right < -GOAL_SIDE => "LEFT",
        _ => "FORWARD",
    }
}

/// Motion, past and goal of the ego in upstream's units; x is to the right, y ahead.
#[derive(Debug, Clone, PartialEq)]
pub struct EgoFacts {
    /// Velocity (two), yaw rate, acceleration (two), vehicle bus (two), speed, steering.
    pub motion: [f64; 9],
    /// The places in the last two seconds, the oldest first; `None` before the first sample.
    pub past: [Option<(f64, f64)>; PAST_STEPS],
    /// LEFT, RIGHT or FORWARD.
    pub goal: &'static str,
}

impl EgoFacts {
    /// Those of a scene with its lane graph.
    pub fn from_scene(scene: &SceneView<'_>, graph: &LaneGraph) -> Self {
        Self::with_goal(scene, goal(scene, graph))
    }

    fn with_goal(scene: &SceneView<'_>, goal: &'static str) -> Self {
        let (ego, center) = (scene.ego, scene.ego.center());
        let past = |step: usize| {
            let samples = scene.history.samples().rev();
            let pose = samples
                .skip(step * SAMPLES)
                .map(|sample| sample.ego.center())
                .next()?;
            Some(seen(&center, pose.position()))
        };
        let moved = |step: usize| {
            let (from, to) = (past(step + 1)?, past(step)?);
            Some((to.0 - from.0, to.1 - from.1))
        };
        // Per half second squared, as in the original; zero where the past is too short.
        let change = moved(0).zip(moved(1)).map_or((0.0, 0.0), |(last, before)| {
            (last.0 - before.0, last.1 - before.1)
        });
        Self {
            motion: [
                -ego.velocity.y * HALF_SECOND,
                ego.velocity.x * HALF_SECOND,
                ego.angular_velocity,
                change.0,
                change.1,
                ego.acceleration.x,
                -ego.acceleration.y,
                ego.speed() * HALF_SECOND,
                steering(ego),
            ],
            past: std::array::from_fn(|i| past(PAST_STEPS - i)),
            goal,
        }
    }

    /// The facts in words, a line each.
    pub fn text(&self) -> String {
        let [vx, vy, yaw_rate, ax, ay, forward, right, speed, steering] = self.motion;
        let past = self
            .past
            .map(|step| step.map_or_else(|| "(unknown)".to_owned(), |(x, y)| place(x, y)));
        [
            "State of the ego vehicle:".to_owned(),
            format!("- Velocity (vx,vy): {}", place(vx, vy)),
            format!("- Yaw rate (w): ({})", decimal(yaw_rate)),
            format!("- Acceleration (ax,ay): {}", place(ax, ay)),
            format!("- Vehicle bus (forward,right): {}", place(forward, right)),
            format!("- Speed along the heading (v): ({})", decimal(speed)),
            format!("- Steering (s): ({})", decimal(steering)),
            format!("Places in the last two seconds: [{}]", past.join(", ")),
            format!("Goal: {}", self.goal),
        ]
        .join("\n")
    }
}

/// Upstream's measure of steering.
fn steering(ego: &EgoState) -> f64 {
    2.0 * STEERING_RATIO * ego.steering_angle / UPSTREAM_WHEELBASE
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::environment::lane_graph::DEFAULT_NODE_LENGTH;
    use crate::environment::sketch;
    use planagent_world::ObjectKind;
    use planagent_world::geometry::Vector;

    #[test]
    fn objects_ahead_within_twenty_meters_are_told_with_their_place_in_three_seconds() {
        let drawn = sketch::straight(3, 0, 1, 9.0)
            .put(ObjectKind::Vehicle, 8.0, 3.5, 0.0, 2.0)
            .put(ObjectKind::Vehicle, 12.0, 0.0, 0.0, 5.0)
            .put(ObjectKind::Vehicle, -9.0, 0.0, 0.0, 1.0)
            .put(ObjectKind::TrafficCone, 19.0, -3.5, 0.0, 0.0);
        let scene = drawn.scene();
        let graph = LaneGraph::build(&scene, DEFAULT_NODE_LENGTH).unwrap();
        let text = GptDriverText::from_scene(&scene, &graph);
        let lines: Vec<&str> = text.objects.lines().collect();
        assert_eq!(
            lines.len(),
            3,
            "the second leaves the window, the third stays behind: {lines:?}"
        );
        assert_eq!(
            lines[1],
            "- vehicle at (-3.50,8.00), moving to (-3.50,14.00)."
        );
        assert_eq!(
            lines[2],
            "- traffic_cone at (3.50,19.00), moving to (3.50,19.00)."
        );
        assert!(
            text.ego.contains("(vx,vy): (0.00,4.50)") && text.ego.ends_with("Goal: FORWARD"),
            "{}",
            text.ego
        );
        assert!(
            text.ego
                .contains("[(unknown), (unknown), (unknown), (unknown)]"),
            "{}",
            text.ego
        );
    }

    #[test]
    fn the_bus_tells_the_forward_component_first_and_steering_is_that_of_the_wheel() {
        let mut drawn = sketch::straight(3, 0, 1, 9.0);
        drawn.ego.acceleration = Vector::new(1.5, -0.25);
        drawn.ego.steering_angle = 0.1;
        drawn.ego.angular_velocity = 0.2;
        let text = EgoFacts::with_goal(&drawn.scene(), "LEFT").text();
        for line in [
            "- Vehicle bus (forward,right): (1.50,0.25)",
            "- Yaw rate (w): (0.20)",
            "- Speed along the heading (v): (4.50)",
            "- Steering (s): (1.24)",
            "Goal: LEFT",
        ] {
            assert!(text.lines().any(|found| found == line), "{line}: {text}");
        }
    }

    #[test]
    fn the_goal_is_where_the_route_leads_within_three_seconds() {
        for (left, right, expected) in [
            (0.0, 0.0, "FORWARD"),
            (3.5, 0.0, "LEFT"),
            (0.0, 3.5, "RIGHT"),
        ] {
            let mut drawn = sketch::straight(3, 0, 1, 9.0);
            let graph = LaneGraph::build(&drawn.scene(), DEFAULT_NODE_LENGTH).unwrap();
            // Beside its lane, the ego sees the lane to its other side.
            drawn.ego.rear_axle = drawn.ego.rear_axle.translated(0.0, right - left);
            assert_eq!(goal(&drawn.scene(), &graph), expected);
        }
    }
}
