//! LLM-ASSIST (Sharan et al. 2024): PDM-Closed drives until none of its proposals is good enough; then a language model is
//! asked, for a plan (UNC) or for other parameters of PDM-Closed (PAR).
//!
//! What is published is this much, and that the model may be asked several times. The rest is our reading: prompts and answers
//! are those of [`crate::reasoning`]; an answer counts for as long as PlanAgent's planners do; answers are scored as
//! PDM-Closed's proposals are; one that reaches τ is taken at once, and after the last attempt the best of the answers drives if
//! it scores better than the proposal that gave rise to the call, else PDM-Closed goes on. A plan is not overruled by the
//! emergency brake.

mod waypoints;

use super::pdm_closed::pdm_failed;
use super::plan_agent::{names, reflection_failed};
use super::record::{Attempt, Decision, NoPlan, PlanningCall};
use super::{PlanAgentSettings, Planner, PlannerError, PlannerInitialization, PlannerInput, PlannerName};
use crate::dynamics::{JerkPenalty, simulate_proposal};
use crate::environment::coordinates::llm_assist_text;
use crate::environment::text::{self, Description};
use crate::environment::{LaneGraph, TextForm};
use crate::geometry::Pose;
use crate::mllm::milliseconds;
use crate::mllm::{Deadline, Mllm};
use crate::pdm::{self, Collided, PROPOSAL_STEPS, PdmMemory, PdmParameters, PdmPlan, ReferencePath, plan_tuned};
use crate::reasoning::{
    AssistParameters, AssistQuestion, AssistReasoning, AssistTrace, AssistVariant, Assistance, Interruption, PromptSet,
    ReasoningSettings, WAYPOINT_SECONDS,
};
use crate::reflection::{Judge, ReflectionReport, Verdict};
use crate::world::{EgoState, STEP_S, SceneView, Trajectory};
use std::sync::Arc;
use std::time::Instant;

/// Iterations that a plan reaches.
const PLAN_ITERATIONS: usize = WAYPOINT_SECONDS * 10;

/// LLM-ASSIST in one of its variants.
pub struct LlmAssist {
    name: PlannerName,
    variant: AssistVariant,
    model: Arc<dyn Mllm>,
    prompts: Arc<PromptSet>,
    reasoning: ReasoningSettings,
    settings: PlanAgentSettings,
    memory: PdmMemory,
    active_plan: Option<Assisted>,
    /// The first iteration at which the model may be asked again, and at which what is in force ends.
    until: usize,
    calls: Vec<PlanningCall>,
}

/// What a model's answer comes to.
#[derive(Debug, Clone)]
enum Assisted {
    /// This is driven.
    Plan(Trajectory),
    /// PDM-Closed drives with these.
    Parameters(PdmParameters),
}

/// What came of the attempts of a call; the n-th answer belongs to the n-th attempt.
#[derive(Default)]
struct Answers {
    attempts: Vec<Attempt>,
    assisted: Vec<Option<Assisted>>,
    interruption: Option<Interruption>,
}

impl LlmAssist {
    /// A planner that asks this model; `name` stands in results. Its τ is the gate of the settings, else their λ; no time
    /// passes while it is asked.
    pub fn new(
        name: PlannerName,
        variant: AssistVariant,
        (model, prompts, reasoning): (Arc<dyn Mllm>, Arc<PromptSet>, ReasoningSettings),
        settings: PlanAgentSettings,
    ) -> Self {
        let (memory, calls) = (PdmMemory::default(), Vec::new());
        Self { name, variant, model, prompts, reasoning, settings, memory, active_plan: None, until: 0, calls }
    }

    /// τ.
    fn tau(&self) -> f64 {
        self.settings.gate.unwrap_or(self.settings.threshold)
    }

