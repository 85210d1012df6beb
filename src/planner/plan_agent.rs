//! The agent of the paper: every 20 iterations it looks, thinks, writes a planner and reflects on it; in between the planner
//! in force drives.

use super::active_plan::{ActivePlan, Underway, followed_on, keep_lane_and_speed};
use super::code_source::CodeSource;
use super::latency::Latency;
use super::monitored::{MonitoredStep, back_to_own_lane, monitored_step};
use super::pdm_closed::{pdm_failed, predicted_score};
use super::record::{Attempt, Decision, NoPlan, PlanningCall};
use super::settings::{AfterMaxExec, PlanAgentSettings};
use super::shuffled_bev;
use super::{Planner, PlannerError, PlannerInitialization, PlannerInput, PlannerName};
use crate::environment::text::{self, Description};
use crate::environment::{AgentName, BevView, CenterlineName, LaneGraph, bev};
use crate::geometry::Pose;
use crate::mllm::{Deadline, PromptPrefix, milliseconds};
use crate::pdm::{self, PdmMemory, emergency_brake};
use crate::reasoning::{Interruption, Names, ParseError, PlannerCode, ReasoningTrace, ScenarioPrompt};
use crate::reflection::{IdmPlan, Judge, LeadPolicy, PlanMonitor, ReflectionReport, Verdict, needs_emergency_brake};
use crate::world::{STEP_S, SceneView, Trajectory};
use std::time::Instant;

/// Deceleration of a stop that no code asked for, m/s²: within nuPlan's comfort bound of 4.05.
const BRAKE: f64 = 4.0;
/// Steps of 0.1 s of the trajectory that drives: 8 s, what nuPlan's planners give and its open-loop metrics look at.
pub(super) const PLAN_STEPS: usize = 80;

/// PlanAgent: Environment Transformation, Reasoning Engine and Reflection in one planner.
pub struct PlanAgent {
    name: PlannerName,
    code_source: CodeSource,
    settings: PlanAgentSettings,
    active_plan: ActivePlan,
    /// A call whose time has not passed yet.
    underway: Option<Underway>,
    /// What PDM's rules know of this drive: what was touched, and the way of the last planning call.
    memory: PdmMemory,
    calls: Vec<PlanningCall>,
}

/// What came of the attempts of a planning call; the n-th planner belongs to the n-th attempt.
#[derive(Default)]
struct Thinking {
    attempts: Vec<Attempt>,
    planners: Vec<Option<IdmPlan>>,
    interruption: Option<Interruption>,
    /// Score of the planner in force, where it is asked for.
    active_plan: Option<f64>,
}

impl Thinking {
    /// Keeps of many attempts the one with the best score, of the accepted ones if there are any; the first wins ties. It bears the time
    /// of all.
    fn keep_better(&mut self, attempt: Attempt, planner: Option<IdmPlan>) {
        let score = |attempt: &Attempt| {
            attempt.reflection.as_ref().map_or((false, f64::NEG_INFINITY), |r| (r.verdict == Verdict::Execute, r.score))
        };
        let spent_ms = self.attempts.first().map_or(0.0, |best| best.reflection_ms) + attempt.reflection_ms;
        if self.attempts.first().is_none_or(|best| score(&attempt) > score(best)) {
            (self.attempts, self.planners) = (vec![attempt], vec![planner]);
        }
        if let Some(best) = self.attempts.first_mut() {
            best.reflection_ms = spent_ms;
        }
    }
}

impl PlanAgent {
    /// An agent that thinks with this mind; `name` stands in results.
    pub fn new(name: PlannerName, code_source: CodeSource, settings: PlanAgentSettings) -> Self {
        let (active_plan, memory, calls) = (ActivePlan::None, PdmMemory::default(), Vec::new());
        Self { name, code_source, settings, active_plan, underway: None, memory, calls }
    }

    /// The generated planner that drives now.
    pub fn active_plan(&self) -> Option<&IdmPlan> {
        match &self.active_plan {
            ActivePlan::Generated(planner) => Some(planner),
            ActivePlan::None | ActivePlan::PdmClosed => None,
        }
    }

    /// Seconds that the path of a planner is laid for.
    fn path_s(&self) -> f64 {
        self.settings.horizon_s.max(PLAN_STEPS as f64 * STEP_S)
    }

