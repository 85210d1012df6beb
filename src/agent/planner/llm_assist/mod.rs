//! LLM-ASSIST (Sharan et al. 2024): PDM-Closed is executed until none of its proposals scores
//! enough. Then a language model is asked for a plan (UNC) or for other parameters of PDM-Closed
//! (PAR).
//!
//! The paper says this much, and that the model may be asked several times. The rest is our
//! reading: prompts and answers are those of [`crate::reasoning`]. An answer is executed for as
//! long as PlanAgent's plans. Answers are scored as PDM-Closed's proposals are. One that reaches τ
//! is taken at once. After the last attempt the best answer is taken if it scores more than
//! PDM-Closed's own best proposal; else PDM-Closed is executed. The emergency brake does not
//! overrule a plan.

mod waypoints;

use super::attempts::{AttemptLimits, Attempts, Question, Trial};
use super::clock::Clock;
use super::record::{Decision, NoPlan, PlanningCall};
use super::{
    PlanAgentSettings, Planner, PlannerError, PlannerInitialization, PlannerInput, PlannerName,
};
use crate::environment::coordinates::llm_assist_text;
use crate::environment::text::{self, Description};
use crate::environment::{LaneGraph, TextForm};
use crate::reasoning::{
    AssistParameters, AssistQuestion, AssistReasoning, AssistVariant, Assistance, Feedback, Names,
    PromptSet, ReasoningError, ReasoningSettings, ReasoningTrace, WAYPOINT_SECONDS,
};
use crate::reflection::Judge;
use planagent_mllm::{Deadline, Mllm, milliseconds};
use planagent_score::pdm::{
    self, Collided, PROPOSAL_STEPS, PdmMemory, PdmParameters, PdmPlan, ReferencePath, plan_tuned,
};
use planagent_world::dynamics::{JerkPenalty, simulate_proposal};
use planagent_world::geometry::Pose;
use planagent_world::{EgoState, STEP_S, SceneView, Trajectory};
use std::sync::Arc;
use std::time::Instant;

/// LLM-ASSIST in one of its variants.
pub struct LlmAssist {
    name: PlannerName,
    variant: AssistVariant,
    model: Arc<dyn Mllm>,
    prompts: Arc<PromptSet>,
    reasoning: ReasoningSettings,
    settings: PlanAgentSettings,
    memory: PdmMemory,
    active: Option<Assisted>,
    /// When the active answer ends and the model may be asked again.
    clock: Clock,
    calls: Vec<PlanningCall>,
}

/// The model that is asked, and how.
pub struct AskedModel {
    /// The model.
    pub model: Arc<dyn Mllm>,
    /// The prompts that it is asked with.
    pub prompts: Arc<PromptSet>,
    /// How it is asked.
    pub reasoning: ReasoningSettings,
}

/// What an answer stands for.
#[derive(Debug, Clone)]
enum Assisted {
    /// A trajectory.
    Plan(Trajectory),
    /// PDM-Closed with these parameters.
    Parameters(PdmParameters),
}

impl LlmAssist {
    /// A planner that asks this model. τ is the gate of the settings, else their λ. A planning call
    /// lasts no simulated time.
    pub fn new(
        name: PlannerName,
        variant: AssistVariant,
        AskedModel {
            model,
            prompts,
            reasoning,
        }: AskedModel,
        settings: PlanAgentSettings,
    ) -> Self {
        let (memory, clock, calls) = (PdmMemory::default(), Clock::default(), Vec::new());
        Self {
            name,
            variant,
            model,
            prompts,
            reasoning,
            settings,
            memory,
            active: None,
            clock,
            calls,
        }
    }

    /// τ.
    fn tau(&self) -> f64 {
        self.settings
            .agent
            .gate
            .unwrap_or(self.settings.reflection.threshold)
    }

