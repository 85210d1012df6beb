//! A description of a scene for LLM-ASSIST's planners (Sharan et al. 2024).
//!
//! Neither its prompts nor its code are public. The paper says that the scene is text in
//! coordinates within the reach of PDM-Closed. The choice of facts is ours: the ego's motion and
//! limit, the centerlines of its lane and the lanes beside, the next light, and the nearest agents
//! and objects with place, heading, speed and size.

use super::{decimal, seen_from};
use crate::environment::lane_graph::{Centerline, LaneGraph};
use planagent_world::SceneView;
use std::fmt::Write;

/// Farther objects are left out, meters: PDM-Closed's reach.
const REACH: f64 = 50.0;
/// Objects that are listed, the nearest first: a choice of ours, as the paper names no number.
const MAX_OBJECTS: usize = 10;
/// Points of a centerline in the text.
const POINTS: usize = 5;
/// Spacing of these points, meters.
const SPACING: f64 = 10.0;

/// The scene in coordinates from the ego's center: x ahead, y to the left.
pub fn llm_assist_text(scene: &SceneView<'_>, graph: &LaneGraph) -> String {
    let (ego, center) = (scene.ego, scene.ego.center());
    let limit = graph.ego_lane().speed_limit.map_or_else(
        || "unknown".to_owned(),
        |limit| format!("{} m/s", decimal(limit)),
    );
    let mut text = format!(
        "Ego: speed {} m/s, acceleration {} m/s2, yaw rate {} rad/s, speed limit {limit}.",
        decimal(ego.speed()),
        decimal(ego.acceleration.x),
        decimal(ego.angular_velocity)
    );
    for centerline in &graph.centerlines {
        let points: Vec<String> = points(centerline)
            .map(|point| seen_from(&center, point))
            .collect();
        let _ = write!(text, "\n{}: {}", centerline.name, points.join(" "));
        if let Some(light) = centerline.light {
            let _ = write!(
                text,
                ", light {} in {} m",
                light.status,
                decimal(light.distance)
            );
        }
    }
    text.push_str("\nObjects:");
    let mut near: Vec<_> = scene
        .objects
        .iter()
        .map(|o| (o.shape.center.distance(&center), o))
        .collect();
    near.retain(|(distance, _)| *distance <= REACH);
    // The nearest first, since the list ends where the prompt would grow too long.
    near.sort_by(|a, b| a.0.total_cmp(&b.0));
    for (_, object) in near.into_iter().take(MAX_OBJECTS) {
        let shape = &object.shape;
        let _ = write!(
            text,
            "\n- {} at {}, heading {}, speed {} m/s, {} x {} m",
            object.kind,
            seen_from(&center, shape.center.position()),
            decimal(planagent_world::geometry::wrap_angle(
                shape.center.heading - center.heading
            )),
            decimal(object.speed()),
            decimal(shape.length),
            decimal(shape.width)
        );
    }
    text
}

/// Points of a centerline ahead of the ego, as far as it goes.
fn points(centerline: &Centerline) -> impl Iterator<Item = planagent_world::geometry::Point> + '_ {
    let line = &centerline.path.centerline;
    let ahead = (1..=POINTS).map(|i| centerline.ego_s + i as f64 * SPACING);
    ahead
        .take_while(|&s| s <= line.length())
        .map(|s| line.point_at(s))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::environment::lane_graph::DEFAULT_NODE_LENGTH;
    use crate::environment::sketch;
    use planagent_world::ObjectKind;

    #[test]
    fn lanes_and_the_nearest_objects_are_told_in_coordinates() {
        let mut drawn = sketch::straight(2, 0, 1, 9.0);
        for i in 0..12 {
            drawn = drawn.put(
                ObjectKind::Vehicle,
                10.0 + 3.0 * f64::from(i),
                3.5,
                0.0,
                2.0,
            );
        }
        let scene = drawn.scene();
        let graph = LaneGraph::build(&scene, DEFAULT_NODE_LENGTH).unwrap();
        let text = llm_assist_text(&scene, &graph);
        assert!(text.starts_with("Ego: speed 9.00 m/s,"), "{text}");
        assert!(
            text.contains("\nego_lane: (10.00,0.00) (20.00,0.00)"),
            "{text}"
        );
        assert!(text.contains("\nleft_lane: (10.00,3.50)"), "{text}");
        assert_eq!(text.matches("\n- vehicle at").count(), MAX_OBJECTS);
    }
}
