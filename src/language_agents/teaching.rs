//! Conversations that teach: what an agent asks a model at a state, and the answer of a search, in the
//! form of this agent.

use crate::agent::{ChatAgent, Parts};
use planagent_agent::environment::{GraphedScene, LaneGraph};
use planagent_agent::planner::AgentSettings;
use planagent_agent::reasoning::{PromptError, QuestionPrompts};
use planagent_agent::simulation::ClosedLoop;
use planagent_controls::search::Candidate;
use std::sync::Arc;

/// An agent whose answers a search can give.
pub(crate) trait Taught: ChatAgent {
    /// What the model is asked.
    ///
    /// # Errors
    /// When a prompt cannot be rendered.
    fn question(&self, observation: &Self::Observation<'_>) -> Result<QuestionTexts, PromptError>;

    /// The best answer at the present of a simulation whose best planner code is this one; `None`
    /// where there is none.
    fn best(&self, simulation: &ClosedLoop<'_>, code: &Candidate) -> Option<Self::Answer>;

    /// An answer in words, with what leads to it.
    fn words(
        &self,
        answer: Self::Answer,
        observation: &Self::Observation<'_>,
        seen: GraphedScene<'_>,
    ) -> String;
}

/// The texts of a question to a model.
pub(crate) struct QuestionTexts {
    pub(crate) system: String,
    pub(crate) prompt: String,
}

/// A question with its answer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TaughtAnswer {
    /// The system prompt.
    pub system: String,
    /// The question, word for word that of the agent.
    pub prompt: String,
    /// The answer in the form that the agent reads.
    pub answer: String,
}

/// A state whose best planner code is known.
#[derive(Clone, Copy)]
pub struct SearchedState<'a> {
    /// The simulation at this state.
    pub simulation: &'a ClosedLoop<'a>,
    /// The lane graph of its scene.
    pub graph: &'a LaneGraph,
    /// The best code.
    pub best: &'a Candidate,
}

type Teach = dyn Fn(SearchedState<'_>) -> Result<Option<TaughtAnswer>, PromptError> + Send + Sync;

/// Writes the conversations of one agent.
pub struct Teacher {
    name: &'static str,
    teach: Box<Teach>,
}

/// How an agent's answers are taught.
pub(crate) struct Teaching {
    /// The agent's name as a planner.
    pub(crate) name: &'static str,
    /// Its teacher.
    ///
    /// # Errors
    /// When the agent's prompts cannot be read.
    pub(crate) open: Box<dyn Fn() -> Result<Teacher, PromptError>>,
}

impl Teaching {
    /// That of an agent.
    pub(crate) fn from_parts<A: Taught + 'static>(parts: Parts<A>) -> Self {
        Self {
            name: parts.keys.planner,
            open: Box::new(move || Teacher::from_parts(parts)),
        }
    }
}

impl Teacher {
    fn from_parts<A: Taught + 'static>(parts: Parts<A>) -> Result<Self, PromptError> {
        let prompts = Arc::new((parts.prompts)()?);
        Ok(Self {
            name: parts.keys.planner,
            teach: Box::new(move |state| taught(parts, &prompts, state)),
        })
    }

    /// The agent's name as a planner.
    pub fn name(&self) -> &'static str {
        self.name
    }

    /// The conversation of a state; `None` where the search finds no answer of the agent's form.
    ///
    /// # Errors
    /// When a prompt cannot be rendered.
    pub fn teach(&self, state: SearchedState<'_>) -> Result<Option<TaughtAnswer>, PromptError> {
        (self.teach)(state)
    }
}

/// The agent is one that has driven nothing and remembers nothing, so that a state is taught by
/// itself, whatever was before it.
fn taught<A: Taught>(
    parts: Parts<A>,
    prompts: &Arc<QuestionPrompts>,
    SearchedState {
        simulation,
        graph,
        best,
    }: SearchedState<'_>,
) -> Result<Option<TaughtAnswer>, PromptError> {
    let mut agent = (parts.make)(AgentSettings::default(), Arc::clone(prompts))
        .expect("default settings name no memory that could fail to open");
    let scene = simulation.scene();
    let seen = GraphedScene::new(&scene, graph);
    let observation = agent.observe(seen);
    let Some(answer) = agent.best(simulation, best) else {
        return Ok(None);
    };
    let QuestionTexts { system, prompt } = agent.question(&observation)?;
    Ok(Some(TaughtAnswer {
        system,
        prompt,
        answer: agent.words(answer, &observation, seen),
    }))
}
