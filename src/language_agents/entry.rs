//! The planners by name.

use crate::agent::LanguageAgent;
use crate::gpt_driver::{self, GptDriver};
use crate::oracle;
use crate::planner::{LanguagePlanner, Source};
use planagent_agent::planner::{
    AskedModel, CodeSource, Latency, PlanAgentSettings, Planner, PlannerError, PlannerName,
};
use planagent_agent::planner_registry::{PlannerEntry, PlannerNeeds, PlannerParts};
use planagent_agent::reasoning::{PromptError, QuestionPrompts, ReasoningError};
use std::collections::BTreeMap;
use std::sync::Arc;

/// The planners of this crate.
pub fn entries() -> impl Iterator<Item = PlannerEntry> {
    [
        asking(
            gpt_driver::NAME,
            "GPT-Driver; the model gives waypoints",
            gpt_driver::prompts,
            gpt_driver,
        ),
        oracle::entry(
            "oracle-gpt-driver",
            "GPT-Driver with waypoints of codes tried out ahead (a control)",
            |settings| {
                let prompts = gpt_driver::prompts().map_err(ReasoningError::from)?;
                Ok(gpt_driver(settings, Arc::new(prompts)))
            },
            oracle::best_waypoints,
        ),
    ]
    .into_iter()
}

fn gpt_driver(settings: &PlanAgentSettings, prompts: Arc<QuestionPrompts>) -> GptDriver {
    GptDriver::new(settings.language_agents.gpt_driver.clone(), prompts)
}

/// A planner that asks the configured model by prompts of its own.
fn asking<A: LanguageAgent + 'static>(
    name: &'static str,
    summary: &'static str,
    prompts: fn() -> Result<QuestionPrompts, PromptError>,
    agent: fn(&PlanAgentSettings, Arc<QuestionPrompts>) -> A,
) -> PlannerEntry {
    let name = PlannerName::new(name);
    let build = move |parts: &PlannerParts<'_>| -> Result<Box<dyn Planner>, PlannerError> {
        let source = Source::Model(asked_model(parts)?);
        let prompts = Arc::new(prompts().map_err(ReasoningError::from)?);
        let agent = agent(parts.settings, prompts);
        let settings = parts.settings.clone();
        Ok(Box::new(LanguagePlanner::new(
            parts.name, agent, source, settings,
        )))
    };
    PlannerEntry::new(name, summary, PlannerNeeds::Model, build)
        .refusing(|settings| (settings.agent.latency != Latency::None).then_some("agent.latency"))
        .prepared_by(move |_| {
            prompts().map_err(ReasoningError::from)?;
            Ok(())
        })
        .reading(move |_| {
            prompts().map_or_else(|_| BTreeMap::new(), |prompts| prompts.digests().clone())
        })
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