    /// One planning call: everything from the scene to the planner that drives from now on.
    fn call(&mut self, iteration: usize, scene: &SceneView<'_>) -> Result<(), PlannerError> {
        let started = Instant::now();
        if let Some(gate) = self.settings.gate
            && let Some(score) = predicted_score(scene, &mut self.memory)?.filter(|&score| score >= gate)
        {
            self.active_plan = ActivePlan::PdmClosed;
            self.calls.push(PlanningCall::without_attempts(
                iteration,
                Decision::Gated(score),
                milliseconds(started.elapsed()),
            ));
            return Ok(());
        }
        let deadline = self.settings.deadline.map_or(Deadline::NONE, |limit| Deadline::after(started, limit));
        let graph = match LaneGraph::build(scene, self.settings.node_length_m) {
            Ok(graph) => graph,
            Err(error) => {
                let decision = self.without_plan(NoPlan::NoLaneGraph(error.to_string()));
                self.calls.push(PlanningCall::without_attempts(iteration, decision, milliseconds(started.elapsed())));
                return Ok(());
            }
        };
        if self.settings.latency != Latency::None && self.active_plan == ActivePlan::None {
            self.active_plan = keep_lane_and_speed(scene, &graph, self.settings.lead_policy, self.path_s())?;
        }
        let scenario = self.look(scene, &graph)?;
        let environment_ms = milliseconds(started.elapsed());
        let thinking = self.think(iteration, scene, &graph, &scenario, deadline)?;
        let decision = self.decide(&thinking);
        let mut planner = match decision {
            Decision::Execute(index) | Decision::Exhausted(index) => thinking.planners.into_iter().nth(index).flatten(),
            _ => None,
        };
        let mut aborted_lane_change = None;
        if let (Decision::Exhausted(_), AfterMaxExec::Best, Some(refused)) =
            (&decision, self.settings.after_max_exec, &planner)
            && self.begins_lane_change(refused, scene, &graph)
            && let Some(back) = back_to_own_lane(refused, scene, &graph, self.settings.lead_policy, self.path_s())?
        {
            planner = Some(back);
            aborted_lane_change = Some(iteration);
        }
        let total_ms = milliseconds(started.elapsed());
        let image_hash = PromptPrefix { system: String::new(), image: scenario.image.clone() }.image_hash();
        self.calls.push(PlanningCall {
            iteration,
            image: scenario.image,
            image_hash,
            scene_text: scenario.text,
            attempts: thinking.attempts,
            decision,
            emergency_brakes: 0,
            aborted_lane_change,
            active_from: None,
            environment_ms,
            total_ms,
        });
        match (self.settings.latency.iterations(total_ms), planner) {
            (Some(lasts), planner) if lasts > 0 => {
                self.underway = Some(Underway { arrives: iteration + lasts, planner });
                self.active_plan.follow_on(scene, &graph, self.path_s())
            }
            (_, Some(planner)) => {
                self.active_plan = ActivePlan::Generated(Box::new(planner));
                Ok(())
            }
            (_, None) => self.active_plan.follow_on(scene, &graph, self.path_s()),
        }
    }

    /// Lets the planner of a call that has lasted long enough take over.
    fn arrive(&mut self, iteration: usize, scene: &SceneView<'_>) -> Result<(), PlannerError> {
        let Some(underway) = self.underway.take_if(|underway| underway.arrives <= iteration) else { return Ok(()) };
        let Some(planner) = underway.planner else { return Ok(()) };
        self.active_plan = ActivePlan::Generated(Box::new(planner));
        self.note(|call| call.active_from = Some(iteration));
        self.go_on(scene)
    }

    /// Lengthens the path of the planner in force from where the ego is now, if there is a lane graph.
    fn go_on(&mut self, scene: &SceneView<'_>) -> Result<(), PlannerError> {
        let graph = LaneGraph::build(scene, self.settings.node_length_m);
        graph.map_or(Ok(()), |graph| self.active_plan.follow_on(scene, &graph, self.path_s()))
    }

    /// The Environment Transformation: what the model is shown.
    fn look(&self, scene: &SceneView<'_>, graph: &LaneGraph) -> Result<ScenarioPrompt, PlannerError> {
        let form =
            self.code_source.prompts().map(|prompts| prompts.forms().scene_text).filter(|_| self.settings.lane_graph);
        let image = match (self.settings.view_m, self.code_source.image_size()) {
            (Some(metres), Some(pixels)) => {
                let view = BevView::new(pixels, metres)
                    .map_err(|e| PlannerError::Failed { doing: "drawing the BEV map", source: Box::new(e) })?;
                Some(if self.settings.shuffled_bev {
                    shuffled_bev::render(self.settings.seed ^ scene.ego.time_us as u64, &view)
                        .map_err(|e| PlannerError::Failed { doing: "finding another scene", source: Box::new(e) })?
                } else {
                    bev::render(scene, &view)
                })
            }
            _ => None,
        };
        Ok(ScenarioPrompt {
            image,
            text: form.map(|form| text::write(&Description::of(graph), form)),
            names: names(graph),
            legend: bev::Palette::legend(),
        })
    }

