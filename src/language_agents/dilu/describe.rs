//! Lanes, cars, lights and route in words.

use super::control::SetPoints;
use planagent_agent::environment::GraphedScene;
use planagent_world::geometry::{Point, Polyline, wrap_angle};
use planagent_world::{LaneId, LanePath, SceneView, SignalStatus, TrackedObject};
use std::f64::consts::FRAC_PI_2;
use std::fmt::Write;

/// Objects farther along the lane are left out, meters.
const REACH: f64 = 200.0;
/// An object this far from a lane's centerline is in the lane, meters.
const HALF_LANE: f64 = 1.9;
/// Lanes to a side that are counted.
const MAX_LANES: i32 = 8;
/// Samples of the history over which the acceleration of an object is taken.
const SAMPLES: usize = 5;
/// Time between two samples, seconds.
const SAMPLE_S: f64 = 0.1;

/// A lane with the word for where it is.
struct Named {
    name: &'static str,
    path: LanePath,
    ego_s: f64,
}

/// The description of a scene.
pub(super) fn description(seen: GraphedScene<'_>, set: SetPoints) -> String {
    let GraphedScene { scene, graph } = seen;
    let ego_lane = graph.ego_lane();
    let lane = ego_lane.path.lane_at(ego_lane.ego_s);
    let mut text = lanes_in_words(scene, lane);
    let ego = scene.ego;
    let limit = ego_lane
        .speed_limit
        .map_or_else(String::new, |limit| format!(", speed limit {limit:.2} m/s"));
    // Writing to a string cannot fail.
    let _ = write!(
        text,
        "\nYour car: speed {:.2} m/s, acceleration {:.2} m/s2, lane position 0.00 m{limit}. Set speed {:.2} m/s, set lane {}.",
        ego.speed(),
        ego.acceleration.x,
        set.speed(),
        side_of(scene, lane, set.lane)
    );
    if let Some(light) = ego_lane.light {
        let _ = write!(
            text,
            "\nThe next traffic light is {}; its stop line is {:.2} m ahead of your bumper.",
            light_word(light.status),
            light.distance
        );
    }
    let _ = write!(text, "\nYour route goes {} next", ego_lane.turn);
    if let Some(goal) = graph.goal.filter(|goal| goal.changes != 0) {
        let side = if goal.changes > 0 { "left" } else { "right" };
        let _ = write!(
            text,
            ", and needs {} lane changes to the {side} within {:.0} m",
            goal.changes.abs(),
            goal.distance
        );
    }
    text.push('.');
    let around = around(scene, lane);
    if around.is_empty() {
        text.push_str("\nNothing else is near.");
    } else {
        text.push_str("\nOthers, with lane positions from your car's:");
        for line in &around {
            text.push_str(line);
        }
    }
    text
}

/// How many lanes there are, and which is the ego's.
fn lanes_in_words(scene: &SceneView<'_>, lane: LaneId) -> String {
    if scene.map[lane].is_connector() {
        return "You are on a connection through a junction.".to_owned();
    }
    let to_side =
        |side: i32| (1..=MAX_LANES).take_while(move |&n| beside(scene, lane, side * n).is_some());
    let (left, right) = (to_side(1).count(), to_side(-1).count());
    format!(
        "The road has {} lanes your way; you are in lane {} from the left.",
        left + right + 1,
        left + 1
    )
}

/// The lane beside another that goes the same way, positive to the left.
fn beside(scene: &SceneView<'_>, lane: LaneId, lanes: i32) -> Option<LaneId> {
    let ego = scene.ego.center().position();
    let (found, pose) = scene.map.beside(lane, ego, lanes)?;
    let own = scene.map[lane].centerline.project(ego).heading;
    (wrap_angle(pose.heading - own).abs() < FRAC_PI_2).then_some(found)
}

fn side_of(scene: &SceneView<'_>, lane: LaneId, other: LaneId) -> &'static str {
    if beside(scene, lane, 1) == Some(other) {
        "left of yours"
    } else if beside(scene, lane, -1) == Some(other) {
        "right of yours"
    } else {
        "yours"
    }
}

fn light_word(status: SignalStatus) -> &'static str {
    match status {
        SignalStatus::Green => "green",
        SignalStatus::Yellow => "yellow",
        SignalStatus::Red => "red",
        SignalStatus::Unknown => "unknown",
    }
}

/// The nearest object ahead and behind on the ego's lane and the lanes beside.
fn around(scene: &SceneView<'_>, lane: LaneId) -> Vec<String> {
    let named = |name: &'static str, lane: LaneId| {
        let (map, ego) = (scene.map, scene.ego.center().position());
        let on_lane = map[lane].centerline.project(ego).s;
        let path = LanePath::along(map, scene.route, lane, on_lane + REACH);
        Named {
            name,
            ego_s: path.centerline.project(ego).s,
            path,
        }
    };
    let mut lanes = vec![named("your lane", lane)];
    lanes.extend(beside(scene, lane, 1).map(|left| named("the lane to your left", left)));
    lanes.extend(beside(scene, lane, -1).map(|right| named("the lane to your right", right)));
    let mut lines = Vec::new();
    // Lane by lane: an object on the line between two lanes matters to both and is named on both.
    for lane in &lanes {
        let (mut ahead, mut behind): (Option<(f64, &TrackedObject)>, _) = (None, None);
        for object in scene.objects {
            let Some(gap) = gap(&lane.path.centerline, lane.ego_s, object) else {
                continue;
            };
            let nearest: &mut Option<(f64, &TrackedObject)> =
                if gap >= 0.0 { &mut ahead } else { &mut behind };
            if nearest.is_none_or(|(other, _)| gap.abs() < other.abs()) {
                *nearest = Some((gap, object));
            }
        }
        let found = [("ahead", ahead), ("behind", behind)];
        lines.extend(found.into_iter().filter_map(|(side, found)| {
            let (gap, object) = found?;
            Some(line(scene, object, lane.name, side, gap))
        }));
    }
    lines
}

/// Meters from the ego to an object along a lane; `None` for one that is not in it.
fn gap(line: &Polyline, ego_s: f64, object: &TrackedObject) -> Option<f64> {
    let place: Point = object.shape.center.position();
    let on = line.project(place);
    let gap = on.s - ego_s;
    let is_at_end = on.s <= 0.0 || on.s >= line.length();
    (on.distance <= HALF_LANE && gap.abs() <= REACH && !is_at_end).then_some(gap)
}

fn line(scene: &SceneView<'_>, object: &TrackedObject, lane: &str, side: &str, gap: f64) -> String {
    let seen = scene.ego.center().to_local(object.shape.center.position());
    let before = scene
        .history
        .samples()
        .rev()
        .nth(SAMPLES)
        .and_then(|sample| {
            sample
                .objects
                .iter()
                .find(|then| then.token == object.token)
        });
    let acceleration = before.map_or(0.0, |then| {
        (object.speed() - then.speed()) / (SAMPLES as f64 * SAMPLE_S)
    });
    format!(
        "\n- {} {} in {lane}, {side}: at ({:.2},{:.2}), speed {:.2} m/s, acceleration {acceleration:.2} m/s2, lane position {gap:.2} m.",
        object.kind,
        object.token,
        seen.x,
        -seen.y,
        object.speed()
    )
}
