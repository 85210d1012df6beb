//! The agents of this crate.

use crate::described::DescribedText;
use crate::fill::MemoryFiller;
use crate::made::Agent;
use crate::teaching::Teacher;
use crate::{agent_driver, dilu, gpt_driver};
use planagent_agent::planner_registry::PlannerEntry;
use planagent_agent::reasoning::PromptError;

/// The agents. A new one is its folder and a line here.
fn agents() -> [Agent; 3] {
    [gpt_driver::agent(), dilu::agent(), agent_driver::agent()]
}

/// The planners of this crate: the agents, and each with an oracle in its model's place.
pub fn entries() -> impl Iterator<Item = PlannerEntry> {
    let (planners, oracles): (Vec<_>, Vec<_>) = agents()
        .into_iter()
        .map(|agent| (agent.planner, agent.oracle))
        .unzip();
    planners.into_iter().chain(oracles)
}

/// What the models of the agents read about a scene.
pub fn described_texts() -> impl Iterator<Item = &'static DescribedText> {
    agents().into_iter().flat_map(|agent| agent.texts)
}

/// How memories are filled, of each agent that has one.
pub fn fillers() -> impl Iterator<Item = MemoryFiller> {
    agents().into_iter().filter_map(|agent| agent.filler)
}

/// Names of the agents whose answers a search can give.
pub fn taught_agents() -> impl Iterator<Item = &'static str> {
    let teachings = agents().into_iter().filter_map(|agent| agent.teaching);
    teachings.map(|teaching| teaching.name)
}

/// The teacher of an agent; `None` for another name.
///
/// # Errors
/// When the agent's prompts cannot be read.
pub fn teacher(name: &str) -> Result<Option<Teacher>, PromptError> {
    let mut teachings = agents().into_iter().filter_map(|agent| agent.teaching);
    let found = teachings.find(|teaching| teaching.name == name);
    found.map(|teaching| (teaching.open)()).transpose()
}
