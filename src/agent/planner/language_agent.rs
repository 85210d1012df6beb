//! What a language agent is: an observation, a prompt set, a grammar for its answer, and a way to turn
//! the answer into a trajectory. A planning call and its record are the same for all agents.

use super::attempts::Attempts;
use super::record::{Decision, NoPlan, PlanningCall};
use super::{PlanAgentSettings, PlannerError, PlannerInput};
use crate::environment::{GraphedScene, LaneGraph, LaneGraphError};
use crate::reasoning::PromptForms;
use image::RgbImage;
use planagent_mllm::{Deadline, image_hash, milliseconds};
use planagent_world::SceneView;
use std::sync::Arc;
use std::time::Instant;

/// A language agent. Its observation is a part of its own. Prompts and grammar are behind
/// [`Question::ask`](super::Question::ask), and the way from an answer to a trajectory is behind
/// [`Question::try_out`](super::Question::try_out).
pub trait LanguageAgent {
    /// What the model reads about a scene, and what its answers are read and tried out with.
    type Observation<'a>;
    /// What becomes active when an answer is carried out.
    type Plan;

    /// Its settings.
    fn settings(&self) -> &PlanAgentSettings;

    /// The lane graph that it observes a scene by.
    ///
    /// # Errors
    /// When the scene has none.
    fn lane_graph(&self, scene: &SceneView<'_>) -> Result<LaneGraph, LaneGraphError> {
        LaneGraph::build(scene, self.settings().environment.node_length_m)
    }

    /// Looks at the scene of a planning call.
    ///
    /// # Errors
    /// When what the model is to see cannot be made.
    fn observe<'a>(
        &mut self,
        seen: GraphedScene<'a>,
    ) -> Result<Self::Observation<'a>, PlannerError>;

    /// The observation in the form of a record.
    fn shown(&self, observation: &Self::Observation<'_>) -> Shown;

    /// Asks a [`Question`](super::Question), and tries the answers out.
    ///
    /// # Errors
    /// When the model cannot be asked at all. A wrong answer is no such error.
    fn attempts(
        &mut self,
        observation: &Self::Observation<'_>,
        seen: GraphedScene<'_>,
        terms: CallTerms,
    ) -> Result<Attempts<Self::Plan>, PlannerError>;

    /// What comes of the attempts.
    fn decide(&self, attempts: &Attempts<Self::Plan>) -> Decision {
        let refused = attempts.refused(self.settings().reflection.after_max_exec);
        match (attempts.accepted(), &attempts.interruption, refused) {
            (Some(index), ..) => Decision::Execute(index),
            (None, Some(why), _) => self.without_plan(NoPlan::Interrupted(why.clone())),
            (None, None, Some(index)) => Decision::Exhausted(index),
            (None, None, None) => self.without_plan(NoPlan::Unreadable(attempts.unreadable())),
        }
    }

    /// The decision of a call that gave no plan.
    fn without_plan(&self, why: NoPlan) -> Decision;

    /// The last word on the plan that is carried out.
    ///
    /// # Errors
    /// When another plan that takes its place cannot be made.
    fn settle(
        &mut self,
        plan: Self::Plan,
        _call: &mut PlanningCall,
        _seen: GraphedScene<'_>,
    ) -> Result<Self::Plan, PlannerError> {
        Ok(plan)
    }

    /// Goes on with the active plan after a call that gave none. Off the road there is no lane graph.
    ///
    /// # Errors
    /// When that plan has no finite states.
    fn go_on(
        &mut self,
        _scene: &SceneView<'_>,
        _graph: Option<&LaneGraph>,
    ) -> Result<(), PlannerError> {
        Ok(())
    }
}

/// An observation in the form of a record.
#[derive(Debug, Clone, Default)]
pub struct Shown {
    /// The picture, if the model takes one.
    pub image: Option<Arc<RgbImage>>,
    /// The scene in words.
    pub text: Option<String>,
    /// The forms of words and answers, where the prompt set has several.
    #[doc(hidden)]
    pub forms: Option<PromptForms>,
}

/// What the questions of a planning call have to keep to.
#[derive(Debug, Clone, Copy)]
pub struct CallTerms {
    /// Seed of what is drawn.
    pub seed: u64,
    /// When the call must end.
    pub deadline: Deadline,
}

impl CallTerms {
    fn new(settings: &PlanAgentSettings, iteration: usize, started: Instant) -> Self {
        let limit = settings.deadline();
        Self {
            seed: settings.call_seed(iteration),
            deadline: limit.map_or(Deadline::NONE, |limit| Deadline::after(started, limit)),
        }
    }
}

/// A planning call of an agent: its record, and the plan that becomes active. `at_s` is the time
/// after the first step, seconds; `started` is the wall time at which the call began.
///
/// # Errors
/// When the call cannot be made. A wrong answer is no such error.
pub fn planning_call<A: LanguageAgent>(
    agent: &mut A,
    input: &PlannerInput<'_>,
    at_s: f64,
    started: Instant,
) -> Result<(PlanningCall, Option<A::Plan>), PlannerError> {
    // The steps of a call stand in one function, because the record has what each came to.
    let total_ms = || milliseconds(started.elapsed());
    let scene = &input.scene;
    let begun =
        |decision| PlanningCall::without_attempts(input.iteration, at_s, decision, total_ms());
    let graph = match agent.lane_graph(scene) {
        Ok(graph) => graph,
        Err(error) => {
            let decision = agent.without_plan(NoPlan::NoLaneGraph(error.to_string()));
            agent.go_on(scene, None)?;
            return Ok((begun(decision), None));
        }
    };
    let seen = GraphedScene::new(scene, &graph);
    let observation = agent.observe(seen)?;
    let environment_ms = total_ms();
    let terms = CallTerms::new(agent.settings(), input.iteration, started);
    let attempts = agent.attempts(&observation, seen, terms)?;
    let decision = agent.decide(&attempts);
    let (records, plan) = attempts.into_records(decision.attempt());
    let Shown { image, text, forms } = agent.shown(&observation);
    let mut call = PlanningCall {
        image_hash: image.as_deref().map(image_hash),
        image,
        scene_text: text,
        forms,
        attempts: records,
        environment_ms,
        ..begun(decision)
    };
    let plan = if let Some(plan) = plan {
        Some(agent.settle(plan, &mut call, seen)?)
    } else {
        agent.go_on(scene, Some(&graph))?;
        None
    };
    call.total_ms = total_ms();
    Ok((call, plan))
}