    /// One planning call, made where PDM-Closed's best proposal scores less than τ.
    fn call(
        &mut self,
        iteration: usize,
        scene: &SceneView<'_>,
        rules: &PdmPlan,
    ) -> Result<(), PlannerError> {
        let started = Instant::now();
        let at_s = self.clock.elapsed_s(scene.ego.time_us);
        // Before the graph is built: a call without one counts as made, or it would be tried at
        // every step.
        self.clock.set_called();
        let graph = match LaneGraph::build(scene, self.settings.environment.node_length_m) {
            Ok(graph) => graph,
            Err(error) => {
                let decision = Decision::RuleBased(NoPlan::NoLaneGraph(error.to_string()));
                let total_ms = milliseconds(started.elapsed());
                self.calls.push(PlanningCall::without_attempts(
                    iteration, at_s, decision, total_ms,
                ));
                return Ok(());
            }
        };
        let question = self.question(scene, &graph, rules);
        let environment_ms = milliseconds(started.elapsed());
        let deadline = self
            .settings
            .deadline()
            .map_or(Deadline::NONE, |limit| Deadline::after(started, limit));
        let attempts = self.ask(iteration, scene, &question, deadline)?;
        let decision = decide(&attempts, rules);
        let (attempts, active) = attempts.into_records(decision.attempt());
        self.active = active;
        self.calls.push(PlanningCall {
            iteration,
            at_s,
            image: None,
            image_hash: None,
            scene_text: Some(question.scene_text),
            forms: Some(*self.prompts.forms()),
            attempts,
            decision,
            emergency_brakes: 0,
            handovers: 0,
            aborted_lane_change: None,
            active_from: None,
            environment_ms,
            total_ms: milliseconds(started.elapsed()),
        });
        Ok(())
    }

    fn question(
        &self,
        scene: &SceneView<'_>,
        graph: &LaneGraph,
        rules: &PdmPlan,
    ) -> AssistQuestion {
        let scene_text = match self.prompts.forms().scene_text {
            TextForm::Paper | TextForm::Brief => llm_assist_text(scene, graph),
            form @ (TextForm::Compact | TextForm::Compact2) => {
                text::write(&Description::from_graph(graph), form)
            }
        };
        let speed_limit = Names::from_graph(graph).speed_limit;
        AssistQuestion {
            scene_text,
            score: rules.scores[rules.best].total,
            speed_limit,
        }
    }

    /// Attempts until an answer reaches τ, `max_exec` are made, or the call is interrupted.
    fn ask(
        &mut self,
        iteration: usize,
        scene: &SceneView<'_>,
        question: &AssistQuestion,
        deadline: Deadline,
    ) -> Result<Attempts<Assisted>, PlannerError> {
        let tau = self.tau();
        let Self {
            variant,
            model,
            prompts,
            reasoning,
            settings,
            memory,
            ..
        } = self;
        let seed = settings.call_seed(iteration);
        let reasoning = AssistReasoning::open(
            *variant,
            model.as_ref(),
            prompts.as_ref(),
            reasoning,
            question,
            seed,
            deadline,
        )?;
        let PdmMemory {
            reference_path: Some(path),
            collided,
        } = memory
        else {
            return Ok(Attempts::NONE);
        };
        let started = Instant::now();
        // Over PDM-Closed's own horizon, so that an answer's score compares with τ as its proposals
        // do.
        let judge = Judge::along(scene, path, PROPOSAL_STEPS as f64 * STEP_S, collided)?;
        let observation_ms = milliseconds(started.elapsed());
        let limits = AttemptLimits {
            max_exec: settings.reflection.max_exec,
            threshold: tau,
            compares: false,
        };
        let mut asked = AssistCall {
            reasoning,
            path,
            scene,
            collided,
            judge,
            tau,
        };
        Attempts::make(&mut asked, limits, observation_ms)
    }
}

impl Planner for LlmAssist {
    fn name(&self) -> &str {
        self.name.as_str()
    }

    fn initialize(
        &mut self,
        initialization: &PlannerInitialization<'_>,
    ) -> Result<(), PlannerError> {
        (self.memory, self.active, self.clock) = (PdmMemory::default(), None, Clock::default());
        self.calls.clear();
        if initialization.route.lanes(initialization.map).is_empty() {
            Err(PlannerError::EmptyRoute)
        } else {
            Ok(())
        }
    }

