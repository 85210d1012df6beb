//! The planner that a language agent is: it asks in intervals, records every call, and executes the
//! last plan in between.

use crate::agent::ChatAgent;
use crate::chat::Chat;
use planagent_agent::environment::{GraphedScene, LaneGraph};
use planagent_agent::planner::{
    AskedModel, AttemptLimits, Attempts, CallTerms, Clock, Decision, LanguageAgent, NoPlan,
    PlanAgentSettings, Planner, PlannerError, PlannerInitialization, PlannerInput, PlannerName,
    PlanningCall, Question, Shown, Trial, Unreadable, comfortable_stop, planning_call,
};
use planagent_agent::reasoning::{
    Feedback, Parsed, PromptSet, ReasoningError, ReasoningTrace, feedback_text,
};
use planagent_agent::reflection::Judge;
use planagent_mllm::milliseconds;
use planagent_score::pdm::PdmMemory;
use planagent_world::{SceneView, Trajectory};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

/// Length of a stop without a plan, steps of 0.1 s.
const STOP_STEPS: usize = 80;
/// States of a plan in its record: four seconds, as of PlanAgent's plans.
const RECORDED_STATES: usize = 41;

/// Where the answers come from.
pub(crate) enum Source<A> {
    /// A model.
    Model(AskedModel),
    /// What stands in a model's place: the next answer is handed over before it is asked for.
    Handed(Handed<A>),
}

/// An answer that is handed over.
#[derive(Debug)]
pub(crate) struct Handed<A>(Arc<Mutex<Option<A>>>);

impl<A> Clone for Handed<A> {
    fn clone(&self) -> Self {
        Self(Arc::clone(&self.0))
    }
}

impl<A> Default for Handed<A> {
    fn default() -> Self {
        Self(Arc::default())
    }
}

impl<A> Handed<A> {
    pub(crate) fn hand(&self, answer: Option<A>) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = answer;
    }

    fn take(&self) -> Option<A> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).take()
    }
}

/// A language agent as a planner.
pub(crate) struct LanguagePlanner<A: ChatAgent> {
    name: PlannerName,
    agent: A,
    source: Source<A::Answer>,
    settings: PlanAgentSettings,
    /// What PDM's view of the scenes so far leaves to the next.
    memory: PdmMemory,
    clock: Clock,
    /// Whether a plan was made.
    has_plan: bool,
    calls: Vec<PlanningCall>,
}

impl<A: ChatAgent> LanguagePlanner<A> {
    pub(crate) fn new(
        name: PlannerName,
        agent: A,
        source: Source<A::Answer>,
        settings: PlanAgentSettings,
    ) -> Self {
        Self {
            name,
            agent,
            source,
            settings,
            memory: PdmMemory::default(),
            clock: Clock::default(),
            has_plan: false,
            calls: Vec::new(),
        }
    }

    /// The agent, for what stands in its model's place.
    pub(crate) fn agent(&self) -> &A {
        &self.agent
    }

    /// Whether the next step, in this scene, begins with a planning call.
    pub(crate) fn begins_with_call(&self, scene: &SceneView<'_>) -> bool {
        let mut clock = self.clock.clone();
        clock.step(scene.ego.time_us);
        clock.is_due(self.agent.interval_s())
    }

    /// When the attempts of a planning call end.
    fn limits(&self) -> AttemptLimits {
        if !self.agent.reflects() {
            return AttemptLimits::ONE;
        }
        let reflection = &self.settings.reflection;
        AttemptLimits {
            max_exec: reflection.max_exec,
            threshold: reflection.threshold,
            compares: false,
        }
    }

    /// Reflection's view of the scene, where it scores the plans.
    fn judge<'a>(&mut self, seen: GraphedScene<'a>) -> Result<Option<Judge<'a>>, PlannerError> {
        if !self.agent.reflects() {
            return Ok(None);
        }
        let GraphedScene { scene, graph } = seen;
        let horizon_s = self.settings.reflection.horizon_s;
        Ok(Some(Judge::new(scene, graph, horizon_s, &mut self.memory)?))
    }
}

/// Where the answers of a planning call come from.
enum Answers<'a, A> {
    /// One chat for all attempts, so that each draws from a stream of its own.
    Asked {
        chat: Chat<'a>,
        prompts: &'a PromptSet,
    },
    Handed(&'a Handed<A>),
}

/// The question of a planning call. It is asked again where Reflection refuses the plan.
struct Asking<'a, 's, A: ChatAgent> {
    planner: &'a LanguagePlanner<A>,
    observation: &'a A::Observation<'s>,
    seen: GraphedScene<'a>,
    answers: Answers<'a, A::Answer>,
    /// `None` where no plan is scored.
    judge: Option<Judge<'a>>,
    /// Why the answer is no plan.
    unreadable: Option<Unreadable>,
}

impl<A: ChatAgent> Question for Asking<'_, '_, A> {
    type Answer = A::Answer;
    type Plan = A::Plan;

