//! The planners by name.

use crate::agent::{ChatAgent, Parts};
use crate::memory::digest;
use crate::planner::{LanguagePlanner, Source};
use crate::{agent_driver, dilu, gpt_driver, oracle};
use planagent_agent::planner::{
    AskedModel, CodeSource, Latency, PlanAgentSettings, Planner, PlannerError, PlannerName,
};
use planagent_agent::planner_registry::{PlannerEntry, PlannerNeeds, PlannerParts};
use planagent_agent::reasoning::ReasoningError;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Tokens of a chat with the prompts of these agents at least; scenes with many objects need more.
const MIN_CONTEXT: usize = 2_048;

/// The planners of this crate: the agents, and each with an oracle in its model's place.
pub fn entries() -> impl Iterator<Item = PlannerEntry> {
    // One list, a row a planner: an oracle is its agent with a search in the model's place.
    [
        asking("GPT-Driver; the model gives waypoints", gpt_driver::PARTS),
        asking(
            "DiLu; the model gives an action, with remembered decisions",
            dilu::PARTS,
        ),
        asking(
            "Agent-Driver; the model calls tools and gives waypoints",
            agent_driver::PARTS,
        ),
        handed(
            "oracle-gpt-driver",
            "GPT-Driver with waypoints of codes tried out ahead (a control)",
            gpt_driver::PARTS,
            oracle::best_waypoints,
        ),
        handed(
            "oracle-dilu",
            "DiLu with actions tried out ahead (a control)",
            dilu::PARTS,
            oracle::best_action,
        ),
        handed(
            "oracle-agent-driver",
            "Agent-Driver with waypoints of codes tried out ahead (a control)",
            agent_driver::PARTS,
            oracle::best_waypoints,
        ),
    ]
    .into_iter()
}

/// The agent with its prompts.
fn made<A: ChatAgent>(parts: Parts<A>, settings: &PlanAgentSettings) -> Result<A, PlannerError> {
    let prompts = (parts.prompts)().map_err(ReasoningError::from)?;
    (parts.make)(&settings.language_agents, Arc::new(prompts)).map_err(|error| {
        PlannerError::Failed {
            doing: "opening the memory",
            source: Box::new(error),
        }
    })
}

/// A planner that asks the configured model by prompts of its own.
fn asking<A: ChatAgent + 'static>(summary: &'static str, of: Parts<A>) -> PlannerEntry {
    let build = move |parts: &PlannerParts<'_>| -> Result<Box<dyn Planner>, PlannerError> {
        let source = Source::Model(asked_model(parts)?);
        let agent = made(of, parts.settings)?;
        let settings = parts.settings.clone();
        Ok(Box::new(LanguagePlanner::new(
            parts.name, agent, source, settings,
        )))
    };
    PlannerEntry::new(
        PlannerName::new(of.name),
        summary,
        PlannerNeeds::Model,
        build,
    )
    .refusing(|settings| (settings.agent.latency != Latency::None).then_some("agent.latency"))
    .needing_context(MIN_CONTEXT)
    .prepared_by(move |settings| made(of, settings).map(|_| ()))
    .reading(move |settings| read_texts(of, settings))
}

/// The same agent with a search in its model's place. It reads neither prompts nor a memory.
fn handed<A: ChatAgent + 'static>(
    name: &'static str,
    summary: &'static str,
    of: Parts<A>,
    find: oracle::Find<A>,
) -> PlannerEntry {
    let without_memory = move |settings: &PlanAgentSettings| {
        let mut settings = settings.clone();
        settings.language_agents = settings.language_agents.without_memories();
        made(of, &settings)
    };
    oracle::entry(name, summary, without_memory, find)
}

/// BLAKE3 of prompts and memory, by name. What cannot be read is left out: preparing says why.
fn read_texts<A: ChatAgent>(
    of: Parts<A>,
    settings: &PlanAgentSettings,
) -> BTreeMap<String, String> {
    let mut digests =
        (of.prompts)().map_or_else(|_| BTreeMap::new(), |prompts| prompts.digests().clone());
    let memory = (of.memory)(&settings.language_agents);
    digests.extend(memory.and_then(|file| Some((file.to_owned(), digest(file)?))));
    digests
}

fn asked_model(parts: &PlannerParts<'_>) -> Result<AskedModel, PlannerError> {
    match parts.model.cloned() {
        Some(CodeSource::Model {
            model,
            prompts,
            reasoning,
        }) => Ok(AskedModel {
            model,
            prompts,
            reasoning,
        }),
        _ => Err(PlannerError::MissingPart {
            planner: parts.name,
            part: "a language model",
        }),
    }
}
