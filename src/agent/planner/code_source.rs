//! Where the agent's planner codes come from: a vision-language model, a person, or a list without a
//! model.

use super::language_agent::CallTerms;
use crate::environment::LaneGraph;
use crate::reasoning::{
    AnswerHistory, Feedback, Names, Parsed, PlannerCode, PromptSet, Reasoning, ReasoningError,
    ReasoningSettings, ReasoningTrace, ScenarioPrompt, parse,
};
use planagent_mllm::{Mllm, MllmError};
use std::sync::Arc;

/// The source of an agent's planner codes.
#[derive(Clone)]
#[non_exhaustive]
pub enum CodeSource {
    /// A vision-language model that reasons in rounds.
    #[allow(missing_docs)]
    Model {
        model: Arc<dyn Mllm>,
        prompts: Arc<PromptSet>,
        reasoning: ReasoningSettings,
    },
    /// One line that a person wrote, in one attempt.
    Written(String),
    /// Codes without a model, as controls give them.
    Listed(Arc<dyn CodeList>),
}

/// Lists the planner codes of a planning call without a model.
pub trait CodeList: Send + Sync {
    /// The codes in order, one for each attempt.
    fn codes(&self, call: &CodeCall<'_>) -> Vec<PlannerCode>;

    /// Whether all codes are tried out and the best one is taken, the earlier of equals. Otherwise
    /// the first one that Reflection accepts is taken.
    fn compares(&self) -> bool {
        false
    }
}

/// The planning call that a list of codes is for.
#[derive(Debug, Clone, Copy)]
pub struct CodeCall<'a> {
    /// The lane graph of the scene.
    pub graph: &'a LaneGraph,
    /// What a code may name in the scene.
    pub names: &'a Names,
    /// Seed of the call.
    pub seed: u64,
    /// Maximum number of attempts of an agent that does not compare.
    pub attempts: usize,
}

impl CodeSource {
    /// Asks the model what planning calls will ask, and gives remarks on what is odd in its answers.
    /// `bev` says whether the calls show a picture. Only a server is asked, at most twice, and never
    /// again once it answered; another source gives no remarks. `on_wait` hears why it takes long.
    ///
    /// # Errors
    /// When the server cannot be asked.
    pub fn probe(&self, bev: bool, on_wait: &dyn Fn(&str)) -> Result<Vec<String>, MllmError> {
        let Self::Model {
            model, reasoning, ..
        } = self
        else {
            return Ok(Vec::new());
        };
        let question = reasoning.generation.probe(bev, reasoning.grammar);
        model.probe(&question, on_wait)
    }

    /// The name of the model; `None` for a source without one.
    pub fn model_name(&self) -> Option<&str> {
        match self {
            Self::Model { model, .. } => Some(model.name()),
            _ => None,
        }
    }

    /// Side of the image that the model takes, pixels; `None` if it takes none.
    pub(super) fn image_size(&self) -> Option<u32> {
        let Self::Model { model, .. } = self else {
            return None;
        };
        model.describe().image_size
    }

    /// The prompts of a model.
    pub(super) fn prompts(&self) -> Option<&PromptSet> {
        let Self::Model { prompts, .. } = self else {
            return None;
        };
        Some(prompts)
    }

    /// Whether all of its codes are tried out and the best one is taken.
    pub(super) fn compares(&self) -> bool {
        matches!(self, Self::Listed(list) if list.compares())
    }

    /// Whether its codes may name the oncoming lane: unless the settings forbid it, and where a
    /// model's prompts have it. A planner without a model is compared with models that may.
    pub(super) fn names_oncoming_lane(&self, setting: Option<bool>) -> bool {
        setting != Some(false)
            && self
                .prompts()
                .is_none_or(|prompts| prompts.forms().scene_text.names_oncoming_lane())
    }

    /// Begins a planning call of at most this many attempts, unless all codes are compared.
    /// `history` has the answers of the simulation so far.
    pub(super) fn open<'a>(
        &'a self,
        scenario: &'a ScenarioPrompt,
        graph: &LaneGraph,
        CallTerms { seed, deadline }: CallTerms,
        attempts: usize,
        history: &'a mut AnswerHistory,
    ) -> Result<Codes<'a>, ReasoningError> {
        // One match: an arm is a source. Only a model needs the prompt, the deadline and the
        // history.
        Ok(match self {
            Self::Model {
                model,
                prompts,
                reasoning,
            } => {
                let reasoning = Reasoning::open(
                    model.as_ref(),
                    prompts,
                    reasoning,
                    scenario,
                    seed,
                    deadline,
                    history,
                )?;
                Codes::Reasoned(Box::new(reasoning))
            }
            Self::Written(line) => Codes::Written(Some(parse(line, &scenario.names))),
            Self::Listed(list) => {
                let call = CodeCall {
                    graph,
                    names: &scenario.names,
                    seed,
                    attempts,
                };
                Codes::Listed(list.codes(&call).into_iter())
            }
        })
    }
}

/// The codes of one planning call, one for each attempt.
pub(super) enum Codes<'a> {
    Reasoned(Box<Reasoning<'a>>),
    Listed(std::vec::IntoIter<PlannerCode>),
    Written(Option<Parsed<PlannerCode>>),
}

impl Codes<'_> {
    /// The next one; `None` when there are no more.
    pub(super) fn next(
        &mut self,
        feedback: Option<&Feedback>,
    ) -> Result<Option<ReasoningTrace<PlannerCode>>, ReasoningError> {
        match self {
            Self::Reasoned(reasoning) => reasoning.think(feedback).map(Some),
            Self::Listed(codes) => Ok(codes.next().map(ReasoningTrace::without_rounds)),
            Self::Written(parsed) => Ok(parsed.take().map(ReasoningTrace::of_parsed)),
        }
    }
}