    fn ask(
        &mut self,
        feedback: Option<&Feedback>,
    ) -> Result<Option<ReasoningTrace<A::Answer>>, ReasoningError> {
        let (chat, prompts) = match &mut self.answers {
            Answers::Asked { chat, prompts } => (chat, prompts),
            Answers::Handed(handed) => {
                return Ok(handed.take().map(ReasoningTrace::without_rounds));
            }
        };
        let feedback = feedback.map(|feedback| feedback_text(prompts, feedback));
        chat.begin_attempt(feedback.transpose()?);
        let reply = self.planner.agent.ask(self.observation, chat)?;
        self.unreadable = reply.unreadable;
        let (answer, errors) = (reply.answer, reply.errors);
        Ok(Some(ReasoningTrace {
            rounds: std::mem::take(&mut chat.rounds),
            interruption: chat.interruption.take(),
            ..ReasoningTrace::of_parsed(Parsed { answer, errors })
        }))
    }

    fn try_out(&mut self, answer: A::Answer) -> Result<Option<Trial<A::Plan>>, PlannerError> {
        if self.unreadable.is_some() {
            return Ok(None);
        }
        let agent = &self.planner.agent;
        let (plan, trajectory) = agent.plan(answer, self.observation, self.seen)?;
        let states = trajectory.states().iter().take(RECORDED_STATES);
        let threshold = self.planner.limits().threshold;
        let reflect = |judge: &Judge<'_>| judge.assess(judge.follow(&trajectory), threshold);
        Ok(Some(Trial {
            plan,
            path: states.map(|state| state.rear_axle).collect(),
            reflection: self.judge.as_ref().map(reflect).transpose()?,
            threshold,
        }))
    }

    fn unreadable(&self) -> Option<Unreadable> {
        self.unreadable
    }
}

impl<A: ChatAgent> LanguageAgent for LanguagePlanner<A> {
    type Observation<'s> = A::Observation<'s>;
    type Plan = A::Plan;

    fn settings(&self) -> &PlanAgentSettings {
        &self.settings
    }

    fn observe<'s>(
        &mut self,
        seen: GraphedScene<'s>,
    ) -> Result<Self::Observation<'s>, PlannerError> {
        Ok(self.agent.observe(seen))
    }

    fn shown(&self, observation: &Self::Observation<'_>) -> Shown {
        Shown {
            text: Some(A::scene_text(observation)),
            ..Shown::default()
        }
    }

    fn attempts(
        &mut self,
        observation: &Self::Observation<'_>,
        seen: GraphedScene<'_>,
        terms: CallTerms,
    ) -> Result<Attempts<A::Plan>, PlannerError> {
        let started = Instant::now();
        let judge = self.judge(seen)?;
        let observation_ms = milliseconds(started.elapsed());
        let answers = match &self.source {
            Source::Model(AskedModel {
                model,
                prompts,
                reasoning,
            }) => Answers::Asked {
                chat: Chat::new(model.as_ref(), reasoning, terms.seed, terms.deadline),
                prompts,
            },
            Source::Handed(handed) => Answers::Handed(handed),
        };
        let mut question = Asking {
            planner: self,
            observation,
            seen,
            answers,
            judge,
            unreadable: None,
        };
        Attempts::make(&mut question, self.limits(), observation_ms)
    }

    fn without_plan(&self, why: NoPlan) -> Decision {
        if self.has_plan {
            Decision::KeepActivePlan(why)
        } else {
            Decision::Brake(why)
        }
    }

    /// The active plan must still reach as far ahead as a new one would.
    fn go_on(
        &mut self,
        scene: &SceneView<'_>,
        graph: Option<&LaneGraph>,
    ) -> Result<(), PlannerError> {
        if self.has_plan {
            self.agent.go_on(scene, graph)
        } else {
            Ok(())
        }
    }
}

impl<A: ChatAgent> Planner for LanguagePlanner<A> {
    fn name(&self) -> &str {
        self.name.as_str()
    }

    fn initialize(
        &mut self,
        initialization: &PlannerInitialization<'_>,
    ) -> Result<(), PlannerError> {
        self.agent.reset();
        (self.clock, self.has_plan) = (Clock::default(), false);
        self.memory = PdmMemory::default();
        self.calls.clear();
        if initialization.route.lanes(initialization.map).is_empty() {
            Err(PlannerError::EmptyRoute)
        } else {
            Ok(())
        }
    }

    fn compute_trajectory(&mut self, input: &PlannerInput<'_>) -> Result<Trajectory, PlannerError> {
        self.clock.step(input.scene.ego.time_us);
        if self.clock.is_due(self.agent.interval_s()) {
            self.clock.set_called();
            let at_s = self.clock.elapsed_s(input.scene.ego.time_us);
            let (call, plan) = planning_call(self, input, at_s, Instant::now())?;
            self.calls.push(call);
            if let Some(plan) = plan {
                self.agent.adopt(plan);
                self.has_plan = true;
            }
        }
        let planned = if self.has_plan {
            self.agent.trajectory(input)?
        } else {
            None
        };
        match planned {
            Some(trajectory) => Ok(trajectory),
            None => Ok(comfortable_stop(input.scene.ego, STOP_STEPS)?),
        }
    }

    fn calls(&self) -> &[PlanningCall] {
        &self.calls
    }

    fn take_calls(&mut self) -> Vec<PlanningCall> {
        std::mem::take(&mut self.calls)
    }
}
