//! The readable text for general models.

use super::description::{
    AgentDescription, Description, GoalDescription, LightDescription, NodeDescription,
    OncomingDescription,
};
use crate::environment::lane_graph::{CenterlineName, Heading, NodePlace};

pub(super) fn write(description: &Description) -> String {
    let limit = match (description.limit, description.limit_estimate) {
        (Some(limit), _) => format!("limit {limit} m/s"),
        (None, Some(estimate)) => format!("limit unknown, about {estimate} m/s"),
        (None, None) => "limit unknown".to_owned(),
    };
    let light = description
        .light(CenterlineName::EgoLane)
        .map_or_else(|| "light none".to_owned(), light_words);
    let rest = if description.rest > 0 {
        format!(", {} more", description.rest)
    } else {
        String::new()
    };
    let ego = format!(
        "Ego: {} m/s, {limit}, route {}, {light}{rest}.{}",
        description.speed,
        description.turn,
        goal(description)
    );
    let lanes = CenterlineName::ALL
        .iter()
        .filter_map(|&centerline| lane(description, centerline));
    std::iter::once(ego)
        .chain(lanes)
        .collect::<Vec<_>>()
        .join("\n")
}

/// ` Goal: 1 lane to the left, in 180 m.`, or nothing.
fn goal(description: &Description) -> String {
    let Some(GoalDescription { changes, distance }) = description.goal else {
        return String::new();
    };
    let lanes = match changes.unsigned_abs() {
        0 => "this lane".to_owned(),
        1 => format!("1 lane to the {}", side(changes)),
        lanes => format!("{lanes} lanes to the {}", side(changes)),
    };
    format!(" Goal: {lanes}, in {distance} m.")
}

fn side(changes: i8) -> &'static str {
    if changes > 0 { "left" } else { "right" }
}

fn oncoming(
    OncomingDescription {
        blocked: (from, to),
        next,
    }: OncomingDescription,
) -> String {
    let next = next.map_or_else(
        || "free".to_owned(),
        |(gap, speed)| format!("next vehicle {gap} m {speed} m/s"),
    );
    format!(
        "{}: past {from} m to {to} m; {next}.",
        CenterlineName::OncomingLane
    )
}

fn lane(description: &Description, centerline: CenterlineName) -> Option<String> {
    let Some(places) = NodePlace::on(centerline) else {
        return description.oncoming.map(oncoming);
    };
    if places
        .iter()
        .all(|&place| description.node(place).is_none())
    {
        return Some(format!("{centerline}: none."));
    }
    let beside = centerline != CenterlineName::EgoLane;
    let light = description
        .light(centerline)
        .filter(|_| beside)
        .map(light_words);
    let nodes = places.map(|place| format!("{place} {}", node(description.node(place))));
    Some(format!(
        "{centerline}: {}.",
        light
            .into_iter()
            .chain(nodes)
            .collect::<Vec<_>>()
            .join("; ")
    ))
}

fn light_words(light: LightDescription) -> String {
    format!("light {} in {} m", light.status, light.distance)
}

fn node(node: Option<&NodeDescription>) -> String {
    let Some(node) = node else {
        return "none".to_owned();
    };
    let apart = if node.apart { "(apart) " } else { "" };
    if node.agents.is_empty() {
        return format!("{apart}free");
    }
    let agents: Vec<String> = node.agents.iter().copied().map(agent).collect();
    format!("{apart}{}", agents.join(", "))
}

fn agent(agent: AgentDescription) -> String {
    let moves = match agent.heading {
        Heading::Along => String::new(),
        Heading::Crossing | Heading::Oncoming => format!(" {}", agent.heading),
    };
    format!(
        "{} {} m {} m/s{moves}",
        agent.name, agent.distance, agent.speed
    )
}