    /// Attempts until one is accepted, `max_exec` are made, or the call is interrupted.
    fn think(
        &mut self,
        iteration: usize,
        scene: &SceneView<'_>,
        graph: &LaneGraph,
        scenario: &ScenarioPrompt,
        deadline: Deadline,
    ) -> Result<Thinking, PlannerError> {
        let settings = &self.settings;
        let seed = settings.call_seed(iteration);
        let failed = |doing| move |error| PlannerError::Failed { doing, source: Box::new(error) };
        let mut thoughts = self
            .code_source
            .open(scenario, graph, (seed, deadline), settings.max_exec)
            .map_err(failed("opening the conversation"))?;
        let looking = Instant::now();
        let judge = if settings.reflect {
            Some(Judge::new(scene, graph, settings.horizon_s, &mut self.memory).map_err(reflection_failed)?)
        } else {
            None
        };
        // What all attempts are judged against is looked at once; the first attempt's reflection bears its time.
        let mut looked_ms = milliseconds(looking.elapsed());
        let mut thinking = Thinking::default();
        let mut needed = settings.threshold;
        while (thinking.attempts.len() < settings.max_exec || self.code_source.compares())
            && thinking.interruption.is_none()
        {
            let feedback = thinking.attempts.last().map(|last| last.feedback(needed));
            let trace = thoughts.next(feedback.as_ref()).map_err(failed("asking the model"))?;
            let Some(mut trace) = trace else { break };
            thinking.interruption = trace.interruption.take();
            if trace.rounds.is_empty() && thinking.interruption.is_some() {
                break;
            }
            let started = Instant::now();
            let (planner, errors) = self.build(scene, graph, &trace)?;
            let reflection = match (&judge, &planner) {
                (Some(judge), Some(planner)) => {
                    needed = self.threshold_of(planner, scene, graph);
                    Some(judge.reflect(planner, needed).map_err(reflection_failed)?)
                }
                _ => None,
            };
            let accepted = planner.is_some() && reflection.as_ref().is_none_or(|r| r.verdict == Verdict::Execute);
            let reflection_ms = std::mem::take(&mut looked_ms) + milliseconds(started.elapsed());
            let attempt = attempt(trace, errors, planner.as_ref(), reflection, reflection_ms);
            if self.code_source.compares() {
                thinking.keep_better(attempt, planner);
                continue;
            }
            thinking.attempts.push(attempt);
            thinking.planners.push(planner);
            if accepted {
                return Ok(thinking);
            }
        }
        if let (AfterMaxExec::Best, Some(judge), ActivePlan::Generated(planner)) =
            (settings.after_max_exec, &judge, &self.active_plan)
        {
            let planner = followed_on(planner, scene, graph, self.path_s())?;
            thinking.active_plan = Some(judge.reflect(&planner, settings.threshold).map_err(reflection_failed)?.score);
        }
        Ok(thinking)
    }

    /// λ of a planner: higher where a change of lanes would begin with it.
    fn threshold_of(&self, planner: &IdmPlan, scene: &SceneView<'_>, graph: &LaneGraph) -> f64 {
        let PlanAgentSettings { threshold, lane_change_threshold, .. } = self.settings;
        if self.begins_lane_change(planner, scene, graph) { threshold.max(lane_change_threshold) } else { threshold }
    }

    /// Whether a planner is bound for another lane than the ego's and the planner in force.
    fn begins_lane_change(&self, planner: &IdmPlan, scene: &SceneView<'_>, graph: &LaneGraph) -> bool {
        let bound_for = planner.lane_now(scene);
        !graph.ego_lane().path.lanes.contains(&bound_for)
            && self.active_plan().is_none_or(|active_plan| active_plan.lane_now(scene) != bound_for)
    }

    /// The planner that a thought means, with everything that was wrong with the answer.
    fn build(
        &self,
        scene: &SceneView<'_>,
        graph: &LaneGraph,
        trace: &ReasoningTrace,
    ) -> Result<(Option<IdmPlan>, Vec<ParseError>), PlannerError> {
        let errors = trace.parsed.errors.clone();
        let Some(code) = trace.parsed.code.clone() else { return Ok((None, errors)) };
        let planner = build_idm_plan(scene, graph, code, self.settings.lead_policy, self.path_s())?;
        Ok((planner, errors))
    }