    /// One call, because PDM-Closed's best proposal is not good enough.
    fn call(&mut self, iteration: usize, scene: &SceneView<'_>, rules: &PdmPlan) -> Result<(), PlannerError> {
        let started = Instant::now();
        self.until = iteration + self.settings.interval.min(PLAN_ITERATIONS);
        let graph = match LaneGraph::build(scene, self.settings.node_length_m) {
            Ok(graph) => graph,
            Err(error) => {
                let decision = Decision::RuleBased(NoPlan::NoLaneGraph(error.to_string()));
                self.calls.push(PlanningCall::without_attempts(iteration, decision, milliseconds(started.elapsed())));
                return Ok(());
            }
        };
        let question = self.question(scene, &graph, rules);
        let environment_ms = milliseconds(started.elapsed());
        let deadline = self.settings.deadline.map_or(Deadline::NONE, |limit| Deadline::after(started, limit));
        let answers = self.ask(iteration, scene, &question, deadline)?;
        let decision = decide(&answers, rules);
        if let Decision::Execute(index) | Decision::Exhausted(index) = decision {
            self.active_plan = answers.assisted.into_iter().nth(index).flatten();
        }
        self.calls.push(PlanningCall {
            iteration,
            image: None,
            image_hash: None,
            scene_text: Some(question.scene_text),
            attempts: answers.attempts,
            decision,
            emergency_brakes: 0,
            aborted_lane_change: None,
            active_from: None,
            environment_ms,
            total_ms: milliseconds(started.elapsed()),
        });
        Ok(())
    }

    fn question(&self, scene: &SceneView<'_>, graph: &LaneGraph, rules: &PdmPlan) -> AssistQuestion {
        let scene_text = match self.prompts.forms().scene_text {
            TextForm::Paper => llm_assist_text(scene, graph),
            TextForm::Compact => text::write(&Description::of(graph), TextForm::Compact),
        };
        AssistQuestion { scene_text, score: rules.scores[rules.best].total, speed_limit: names(graph).speed_limit }
    }

    /// Attempts until an answer reaches τ, `max_exec` are made, or the call is interrupted.
    fn ask(
        &mut self,
        iteration: usize,
        scene: &SceneView<'_>,
        question: &AssistQuestion,
        deadline: Deadline,
    ) -> Result<Answers, PlannerError> {
        let tau = self.tau();
        let Self { variant, model, prompts, reasoning, settings, memory, .. } = self;
        let failed = |doing| move |error| PlannerError::Failed { doing, source: Box::new(error) };
        let (asked, seed) = ((prompts.as_ref(), &*reasoning), settings.call_seed(iteration));
        let mut reasoning = AssistReasoning::open(*variant, model.as_ref(), asked, question, seed, deadline)
            .map_err(failed("opening the conversation"))?;
        let mut answers = Answers::default();
        let PdmMemory { reference_path: Some(reference_path), collided } = memory else { return Ok(answers) };
        let looking = Instant::now();
        let horizon_s = PROPOSAL_STEPS as f64 * STEP_S;
        let judge = Judge::along(scene, reference_path, horizon_s, collided).map_err(reflection_failed)?;
        let mut looked_ms = milliseconds(looking.elapsed());
        while answers.attempts.len() < settings.max_exec {
            let feedback = answers.attempts.last().map(|last| last.feedback(tau));
            let trace = reasoning.think(feedback.as_ref()).map_err(failed("asking the model"))?;
            if trace.interruption.is_some() {
                answers.interruption = trace.interruption;
                break;
            }
            let started = Instant::now();
            let (assisted, path, reflection) = match trace.assistance {
                Some(assistance) => {
                    let Tried { assisted, path, states } = try_out(reference_path, scene, collided, assistance)?;
                    let report = judge.assess(states, tau).map_err(reflection_failed)?;
                    (Some(assisted), path, Some(report))
                }
                None => (None, Vec::new(), None),
            };
            let accepted = reflection.as_ref().is_some_and(|report| report.verdict == Verdict::Execute);
            let reflection_ms = std::mem::take(&mut looked_ms) + milliseconds(started.elapsed());
            answers.attempts.push(attempt(trace, path, reflection, reflection_ms));
            answers.assisted.push(assisted);
            if accepted {
                break;
            }
        }
        Ok(answers)
    }
}

impl Planner for LlmAssist {
    fn name(&self) -> &str {
        self.name.as_str()
    }

    fn calls(&self) -> &[PlanningCall] {
        &self.calls
    }

