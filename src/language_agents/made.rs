//! What an agent's folder makes of its parts: planners by name, and what else the crate needs to know.

use crate::agent::{ChatAgent, Parts};
use crate::described::DescribedText;
use crate::fill::MemoryFiller;
use crate::memory::digest;
use crate::oracle;
use crate::planner::{LanguagePlanner, Source};
use crate::teaching::Teaching;
use planagent_agent::planner::{
    AskedModel, CodeSource, Latency, PlanAgentSettings, Planner, PlannerError, PlannerName,
};
use planagent_agent::planner_registry::{PlannerEntry, PlannerNeeds, PlannerParts};
use planagent_agent::reasoning::ReasoningError;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Tokens of a chat with the prompts of these agents at least; scenes with many objects need more.
const MIN_CONTEXT: usize = 2_048;

/// All that the crate needs to know of an agent.
pub(crate) struct Agent {
    /// The planner that asks a model.
    pub(crate) planner: PlannerEntry,
    /// The same with a search in the model's place.
    pub(crate) oracle: PlannerEntry,
    /// What its model reads about a scene.
    pub(crate) texts: &'static [DescribedText],
    /// How its answers are taught, where a search gives them.
    pub(crate) teaching: Option<Teaching>,
    /// How its memory is filled, where it has one.
    pub(crate) filler: Option<MemoryFiller>,
}

/// The agent with its prompts.
fn made<A: ChatAgent>(parts: Parts<A>, settings: &PlanAgentSettings) -> Result<A, PlannerError> {
    let prompts = (parts.prompts)().map_err(ReasoningError::from)?;
    let set = settings.language_agents.agent(parts.keys.planner);
    (parts.make)(set, Arc::new(prompts)).map_err(|error| PlannerError::Failed {
        doing: "opening the memory",
        source: Box::new(error),
    })
}

/// A planner that asks the configured model by prompts of its own.
pub(crate) fn asking<A: ChatAgent + 'static>(
    summary: &'static str,
    agent_parts: Parts<A>,
) -> PlannerEntry {
    let build = move |parts: &PlannerParts<'_>| -> Result<Box<dyn Planner>, PlannerError> {
        let source = Source::Model(asked_model(parts)?);
        let agent = made(agent_parts, parts.settings)?;
        let settings = parts.settings.clone();
        Ok(Box::new(LanguagePlanner::new(
            parts.name, agent, source, settings,
        )))
    };
    PlannerEntry::new(
        PlannerName::new(agent_parts.keys.planner),
        summary,
        PlannerNeeds::Model,
        build,
    )
    .refusing(|settings| (settings.agent.latency != Latency::None).then_some("agent.latency"))
    .needing_context(MIN_CONTEXT)
    .with_keys(agent_parts.keys)
    .prepared_by(move |settings| made(agent_parts, settings).map(|_| ()))
    .reading(move |settings| read_texts(agent_parts, settings))
}

/// The same agent with a search in its model's place. It reads neither prompts nor a memory.
pub(crate) fn handed<A: ChatAgent + 'static>(
    name: &'static str,
    summary: &'static str,
    agent_parts: Parts<A>,
    find: oracle::Find<A>,
) -> PlannerEntry {
    let without_memory = move |settings: &PlanAgentSettings| {
        let mut settings = settings.clone();
        settings.language_agents = settings.language_agents.without_memories();
        made(agent_parts, &settings)
    };
    oracle::entry(name, summary, without_memory, find)
}

/// BLAKE3 of prompts and memory, by name. What cannot be read is left out: preparing says why.
fn read_texts<A: ChatAgent>(
    agent_parts: Parts<A>,
    settings: &PlanAgentSettings,
) -> BTreeMap<String, String> {
    let mut digests = (agent_parts.prompts)()
        .map_or_else(|_| BTreeMap::new(), |prompts| prompts.digests().clone());
    let memory = settings
        .language_agents
        .agent(agent_parts.keys.planner)
        .memory;
    digests.extend(memory.and_then(|file| digest(&file).map(|digest| (file, digest))));
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
