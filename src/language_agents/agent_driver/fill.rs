//! Experiences of logged drives.

use super::item::ExperienceItem;
use crate::fill::item;
use planagent_agent::environment::coordinates::EgoFacts;
use planagent_agent::environment::{DEFAULT_NODE_LENGTH, LaneGraph};
use planagent_agent::reasoning::LISTED_WAYPOINTS;
use planagent_world::{EgoState, SceneView};
use serde_json::Value;

/// Of a log, a state every half second is an experience.
pub(super) const EVERY: usize = 5;
/// Length of an experience, frames.
pub(super) const FUTURE: usize = LISTED_WAYPOINTS * EVERY;

/// The experience at one instant of a log, as JSON.
pub(super) fn left_item(
    scenario: &str,
    scene: &SceneView<'_>,
    future: &[EgoState],
) -> Option<Value> {
    item(experience(scenario, scene, future)?)
}

/// The experience at one instant of a log: the ego's motion, and where it went. `future` has the
/// ego's states from the next one on, 0.1 s apart. `None` without a lane graph, or where the log
/// ends before the last waypoint.
fn experience(
    scenario: &str,
    scene: &SceneView<'_>,
    future: &[EgoState],
) -> Option<ExperienceItem> {
    let graph = LaneGraph::build(scene, DEFAULT_NODE_LENGTH).ok()?;
    let facts = EgoFacts::from_scene(scene, &graph);
    let center = scene.ego.center();
    let place = |waypoint: usize| {
        let state = future.get((waypoint + 1) * EVERY - 1)?;
        let local = center.to_local(state.center().position());
        Some([-local.y, local.x])
    };
    let places: Option<Vec<[f64; 2]>> = (0..LISTED_WAYPOINTS).map(place).collect();
    let past: Option<Vec<[f64; 2]>> = facts
        .past
        .iter()
        .map(|place| place.map(|(right, ahead)| [right, ahead]))
        .collect();
    Some(ExperienceItem {
        text: facts.text(),
        motion: facts.motion,
        goal: facts.goal.to_owned(),
        past: past?.try_into().ok()?,
        future: places?.try_into().ok()?,
        source: scenario.to_owned(),
    })
}
