//! The planners by name.

use crate::agent::LanguageAgent;
use crate::agent_driver::{self, AgentDriver};
use crate::dilu::{self, Dilu};
use crate::gpt_driver::{self, GptDriver};
use crate::memory::{self, MemoryError, digest};
use crate::oracle;
use crate::planner::{LanguagePlanner, Source};
use planagent_agent::planner::{
    AskedModel, CodeSource, Latency, PlanAgentSettings, Planner, PlannerError, PlannerName,
};
use planagent_agent::planner_registry::{PlannerEntry, PlannerNeeds, PlannerParts};
use planagent_agent::reasoning::{PromptError, QuestionPrompts, ReasoningError};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Tokens of a chat with the prompts of these agents at least; scenes with many objects need more.
const MIN_CONTEXT: usize = 2_048;

/// An agent by its prompts and settings.
type Make<A> = fn(&PlanAgentSettings, Arc<QuestionPrompts>) -> Result<A, PlannerError>;

/// What an agent is made of.
struct Parts<A: LanguageAgent> {
    prompts: fn() -> Result<QuestionPrompts, PromptError>,
    /// The file of its memory.
    memory: fn(&PlanAgentSettings) -> Option<&str>,
    make: Make<A>,
}

impl<A: LanguageAgent> Clone for Parts<A> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<A: LanguageAgent> Copy for Parts<A> {}

const GPT_DRIVER: Parts<GptDriver> = Parts {
    prompts: gpt_driver::prompts,
    memory: |_| None,
    make: |settings, prompts| {
        let settings = settings.language_agents.gpt_driver.clone();
        Ok(GptDriver::new(settings, prompts))
    },
};

const DILU: Parts<Dilu> = Parts {
    prompts: dilu::prompts,
    memory: |settings| settings.language_agents.dilu.memory.as_deref(),
    make: |settings, prompts| {
        let settings = settings.language_agents.dilu.clone();
        let memory = memory::open(settings.memory.as_deref(), dilu::NAME);
        Ok(Dilu::new(settings, prompts, &memory.map_err(unusable)?))
    },
};

const AGENT_DRIVER: Parts<AgentDriver> = Parts {
    prompts: agent_driver::prompts,
    memory: |settings| settings.language_agents.agent_driver.memory.as_deref(),
    make: |settings, prompts| {
        let settings = settings.language_agents.agent_driver.clone();
        let memory = memory::open(settings.memory.as_deref(), agent_driver::NAME);
        Ok(AgentDriver::new(
            settings,
            prompts,
            memory.map_err(unusable)?,
        ))
    },
};

/// The planners of this crate: the agents, and each with an oracle in its model's place.
pub fn entries() -> impl Iterator<Item = PlannerEntry> {
    // One list, a row a planner: an oracle is its agent with a search in the model's place.
    [
        asking(
            gpt_driver::NAME,
            "GPT-Driver; the model gives waypoints",
            GPT_DRIVER,
        ),
        asking(
            dilu::NAME,
            "DiLu; the model gives an action, with remembered decisions",
            DILU,
        ),
        asking(
            agent_driver::NAME,
            "Agent-Driver; the model calls tools and gives waypoints",
            AGENT_DRIVER,
        ),
        handed(
            "oracle-gpt-driver",
            "GPT-Driver with waypoints of codes tried out ahead (a control)",
            GPT_DRIVER,
            oracle::best_waypoints,
        ),
        handed(
            "oracle-dilu",
            "DiLu with actions tried out ahead (a control)",
            DILU,
            oracle::best_action,
        ),
        handed(
            "oracle-agent-driver",
            "Agent-Driver with waypoints of codes tried out ahead (a control)",
            AGENT_DRIVER,
            oracle::best_waypoints,
        ),
    ]
    .into_iter()
}

/// The agent with its prompts.
fn made<A: LanguageAgent>(
    parts: Parts<A>,
    settings: &PlanAgentSettings,
) -> Result<A, PlannerError> {
    let prompts = (parts.prompts)().map_err(ReasoningError::from)?;
    (parts.make)(settings, Arc::new(prompts))
}

/// A planner that asks the configured model by prompts of its own.
fn asking<A: LanguageAgent + 'static>(
    name: &'static str,
    summary: &'static str,
    of: Parts<A>,
) -> PlannerEntry {
    let build = move |parts: &PlannerParts<'_>| -> Result<Box<dyn Planner>, PlannerError> {
        let source = Source::Model(asked_model(parts)?);
        let agent = made(of, parts.settings)?;
        let settings = parts.settings.clone();
        Ok(Box::new(LanguagePlanner::new(
            parts.name, agent, source, settings,
        )))
    };
    PlannerEntry::new(PlannerName::new(name), summary, PlannerNeeds::Model, build)
        .refusing(|settings| (settings.agent.latency != Latency::None).then_some("agent.latency"))
        .needing_context(MIN_CONTEXT)
        .prepared_by(move |settings| made(of, settings).map(|_| ()))
        .reading(move |settings| read_texts(of, settings))
}

/// The same agent with a search in its model's place. It reads neither prompts nor a memory.
fn handed<A: LanguageAgent + 'static>(
    name: &'static str,
    summary: &'static str,
    of: Parts<A>,
    find: oracle::Find<A>,
) -> PlannerEntry {
    let without_memory = move |settings: &PlanAgentSettings| {
        let mut settings = settings.clone();
        let agents = &mut settings.language_agents;
        (agents.dilu.memory, agents.agent_driver.memory) = (None, None);
        made(of, &settings)
    };
    oracle::entry(name, summary, without_memory, find)
}

/// BLAKE3 of prompts and memory, by name. What cannot be read is left out: preparing says why.
fn read_texts<A: LanguageAgent>(
    of: Parts<A>,
    settings: &PlanAgentSettings,
) -> BTreeMap<String, String> {
    let mut digests =
        (of.prompts)().map_or_else(|_| BTreeMap::new(), |prompts| prompts.digests().clone());
    let memory = (of.memory)(settings);
    digests.extend(memory.and_then(|file| Some((file.to_owned(), digest(file)?))));
    digests
}

fn unusable(error: MemoryError) -> PlannerError {
    PlannerError::Failed {
        doing: "opening the memory",
        source: Box::new(error),
    }
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