    fn compute_trajectory(&mut self, input: &PlannerInput<'_>) -> Result<Trajectory, PlannerError> {
        let scene = &input.scene;
        let rules = pdm::plan(&mut self.memory, scene)?;
        self.clock.step(scene.ego.time_us);
        if self
            .clock
            .is_due(self.settings.agent.interval_s.min(WAYPOINT_SECONDS as f64))
        {
            self.active = None;
            if rules.scores[rules.best].total < self.tau() {
                self.call(input.iteration, scene, &rules)?;
            }
        }
        match (&self.active, &mut self.memory) {
            (Some(Assisted::Plan(trajectory)), _) => Ok(trajectory.clone()),
            (
                Some(Assisted::Parameters(parameters)),
                PdmMemory {
                    reference_path: Some(path),
                    collided,
                },
            ) => Ok(plan_tuned(path, scene, collided, *parameters)?.trajectory),
            _ => Ok(rules.trajectory),
        }
    }

    fn calls(&self) -> &[PlanningCall] {
        &self.calls
    }

    fn take_calls(&mut self) -> Vec<PlanningCall> {
        std::mem::take(&mut self.calls)
    }
}

/// The answers of a planning call, tried out along PDM-Closed's reference path.
struct AssistCall<'a> {
    reasoning: AssistReasoning<'a>,
    path: &'a ReferencePath,
    scene: &'a SceneView<'a>,
    collided: &'a mut Collided,
    judge: Judge<'a>,
    tau: f64,
}

impl Question for AssistCall<'_> {
    type Answer = Assistance;
    type Plan = Assisted;

    fn ask(
        &mut self,
        feedback: Option<&Feedback>,
    ) -> Result<Option<ReasoningTrace<Assistance>>, ReasoningError> {
        self.reasoning.think(feedback).map(Some)
    }

    fn try_out(&mut self, assistance: Assistance) -> Result<Option<Trial<Assisted>>, PlannerError> {
        let ego = self.scene.ego;
        let (plan, path, states): (Assisted, Vec<Pose>, Vec<EgoState>) = match assistance {
            Assistance::Waypoints(waypoints) => {
                let trajectory = waypoints::through(ego, &waypoints)?;
                let states = trajectory.states().iter().take(PROPOSAL_STEPS + 1);
                let path: Vec<Pose> = states.map(|state| state.rear_axle).collect();
                let states = simulate_proposal(ego, &path, JerkPenalty::PdmClosed);
                (Assisted::Plan(trajectory), path, states)
            }
            Assistance::Parameters(parameters) => {
                let parameters = tuned(parameters);
                let mut plan = plan_tuned(self.path, self.scene, self.collided, parameters)?;
                let (best, states) = (
                    plan.proposals.swap_remove(plan.best),
                    plan.simulated.swap_remove(plan.best),
                );
                (Assisted::Parameters(parameters), best.poses, states)
            }
        };
        let reflection = Some(self.judge.assess(states, self.tau)?);
        Ok(Some(Trial {
            plan,
            path,
            reflection,
            threshold: self.tau,
        }))
    }
}

fn tuned(parameters: AssistParameters) -> PdmParameters {
    let AssistParameters {
        speed_cap,
        min_gap,
        headway,
        accel_max,
        decel_max,
        emergency_brake,
    } = parameters;
    PdmParameters {
        speed_cap: Some(speed_cap),
        min_gap,
        headway,
        accel_max,
        decel_max,
        emergency_brake,
    }
}

/// The first answer that is accepted, else the best one if it scores more than PDM-Closed's own
/// best proposal, else PDM-Closed.
fn decide(attempts: &Attempts<Assisted>, rules: &PdmPlan) -> Decision {
    if let Some(index) = attempts.accepted() {
        return Decision::Execute(index);
    }
    match (attempts.best(), &attempts.interruption) {
        (Some(index), _) if attempts.score(index) > rules.scores[rules.best].total => {
            Decision::Exhausted(index)
        }
        (_, Some(why)) => Decision::RuleBased(NoPlan::Interrupted(why.clone())),
        (Some(_), None) => Decision::RuleBased(NoPlan::Outscored),
        (None, None) => Decision::RuleBased(NoPlan::Unreadable(attempts.unreadable())),
    }
}
