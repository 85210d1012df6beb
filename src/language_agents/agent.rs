//! An agent that answers once in a planning call, in a chat: its observation, its prompts and
//! grammars, and the way from its answer to a trajectory.

use crate::chat::Chat;
use crate::memory::MemoryError;
use planagent_agent::environment::{GraphedScene, LaneGraph};
use planagent_agent::planner::{AgentKeys, AgentSettings, PlannerError, PlannerInput, Unreadable};
use planagent_agent::reasoning::{
    ParseError, PlannerAnswer, PromptError, QuestionPrompts, ReasoningError,
};
use planagent_world::{SceneView, Trajectory};
use std::sync::Arc;

/// An agent that is asked in a chat. [`LanguagePlanner`](crate::planner::LanguagePlanner) makes it a
/// planner.
pub(crate) trait ChatAgent: Send {
    /// What the model reads about the scene, and what else its answer is read with.
    type Observation<'a>;
    /// What the model answers.
    type Answer: Copy + Into<PlannerAnswer> + Send + 'static;
    /// What becomes active when an answer is carried out.
    type Plan;

    /// Time between planning calls, seconds.
    fn interval_s(&self) -> f64;

    /// Whether Reflection scores its plans.
    fn reflects(&self) -> bool;

    /// Forgets the simulation so far.
    fn reset(&mut self);

    /// Looks at the scene of a planning call.
    fn observe<'a>(&mut self, seen: GraphedScene<'a>) -> Self::Observation<'a>;

    /// The observation in words, for records.
    fn scene_text(observation: &Self::Observation<'_>) -> String;

    /// Asks the model by the agent's prompts, under its grammars, and reads the answer.
    ///
    /// # Errors
    /// When the model cannot be asked at all. A wrong answer is no such error.
    fn ask(
        &self,
        observation: &Self::Observation<'_>,
        chat: &mut Chat<'_>,
    ) -> Result<Reply<Self::Answer>, ReasoningError>;

    /// The plan of an answer, and its trajectory from now on.
    ///
    /// # Errors
    /// When the plan has no finite states.
    fn plan(
        &self,
        answer: Self::Answer,
        observation: &Self::Observation<'_>,
        seen: GraphedScene<'_>,
    ) -> Result<(Self::Plan, Trajectory), PlannerError>;

    /// Makes a plan the active one.
    fn adopt(&mut self, plan: Self::Plan);

    /// Goes on with the active plan after a planning call that gave none. Off the road there is no
    /// lane graph.
    ///
    /// # Errors
    /// When the plan has no finite states.
    fn go_on(
        &mut self,
        scene: &SceneView<'_>,
        graph: Option<&LaneGraph>,
    ) -> Result<(), PlannerError>;

    /// The trajectory of the active plan; `None` before the first.
    ///
    /// # Errors
    /// When the plan has no finite states.
    fn trajectory(&mut self, input: &PlannerInput<'_>) -> Result<Option<Trajectory>, PlannerError>;
}

/// An agent by its prompts and what is set of its settings.
type Make<A> = fn(AgentSettings, Arc<QuestionPrompts>) -> Result<A, MemoryError>;

/// What an agent is made of.
pub(crate) struct Parts<A: ChatAgent> {
    /// Its name as a planner, and its settings.
    pub(crate) keys: AgentKeys,
    pub(crate) prompts: fn() -> Result<QuestionPrompts, PromptError>,
    pub(crate) make: Make<A>,
}

impl<A: ChatAgent> Clone for Parts<A> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<A: ChatAgent> Copy for Parts<A> {}

/// An answer as it was read.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Reply<A> {
    /// What was read.
    pub(crate) answer: Option<A>,
    /// What is wrong with it.
    pub(crate) errors: Vec<ParseError>,
    /// Why it is no plan; `None` where it is one.
    pub(crate) unreadable: Option<Unreadable>,
}

impl<A> Reply<A> {
    /// An answer that is a plan.
    pub(crate) fn plan(answer: A) -> Self {
        Self {
            answer: Some(answer),
            errors: Vec::new(),
            unreadable: None,
        }
    }

    /// A text that is no plan.
    pub(crate) fn wrong(error: ParseError, unreadable: Unreadable) -> Self {
        Self {
            answer: None,
            errors: vec![error],
            unreadable: Some(unreadable),
        }
    }

    /// Nothing was answered.
    pub(crate) fn none() -> Self {
        Self {
            answer: None,
            errors: Vec::new(),
            unreadable: Some(Unreadable::NoAttempt),
        }
    }
}

/// Most characters of a wrong text that a message shows.
const SHOWN: usize = 40;

/// The beginning of a text, for a message about it.
pub(crate) fn beginning(text: &str) -> String {
    text.chars().take(SHOWN).collect()
}

/// The same error with the question whose answer it is in: its place counts there.
pub(crate) fn in_answer(question: &str, mut error: ParseError) -> ParseError {
    error.message = format!("{question}: {}", error.message);
    error
}
