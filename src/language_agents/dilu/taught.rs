//! The answer of DiLu's teacher: what of the scene decides, and the action that a search chose.

use super::item::DELIMITER;
use super::oracle;
use super::{Dilu, Observation};
use crate::teaching::{QuestionTexts, Taught};
use planagent_agent::environment::{CenterlineName, GraphedScene};
use planagent_agent::reasoning::{DrivingAction, PromptError};
use planagent_agent::simulation::ClosedLoop;
use planagent_controls::search::Candidate;
use planagent_world::SignalStatus;

/// Farther lights are not named, meters: at 15 m/s a car stops within half of it.
const LIGHT: f64 = 60.0;

impl Taught for Dilu {
    fn question(&self, observation: &Observation) -> Result<QuestionTexts, PromptError> {
        self.question_texts(observation, None)
    }

    fn best(&self, simulation: &ClosedLoop<'_>, _: &Candidate) -> Option<DrivingAction> {
        oracle::best_action(simulation, self)
    }

    fn words(&self, action: DrivingAction, _: &Observation, seen: GraphedScene<'_>) -> String {
        format!(
            "{} {}\n{DELIMITER} {}",
            facts(seen),
            decision(action),
            action.id()
        )
    }
}

/// What may decide: the goal's lane, the light, what is ahead.
fn facts(GraphedScene { graph, .. }: GraphedScene<'_>) -> String {
    let mut facts = Vec::new();
    if let Some(goal) = graph.goal.filter(|goal| goal.changes != 0) {
        let side = if goal.changes > 0 { "left" } else { "right" };
        facts.push(format!("My route leads to the lane on the {side}."));
    }
    let light = graph.ego_lane().light;
    let near = light.filter(|light| light.distance < LIGHT);
    facts.extend(near.and_then(|light| match light.status {
        SignalStatus::Red => Some("The light ahead is red.".to_owned()),
        SignalStatus::Yellow => Some("The light ahead is yellow.".to_owned()),
        SignalStatus::Green | SignalStatus::Unknown => None,
    }));
    facts.push(match graph.lead_agent(CenterlineName::EgoLane) {
        Some(lead) => format!("There is a {} ahead in my lane.", lead.name.class.as_str()),
        None => "My lane is free.".to_owned(),
    });
    facts.join(" ")
}

fn decision(action: DrivingAction) -> &'static str {
    match action {
        DrivingAction::Left => "So I aim for the lane to the left.",
        DrivingAction::Idle => "So I keep lane and speed.",
        DrivingAction::Right => "So I aim for the lane to the right.",
        DrivingAction::Faster => "So I raise the speed.",
        DrivingAction::Slower => "So I lower the speed.",
    }
}
