//! The facts of a scene in GPT-Driver's prompt (Mao et al. 2023), from a nuPlan planner's input.
//!
//! Its user message has four parts: every object with its place now and in 3 s; the motion of the
//! ego in six lines, per half second; the ego's places in the last two seconds; the mission goal. x
//! points to the right, y ahead, from the ego's center. An object is left out when it is farther
//! than 20 m sideways or along now or at any half second of the next three, or behind the ego now
//! and at all of them. Upstream takes the forecast from a perception model; here objects keep their
//! velocity.

use super::{decimal, place};
use crate::environment::lane_graph::Turn;
use planagent_world::geometry::{Point, Pose};
use planagent_world::{SceneView, TrackedObject};
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

/// GPT-Driver's description of a scene.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GptDriverText {
    /// A line an object.
    pub objects: String,
    /// Motion of the ego, its past, its goal.
    pub ego: String,
}

impl GptDriverText {
    /// Describes a scene whose route goes this way at the next intersection.
    pub fn from_scene(scene: &SceneView<'_>, turn: Turn) -> Self {
        Self {
            objects: objects(scene),
            ego: ego(scene, turn),
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

fn objects(scene: &SceneView<'_>) -> String {
    let ego = scene.ego.center();
    let mut text = "Objects, seen and expected:".to_owned();
    for object in scene.objects {
        let places: Vec<(f64, f64)> = (0..=FORECAST_STEPS)
            .map(|step| seen(&ego, place_after(object, step)))
            .collect();
        let near = places
            .iter()
            .all(|(x, y)| x.abs() <= REACH && y.abs() <= REACH);
        let ahead = places.iter().any(|&(_, y)| y > 0.0);
        if let (true, true, [now, .., later]) = (near, ahead, places.as_slice()) {
            let class = object.kind;
            let _ = write!(
                text,
                "\n- {class} at {}, moving to {}.",
                place(now.0, now.1),
                place(later.0, later.1)
            );
        }
    }
    text
}

/// Where the center of an object is after a number of half seconds.
fn place_after(object: &TrackedObject, step: usize) -> Point {
    object.shape.center.position() + object.velocity * (step as f64 * HALF_SECOND)
}

fn ego(scene: &SceneView<'_>, turn: Turn) -> String {
    let (ego, center) = (scene.ego, scene.ego.center());
    let per_step = |sideways: f64, along: f64| place(sideways * HALF_SECOND, along * HALF_SECOND);
    let past = |step: usize| {
        scene
            .history
            .samples()
            .rev()
            .nth(step * SAMPLES)
            .map(|sample| sample.ego.center())
    };
    let moved = |step: usize| {
        let (from, to) = (past(step + 1)?, past(step)?);
        let (from, to) = (seen(&center, from.position()), seen(&center, to.position()));
        Some((to.0 - from.0, to.1 - from.1))
    };
    let change = moved(0).zip(moved(1)).map_or((0.0, 0.0), |(last, before)| {
        (last.0 - before.0, last.1 - before.1)
    });
    let places = (1..=PAST_STEPS).rev().map(|step| match past(step) {
        Some(pose) => {
            let (x, y) = seen(&center, pose.position());
            place(x, y)
        }
        None => "(unknown)".to_owned(),
    });
    let goal = match turn {
        Turn::Left => "LEFT",
        Turn::Right => "RIGHT",
        Turn::Straight => "FORWARD",
    };
    [
        "State of the ego vehicle:".to_owned(),
        format!(
            "- Velocity (vx,vy): {}",
            per_step(-ego.velocity.y, ego.velocity.x)
        ),
        format!("- Yaw rate (w): ({})", decimal(ego.angular_velocity)),
        format!("- Acceleration (ax,ay): {}", place(change.0, change.1)),
        format!(
            "- Vehicle bus (ax,ay): {}",
            place(-ego.acceleration.y, ego.acceleration.x)
        ),
        format!(
            "- Speed along the heading (v): ({})",
            decimal(ego.speed() * HALF_SECOND)
        ),
        format!("- Steering (s): ({})", decimal(ego.steering_angle)),
        format!(
            "Places in the last two seconds: [{}]",
            places.collect::<Vec<_>>().join(", ")
        ),
        format!("Goal: {goal}"),
    ]
    .join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::environment::sketch;
    use planagent_world::ObjectKind;

    #[test]
    fn objects_ahead_within_twenty_meters_are_told_with_their_place_in_three_seconds() {
        let drawn = sketch::straight(3, 0, 1, 9.0)
            .put(ObjectKind::Vehicle, 8.0, 3.5, 0.0, 2.0)
            .put(ObjectKind::Vehicle, 12.0, 0.0, 0.0, 5.0)
            .put(ObjectKind::Vehicle, -9.0, 0.0, 0.0, 1.0)
            .put(ObjectKind::TrafficCone, 19.0, -3.5, 0.0, 0.0);
        let text = GptDriverText::from_scene(&drawn.scene(), Turn::Left);
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
            text.ego.contains("(vx,vy): (0.00,4.50)") && text.ego.ends_with("Goal: LEFT"),
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
}
