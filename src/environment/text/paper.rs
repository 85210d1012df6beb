//! The readable text for general models.

use super::description::{AgentDescription, Description, LightDescription, NodeDescription};
use crate::environment::lane_graph::{CenterlineName, Heading, NodePlace};

pub(super) fn write(description: &Description) -> String {
    let limit = match (description.limit, description.limit_estimate) {
        (Some(limit), _) => format!("limit {limit} m/s"),
        (None, Some(estimate)) => format!("limit unknown, about {estimate} m/s"),
        (None, None) => "limit unknown".to_owned(),
    };
    let light = description.light(CenterlineName::EgoLane).map_or_else(|| "light none".to_owned(), light_words);
    let rest = if description.rest > 0 { format!(", {} more", description.rest) } else { String::new() };
    let ego = format!("Ego: {} m/s, {limit}, route {}, {light}{rest}.", description.speed, description.turn);
    let lanes = CenterlineName::ALL.iter().map(|&centerline| lane(description, centerline));
    std::iter::once(ego).chain(lanes).collect::<Vec<_>>().join("\n")
}

fn lane(description: &Description, centerline: CenterlineName) -> String {
    let places = NodePlace::on(centerline);
    if places.iter().all(|&place| description.node(place).is_none()) {
        return format!("{centerline}: none.");
    }
    let beside = centerline != CenterlineName::EgoLane;
    let light = description.light(centerline).filter(|_| beside).map(light_words);
    let nodes = places.map(|place| format!("{place} {}", node(description.node(place))));
    format!("{centerline}: {}.", light.into_iter().chain(nodes).collect::<Vec<_>>().join("; "))
}

fn light_words(light: LightDescription) -> String {
    format!("light {} in {} m", light.status, light.distance)
}

fn node(node: Option<&NodeDescription>) -> String {
    let Some(node) = node else { return "none".to_owned() };
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
    format!("{} {} m {} m/s{moves}", agent.name, agent.distance, agent.speed)
}
