//! The text for a small model: the same words at the same places for every scene.

use super::description::{Description, GoalDescription, NodeDescription, OncomingDescription};
use crate::environment::lane_graph::{Heading, NodePlace};

/// Stands where there is nothing to say.
const NOTHING: &str = "-";
/// First word of a text.
pub(super) const SPEED: &str = "speed";

/// Before the way over the oncoming lane.
const ONCOMING: &str = "oncoming";
/// Before the way to the goal's lane.
const GOAL: &str = "goal";
/// Before a limit that the map does not know.
const ABOUT: &str = "~";

pub(super) fn write(description: &Description) -> String {
    write_reduced(&description.reduced())
}

/// The same with `~11` for a limit that is unknown and may be 11 m/s.
pub(super) fn write_with_estimate(description: &Description) -> String {
    write_reduced(&description.reduced_with_estimate())
}

fn write_reduced(reduced: &Description) -> String {
    let limit = match (reduced.limit, reduced.limit_estimate) {
        (Some(limit), _) => limit.to_string(),
        (None, Some(estimate)) => format!("{ABOUT}{estimate}"),
        (None, None) => NOTHING.to_owned(),
    };
    let light = reduced.lights[0].map_or_else(
        || format!("none {NOTHING}"),
        |light| format!("{} {}", light.status, light.distance),
    );
    let nodes = NodePlace::ALL
        .iter()
        .map(|&place| format!("{place} {}", node(reduced.node(place))));
    let oncoming = reduced.oncoming.map(
        |OncomingDescription {
             blocked: (from, to),
             next,
         }| {
            let next = next.map_or_else(
                || format!("{NOTHING} {NOTHING}"),
                |(gap, speed)| format!("{gap} {speed}"),
            );
            // One line whose words never move: a small model learns places more easily than
            // sentences.
            format!(" {ONCOMING} {from} {to} {next}")
        },
    );
    let goal = reduced.goal.map(|GoalDescription { changes, distance }| {
        let side = match changes {
            1.. => NodePlace::Left,
            0 => NodePlace::Ego,
            _ => NodePlace::Right,
        };
        format!(" {GOAL} {side} {} {distance}", changes.unsigned_abs())
    });
    format!(
        "{SPEED} {} limit {limit} light {light} turn {} {} rest {}{}{}",
        reduced.speed,
        reduced.turn,
        nodes.collect::<Vec<_>>().join(" "),
        reduced.rest,
        oncoming.unwrap_or_default(),
        goal.unwrap_or_default()
    )
}

fn node(node: Option<&NodeDescription>) -> String {
    let Some(node) = node else {
        return format!("none {NOTHING} {NOTHING}");
    };
    let Some(agent) = node.agents.first() else {
        return format!("free {NOTHING} {NOTHING}");
    };
    match agent.heading {
        Heading::Along => format!("{} {} {}", agent.name, agent.distance, agent.speed),
        Heading::Crossing | Heading::Oncoming => {
            format!("{} {} {}", agent.name, agent.distance, agent.heading)
        }
    }
}