    fn decide(&self, thinking: &Thinking) -> Decision {
        let Thinking { attempts, planners, interruption, active_plan } = thinking;
        let score = |i: usize| attempts[i].reflection.as_ref().map_or(0.0, |r| r.score);
        let usable: Vec<usize> = (0..attempts.len()).filter(|&i| planners[i].is_some()).collect();
        let accepted = usable
            .iter()
            .copied()
            .find(|&i| attempts[i].reflection.as_ref().is_none_or(|r| r.verdict == Verdict::Execute));
        let refused = match self.settings.after_max_exec {
            AfterMaxExec::Last => usable.last().copied(),
            AfterMaxExec::Best => usable.iter().copied().rev().max_by(|&a, &b| score(a).total_cmp(&score(b))),
        };
        match (accepted, interruption, refused) {
            (Some(index), ..) => Decision::Execute(index),
            (None, Some(why), _) => self.without_plan(NoPlan::Interrupted(why.clone())),
            (None, None, Some(index)) if active_plan.is_some_and(|active_plan| active_plan > score(index)) => {
                Decision::KeepActivePlan(NoPlan::Worse)
            }
            (None, None, Some(index)) => Decision::Exhausted(index),
            (None, None, None) => self.without_plan(NoPlan::Unreadable),
        }
    }

    /// The planner in force drives as it was written; the emergency brake may overrule it.
    fn control_unmonitored(&mut self, input: &PlannerInput<'_>) -> Result<Trajectory, PlannerError> {
        let ego = input.scene.ego;
        let planner = match &self.active_plan {
            ActivePlan::Generated(planner) => &**planner,
            ActivePlan::PdmClosed => return self.drive_by_rules(&input.scene),
            ActivePlan::None => return Ok(brake(ego)?),
        };
        let rollout = planner.roll_out(&input.scene, PLAN_STEPS);
        if self.settings.emergency_brake && needs_emergency_brake(&input.scene, &rollout, &mut self.memory) {
            self.note(|call| call.emergency_brakes += 1);
            return Ok(emergency_brake(ego, PLAN_STEPS)?);
        }
        Ok(rollout.to_trajectory(ego)?)
    }

    /// Of the planner in force that version drives which Reflection chooses. Where a change of lanes has come to need hard braking or
    /// to score less than λ and the ego's present lane is better, the ego stays there until the next call.
    fn control_monitored(&mut self, input: &PlannerInput<'_>) -> Result<Trajectory, PlannerError> {
        let scene = &input.scene;
        let planner = match &self.active_plan {
            ActivePlan::Generated(planner) => &**planner,
            ActivePlan::PdmClosed => return self.drive_by_rules(scene),
            ActivePlan::None => return Ok(brake(scene.ego)?),
        };
        let monitor = self.settings.monitor();
        let mut driving = monitored_step(planner, scene, &monitor, &mut self.memory)?;
        if (driving.brakes || driving.score < monitor.threshold)
            && let Some((back, instead)) = self.aborted_lane_change(scene, &monitor)?
            && instead.is_better_than(&driving)
        {
            driving = instead;
            self.active_plan = ActivePlan::Generated(Box::new(back));
            self.note(|call| call.aborted_lane_change = Some(input.iteration));
        }
        if driving.brakes {
            self.note(|call| call.emergency_brakes += 1);
        }
        Ok(driving.trajectory)
    }

    /// The planner in force, back in the ego's present lane, and how it would drive on there; `None` when it is bound for that lane.
    fn aborted_lane_change(
        &mut self,
        scene: &SceneView<'_>,
        monitor: &PlanMonitor,
    ) -> Result<Option<(IdmPlan, MonitoredStep)>, PlannerError> {
        let ActivePlan::Generated(planner) = &self.active_plan else { return Ok(None) };
        let Ok(graph) = LaneGraph::build(scene, self.settings.node_length_m) else { return Ok(None) };
        let back = back_to_own_lane(planner, scene, &graph, self.settings.lead_policy, self.path_s())?;
        let Some(back) = back else { return Ok(None) };
        let driving = monitored_step(&back, scene, monitor, &mut self.memory)?;
        Ok(Some((back, driving)))
    }

    fn drive_by_rules(&mut self, scene: &SceneView<'_>) -> Result<Trajectory, PlannerError> {
        Ok(pdm::plan(&mut self.memory, scene).map_err(pdm_failed)?.trajectory)
    }

