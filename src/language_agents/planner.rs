//! The planner that a language agent is: it asks in intervals, records every call, and executes the
//! last plan in between.

use crate::agent::{LanguageAgent, Reply};
use crate::chat::Chat;
use planagent_agent::environment::{GraphedScene, LaneGraph};
use planagent_agent::planner::{
    AskedModel, Attempt, Clock, Decision, NoPlan, PlanAgentSettings, Planner, PlannerError,
    PlannerInitialization, PlannerInput, PlannerName, PlanningCall, comfortable_stop,
};
use planagent_agent::reasoning::{Interruption, RoundRecord};
use planagent_mllm::{Deadline, milliseconds};
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
pub(crate) struct LanguagePlanner<A: LanguageAgent> {
    name: PlannerName,
    agent: A,
    source: Source<A::Answer>,
    settings: PlanAgentSettings,
    clock: Clock,
    /// Whether a plan was made.
    has_plan: bool,
    calls: Vec<PlanningCall>,
}

/// What a planning call asked and got.
struct Outcome<A> {
    rounds: Vec<RoundRecord>,
    reply: Reply<A>,
    interruption: Option<Interruption>,
}

impl<A: LanguageAgent> LanguagePlanner<A> {
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

    fn keep_or_brake(&self, why: NoPlan) -> Decision {
        if self.has_plan {
            Decision::KeepActivePlan(why)
        } else {
            Decision::Brake(why)
        }
    }

    fn answers(
        &self,
        iteration: usize,
        observation: &A::Observation<'_>,
        started: Instant,
    ) -> Result<Outcome<A::Answer>, PlannerError> {
        match &self.source {
            Source::Model(AskedModel {
                model, reasoning, ..
            }) => {
                let deadline = self
                    .settings
                    .deadline()
                    .map_or(Deadline::NONE, |limit| Deadline::after(started, limit));
                let seed = self.settings.call_seed(iteration);
                let mut chat = Chat::new(model.as_ref(), reasoning, seed, deadline);
                let reply = self.agent.ask(observation, &mut chat)?;
                Ok(Outcome {
                    rounds: chat.rounds,
                    reply,
                    interruption: chat.interruption,
                })
            }
            Source::Handed(handed) => Ok(Outcome {
                rounds: Vec::new(),
                reply: handed.take().map_or_else(Reply::none, Reply::plan),
                interruption: None,
            }),
        }
    }

    /// One planning call.
    fn call(&mut self, input: &PlannerInput<'_>) -> Result<(), PlannerError> {
        let started = Instant::now();
        let (scene, iteration) = (&input.scene, input.iteration);
        let at_s = self.clock.elapsed_s(scene.ego.time_us);
        let graph = match LaneGraph::build(scene, self.settings.environment.node_length_m) {
            Ok(graph) => graph,
            Err(error) => {
                let decision = self.keep_or_brake(NoPlan::NoLaneGraph(error.to_string()));
                let total_ms = milliseconds(started.elapsed());
                self.calls.push(PlanningCall::without_attempts(
                    iteration, at_s, decision, total_ms,
                ));
                return Ok(());
            }
        };
        let seen = GraphedScene::new(scene, &graph);
        let observation = self.agent.observe(seen);
        let environment_ms = milliseconds(started.elapsed());
        let outcome = self.answers(iteration, &observation, started)?;
        let (attempts, decision) = self.act(outcome, &observation, seen)?;
        let total_ms = milliseconds(started.elapsed());
        let mut call = PlanningCall::without_attempts(iteration, at_s, decision, total_ms);
        call.scene_text = Some(A::scene_text(&observation));
        (call.attempts, call.environment_ms) = (attempts, environment_ms);
        self.calls.push(call);
        Ok(())
    }

    /// Executes an answer, or goes on without.
    fn act(
        &mut self,
        Outcome {
            rounds,
            reply,
            interruption,
        }: Outcome<A::Answer>,
        observation: &A::Observation<'_>,
        seen: GraphedScene<'_>,
    ) -> Result<(Vec<Attempt>, Decision), PlannerError> {
        let was_asked = !rounds.is_empty() || reply.answer.is_some();
        let mut attempt = Attempt::of_rounds(rounds);
        (attempt.answer, attempt.errors) = (reply.answer.map(Into::into), reply.errors);
        let decision = match (reply.answer, reply.unreadable, interruption) {
            (_, _, Some(why)) => self.keep_or_brake(NoPlan::Interrupted(why)),
            (Some(answer), None, None) => {
                let trajectory = self.agent.adopt(answer, observation, seen)?;
                let states = trajectory.states().iter().take(RECORDED_STATES);
                attempt.path = states.map(|state| state.rear_axle).collect();
                self.has_plan = true;
                Decision::Execute(0)
            }
            (_, unreadable, None) => {
                let why = unreadable.unwrap_or(planagent_agent::planner::Unreadable::NoAttempt);
                self.keep_or_brake(NoPlan::Unreadable(why))
            }
        };
        // The active plan must still reach as far ahead as a new one would.
        if decision.attempt().is_none() && self.has_plan {
            self.agent.go_on(seen)?;
        }
        let attempts = if was_asked { vec![attempt] } else { Vec::new() };
        Ok((attempts, decision))
    }
}

impl<A: LanguageAgent> Planner for LanguagePlanner<A> {
    fn name(&self) -> &str {
        self.name.as_str()
    }

    fn initialize(
        &mut self,
        initialization: &PlannerInitialization<'_>,
    ) -> Result<(), PlannerError> {
        self.agent.reset();
        (self.clock, self.has_plan) = (Clock::default(), false);
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
            self.call(input)?;
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