    fn initialize(&mut self, initialization: &PlannerInitialization<'_>) -> Result<(), PlannerError> {
        (self.memory, self.active_plan, self.until) = (PdmMemory::default(), None, 0);
        self.calls.clear();
        if initialization.route.lanes(initialization.map).is_empty() { Err(PlannerError::EmptyRoute) } else { Ok(()) }
    }

    fn compute_trajectory(&mut self, input: &PlannerInput<'_>) -> Result<Trajectory, PlannerError> {
        let scene = &input.scene;
        let rules = pdm::plan(&mut self.memory, scene).map_err(pdm_failed)?;
        if input.iteration >= self.until {
            self.active_plan = None;
            if rules.scores[rules.best].total < self.tau() {
                self.call(input.iteration, scene, &rules)?;
            }
        }
        match (&self.active_plan, &mut self.memory) {
            (Some(Assisted::Plan(trajectory)), _) => Ok(trajectory.clone()),
            (Some(Assisted::Parameters(parameters)), PdmMemory { reference_path: Some(reference_path), collided }) => {
                Ok(plan_tuned(reference_path, scene, collided, *parameters).map_err(pdm_failed)?.trajectory)
            }
            _ => Ok(rules.trajectory),
        }
    }
}

/// An answer, tried out.
struct Tried {
    assisted: Assisted,
    path: Vec<Pose>,
    /// The ego as it would drive, every 0.1 s over PDM-Closed's horizon.
    states: Vec<EgoState>,
}

fn try_out(
    reference_path: &ReferencePath,
    scene: &SceneView<'_>,
    collided: &mut Collided,
    assistance: Assistance,
) -> Result<Tried, PlannerError> {
    match assistance {
        Assistance::Waypoints(waypoints) => {
            let trajectory = waypoints::through(scene.ego, &waypoints)?;
            let path: Vec<Pose> =
                trajectory.states().iter().take(PROPOSAL_STEPS + 1).map(|state| state.rear_axle).collect();
            let states = simulate_proposal(scene.ego, &path, JerkPenalty::PdmClosed);
            Ok(Tried { assisted: Assisted::Plan(trajectory), path, states })
        }
        Assistance::Parameters(parameters) => {
            let parameters = tuned(parameters);
            let mut plan = plan_tuned(reference_path, scene, collided, parameters).map_err(pdm_failed)?;
            let (proposal, states) = (plan.proposals.swap_remove(plan.best), plan.simulated.swap_remove(plan.best));
            Ok(Tried { assisted: Assisted::Parameters(parameters), path: proposal.poses, states })
        }
    }
}

fn tuned(parameters: AssistParameters) -> PdmParameters {
    let AssistParameters { speed_cap, min_gap, headway, accel_max, decel_max, emergency_brake } = parameters;
    PdmParameters { speed_cap: Some(speed_cap), min_gap, headway, accel_max, decel_max, emergency_brake }
}

fn attempt(trace: AssistTrace, path: Vec<Pose>, reflection: Option<ReflectionReport>, reflection_ms: f64) -> Attempt {
    let AssistTrace { rounds, assistance, errors, .. } = trace;
    Attempt { rounds, instruction: None, code: None, assistance, errors, reflection, path, reflection_ms }
}

/// The first answer that was accepted, else the best if it beats PDM-Closed's own proposal, else that.
fn decide(answers: &Answers, rules: &PdmPlan) -> Decision {
    let scored = || answers.attempts.iter().enumerate().filter_map(|(i, a)| Some((i, a.reflection.as_ref()?)));
    if let Some((index, _)) = scored().find(|(_, report)| report.verdict == Verdict::Execute) {
        return Decision::Execute(index);
    }
    let best = scored().map(|(index, report)| (index, report.score)).reduce(|a, b| if b.1 > a.1 { b } else { a });
    match (best, &answers.interruption) {
        (Some((index, score)), _) if score > rules.scores[rules.best].total => Decision::Exhausted(index),
        (_, Some(why)) => Decision::RuleBased(NoPlan::Interrupted(why.clone())),
        (Some(_), None) => Decision::RuleBased(NoPlan::Outscored),
        (None, None) => Decision::RuleBased(NoPlan::Unreadable),
    }
}