    /// Writes into the record of the last planning call.
    fn note(&mut self, write: impl FnOnce(&mut PlanningCall)) {
        self.calls.last_mut().map(write);
    }

    /// What happens when a call gives no planner.
    fn without_plan(&self, why: NoPlan) -> Decision {
        match &self.active_plan {
            ActivePlan::Generated(_) | ActivePlan::PdmClosed => Decision::KeepActivePlan(why),
            ActivePlan::None => Decision::Brake(why),
        }
    }
}

impl Planner for PlanAgent {
    fn name(&self) -> &str {
        self.name.as_str()
    }

    fn calls(&self) -> &[PlanningCall] {
        &self.calls
    }

    fn initialize(&mut self, _: &PlannerInitialization<'_>) -> Result<(), PlannerError> {
        (self.active_plan, self.underway) = (ActivePlan::None, None);
        self.memory = PdmMemory::default();
        self.calls.clear();
        Ok(())
    }

    fn compute_trajectory(&mut self, input: &PlannerInput<'_>) -> Result<Trajectory, PlannerError> {
        self.arrive(input.iteration, &input.scene)?;
        if input.iteration.is_multiple_of(self.settings.interval) {
            match self.underway {
                Some(_) => self.go_on(&input.scene)?,
                None => self.call(input.iteration, &input.scene)?,
            }
        }
        if self.settings.monitoring && self.settings.reflect {
            self.control_monitored(input)
        } else {
            self.control_unmonitored(input)
        }
    }
}

/// The names that planner code may use in a scene.
pub fn names(graph: &LaneGraph) -> Names {
    Names {
        centerlines: graph.centerlines.iter().map(|centerline| centerline.name.to_string()).collect(),
        lead_agents: graph.agents.iter().map(|agent| agent.name.to_string()).collect(),
        speed_limit: graph.ego_lane().speed_limit.map(|limit| limit.round() as u32),
    }
}

/// The planner that a code means in a scene; `None` when its names are not of this scene.
///
/// # Errors
/// When the ego's pose is not finite.
pub fn build_idm_plan(
    scene: &SceneView<'_>,
    graph: &LaneGraph,
    code: PlannerCode,
    lead_policy: LeadPolicy,
    horizon_s: f64,
) -> Result<Option<IdmPlan>, PlannerError> {
    let centerline = code.centerline.parse::<CenterlineName>().ok().and_then(|name| graph.centerline(name));
    let Some(centerline) = centerline else { return Ok(None) };
    let lead_agent = match lead_policy {
        LeadPolicy::Named => {
            code.lead_agent.as_ref().and_then(|name| name.parse::<AgentName>().ok()).and_then(|name| graph.agent(name))
        }
        LeadPolicy::Nearest => centerline.lead_agent.and_then(|name| graph.agent(name)),
    };
    let lead_agent = lead_agent.map(|agent| agent.token);
    IdmPlan::new(scene, code, centerline.path.clone(), lead_agent, lead_policy, horizon_s)
        .map(Some)
        .map_err(|e| PlannerError::Failed { doing: "laying the path of the planner", source: Box::new(e) })
}

pub(super) fn reflection_failed(error: crate::reflection::ReflectionError) -> PlannerError {
    PlannerError::Failed { doing: "reflecting on the planner", source: Box::new(error) }
}

fn attempt(
    trace: ReasoningTrace,
    errors: Vec<ParseError>,
    planner: Option<&IdmPlan>,
    reflection: Option<ReflectionReport>,
    reflection_ms: f64,
) -> Attempt {
    Attempt {
        rounds: trace.rounds,
        instruction: trace.instruction,
        code: trace.parsed.code,
        assistance: None,
        errors,
        reflection,
        path: planner.map_or_else(Vec::new, |planner| planner.path().vertex_poses()),
        reflection_ms,
    }
}

/// Straight ahead, braking to a stop.
///
/// # Errors
/// When the ego's state is not finite.
fn brake(ego: &crate::world::EgoState) -> Result<Trajectory, crate::world::TrajectoryError> {
    use crate::world::{STEP_US, TrajectoryState};
    let mut speed = ego.velocity.x.max(0.0);
    let mut way = 0.0;
    let mut states = vec![TrajectoryState::from(ego)];
    for step in 1..=PLAN_STEPS {
        way += speed * STEP_S;
        speed = (speed - BRAKE * STEP_S).max(0.0);
        let pose: Pose = ego.rear_axle.translated(way, 0.0);
        states.push(TrajectoryState::moving(ego.time_us + step as i64 * STEP_US, pose, speed, -BRAKE));
    }
    Trajectory::new(states)
}
