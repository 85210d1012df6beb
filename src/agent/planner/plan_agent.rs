//! The agent of the paper. A planning call transforms the environment, reasons, and reflects on the
//! plan of each attempt; the plan is executed until the next call.

use super::agent_state::{ActivePlan, AgentState};
use super::attempts::{AttemptLimits, Attempts};
use super::code_question::{CodeQuestion, begins_lane_change};
use super::code_source::CodeSource;
use super::codes::{codes_past, codes_to_goal, further_codes};
use super::language_agent::{CallTerms, LanguageAgent, Shown, planning_call};
use super::layer::AgentLayer;
use super::layered::with_layers;
use super::model_input::ModelInput;
use super::record::{Attempt, Decision, NoPlan, PlanningCall};
use super::settings::{AfterMaxExec, PlanAgentSettings, ReflectionSettings};
use super::stop::comfortable_stop;
use super::{BevSource, PlannerError, PlannerInput, PlannerName};
use crate::environment::lane_graph::GoalLane;
use crate::environment::{CenterlineName, GraphedScene, LaneGraph, LaneGraphError};
use crate::reasoning::{AnswerHistory, PlannerAnswer, ScenarioPrompt};
use crate::reflection::{IdmPlan, needs_emergency_brake};
use planagent_mllm::milliseconds;
use planagent_score::pdm::{TRAJECTORY_STEPS, emergency_brake, plan};
use planagent_world::{SceneView, Trajectory};
use std::time::Instant;

/// PlanAgent: Environment Transformation, Reasoning Engine and Reflection in one planner.
pub struct PlanAgent {
    state: AgentState,
    source: CodeSource,
    settings: PlanAgentSettings,
    shuffled_bev: Option<BevSource>,
    history: AnswerHistory,
}

impl PlanAgent {
    /// The paper's loop. Gate, latency and monitoring are layers around it: [`Self::layered`].
    pub fn new(name: PlannerName, source: CodeSource, settings: PlanAgentSettings) -> Self {
        Self {
            state: AgentState::new(name, &settings).naming_oncoming_lane(
                source.names_oncoming_lane(settings.environment.oncoming_lane),
            ),
            source,
            settings,
            shuffled_bev: None,
            history: AnswerHistory::default(),
        }
    }

    /// The same with a source of BEV images of other scenes, for the ablation that shows them.
    #[must_use]
    pub fn with_shuffled_bev(mut self, source: Option<BevSource>) -> Self {
        self.shuffled_bev = source;
        self
    }

    /// The agent with the layers that its settings ask for.
    pub fn layered(self) -> Box<dyn AgentLayer> {
        let settings = self.settings.clone();
        with_layers(Box::new(self), &settings)
    }

    /// Whether a refused plan may leave the ego's lane: something blocks that lane, other lanes are
    /// tried there, and the plan scores λ. Staying needs more than λ, too, so the better of both is
    /// executed.
    /// Why: docs/decisions/132-past-at-once.md.
    fn may_leave(&self, graph: &LaneGraph, refused: Option<&Attempt>) -> bool {
        self.settings.reflection.further_codes
            && graph.stop_point().is_some()
            && refused
                .and_then(|attempt| attempt.reflection.as_ref())
                .is_some_and(|report| report.score >= self.settings.reflection.threshold)
    }
}

impl LanguageAgent for PlanAgent {
    type Observation<'a> = ScenarioPrompt;
    type Plan = IdmPlan;

    fn settings(&self) -> &PlanAgentSettings {
        &self.settings
    }

    fn lane_graph(&self, scene: &SceneView<'_>) -> Result<LaneGraph, LaneGraphError> {
        self.state.lane_graph(scene)
    }

    fn observe(&mut self, seen: GraphedScene<'_>) -> Result<ScenarioPrompt, PlannerError> {
        let input = ModelInput {
            planner: self.state.name,
            source: &self.source,
            settings: &self.settings,
            shuffled_bev: self.shuffled_bev.as_ref(),
        };
        input.scenario_prompt(seen)
    }

    fn shown(&self, prompt: &ScenarioPrompt) -> Shown {
        Shown {
            image: prompt.image.clone(),
            text: prompt.text.clone(),
            forms: self.source.prompts().map(|prompts| *prompts.forms()),
        }
    }

    /// Reasoning and Reflection. The active plan is a rival where it may be kept instead of a
    /// refused one.
    fn attempts(
        &mut self,
        prompt: &ScenarioPrompt,
        seen: GraphedScene<'_>,
        terms: CallTerms,
    ) -> Result<Attempts<IdmPlan>, PlannerError> {
        let Self {
            state,
            source,
            settings,
            history,
            ..
        } = self;
        let GraphedScene { scene, graph } = seen;
        let ReflectionSettings {
            threshold,
            lane_change_threshold,
            max_exec,
            ..
        } = settings.reflection;
        let takes_best = settings.reflection.after_max_exec == AfterMaxExec::Best;
        let codes = source.open(prompt, graph, terms, max_exec, history)?;
        let started = Instant::now();
        let judge = if settings.reflection.enabled {
            Some(settings.reflection.judge(scene, graph, &mut state.memory)?)
        } else {
            None
        };
        let observation_ms = milliseconds(started.elapsed());
        let thresholds = (threshold, lane_change_threshold);
        let mut question = CodeQuestion {
            codes,
            seen,
            judge: judge.as_ref(),
            state,
            thresholds,
        };
        let limits = AttemptLimits {
            max_exec,
            threshold,
            compares: source.compares(),
        };
        let mut attempts = Attempts::make(&mut question, limits, observation_ms)?;
        if settings.reflection.further_codes && takes_best && attempts.interruption.is_none() {
            if attempts.are_refused() {
                attempts.try_further(&mut question, further_codes(graph))?;
            }
            if judge.is_some() && !leaves_lane(attempts.accepted_answer()) {
                attempts.try_further(&mut question, codes_past(graph))?;
            }
            if let (Some(goal), Some(_)) = (graph.goal, &judge)
                && !is_towards(goal, attempts.accepted_answer())
            {
                // Nobody asked for this change, so it needs what other lane changes do.
                question.thresholds.0 = threshold.max(lane_change_threshold);
                attempts.try_further(&mut question, codes_to_goal(graph, goal))?;
            }
        }
        // Judged only where all attempts are refused: else the active plan ends anyway.
        if let (Some(judge), Some(active)) = (&judge, state.active_plan())
            && attempts.accepted().is_none()
            && takes_best
        {
            let extended = state.builder.extend(active, seen)?;
            attempts.rival = Some(judge.reflect(&extended, threshold)?.behaviors.expected);
        }
        Ok(attempts)
    }

    fn decide(&self, attempts: &Attempts<IdmPlan>) -> Decision {
        let refused = attempts.refused(self.settings.reflection.after_max_exec);
        match (attempts.accepted(), &attempts.interruption, refused) {
            (Some(index), ..) => Decision::Execute(index),
            (None, Some(why), _) => self.without_plan(NoPlan::Interrupted(why.clone())),
            (None, None, Some(index))
                if attempts
                    .rival
                    .is_some_and(|active| active > attempts.expected_score(index)) =>
            {
                Decision::KeepActivePlan(NoPlan::Worse)
            }
            (None, None, Some(index)) => Decision::Exhausted(index),
            (None, None, None) => self.without_plan(NoPlan::Unreadable(attempts.unreadable())),
        }
    }

    fn without_plan(&self, why: NoPlan) -> Decision {
        self.state.keep_or_brake(why)
    }

    /// A refused plan that becomes active after the last attempt begins no lane change but out of a
    /// blocked lane: its code is executed in the ego's lane.
    /// Why: docs/decisions/102-lane-change-threshold.md.
    fn settle(
        &mut self,
        mut plan: IdmPlan,
        call: &mut PlanningCall,
        seen: GraphedScene<'_>,
    ) -> Result<IdmPlan, PlannerError> {
        if matches!(call.decision, Decision::Exhausted(_))
            && self.settings.reflection.after_max_exec == AfterMaxExec::Best
            && !self.may_leave(seen.graph, call.accepted())
            && begins_lane_change(&plan, seen, &self.state)
            && let Some(back) = self.state.builder.back_to_ego_lane(&plan, seen)?
        {
            (plan, call.aborted_lane_change) = (back, Some(call.iteration));
        }
        self.state.note_lane_change(&plan, seen);
        Ok(plan)
    }
}

/// Whether an answer is a code for another lane.
fn leaves_lane(answer: Option<PlannerAnswer>) -> bool {
    matches!(answer, Some(PlannerAnswer::Code(code)) if code.centerline != CenterlineName::EgoLane)
}

/// Whether an answer is a code that begins the way to the goal's lane.
fn is_towards(goal: GoalLane, answer: Option<PlannerAnswer>) -> bool {
    matches!(answer, Some(PlannerAnswer::Code(code)) if goal.is_towards(code.centerline.lane_changes()))
}

impl AgentLayer for PlanAgent {
    fn state(&self) -> &AgentState {
        &self.state
    }

    fn state_mut(&mut self) -> &mut AgentState {
        &mut self.state
    }

    fn reset(&mut self) {
        self.state.reset();
        self.history = AnswerHistory::default();
    }

    fn advance(&mut self, _: &PlannerInput<'_>) -> Result<(), PlannerError> {
        Ok(())
    }

    fn plan(
        &mut self,
        input: &PlannerInput<'_>,
        started: Instant,
    ) -> Result<Option<ActivePlan>, PlannerError> {
        let at_s = self.state.clock.elapsed_s(input.scene.ego.time_us);
        let (call, plan) = planning_call(self, input, at_s, started)?;
        self.state.calls.push(call);
        Ok(plan.map(ActivePlan::from))
    }

    /// The active plan as the model wrote it; the emergency brake may overrule it.
    fn execute(&mut self, input: &PlannerInput<'_>) -> Result<Trajectory, PlannerError> {
        let (scene, state) = (&input.scene, &mut self.state);
        let active = match &state.active {
            ActivePlan::Generated(active) => active,
            ActivePlan::PdmClosed => return Ok(plan(&mut state.memory, scene)?.trajectory),
            ActivePlan::None => return Ok(comfortable_stop(scene.ego, TRAJECTORY_STEPS)?),
        };
        let rollout = active.roll_out(scene, TRAJECTORY_STEPS);
        if self.settings.reflection.emergency_brake
            && needs_emergency_brake(scene, &rollout, &mut state.memory)
        {
            state.note(|call| call.emergency_brakes += 1);
            return Ok(emergency_brake(scene.ego, TRAJECTORY_STEPS)?);
        }
        Ok(rollout.to_trajectory(scene.ego)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::environment::DEFAULT_NODE_LENGTH;
    use planagent_world::geometry::Pose;
    use planagent_world::{LaneId, ObjectKind, Scene};

    /// A code for the left lane.
    const LEAVES: &str = "Generate_IDM_Planner(c=left_lane, la=None, v0=15, acc=1.5, dec=3)";

    /// The first planning call of an agent whose model answers with this code, and the plan that
    /// becomes active.
    fn called(
        scene: &Scene,
        code: &str,
        settings: PlanAgentSettings,
    ) -> (PlanningCall, Option<ActivePlan>) {
        let source = CodeSource::Written(code.to_owned());
        let mut agent = PlanAgent::new(PlannerName::PLAN_AGENT, source, settings);
        let input = PlannerInput {
            iteration: 0,
            scene: scene.view(),
        };
        let plan = agent.plan(&input, Instant::now()).unwrap();
        (agent.state.calls.pop().unwrap(), plan)
    }

    /// What a plan for the left lane must score, where an object 30 m ahead stands beside the middle
    /// of the ego's lane, or moves along it.
    fn needed_to_leave(kind: ObjectKind, beside: f64, speed: f64) -> f64 {
        let scene = Scene::builder()
            .lanes(2, [[-50.0, 0.0], [250.0, 0.0]])
            .ego([0.0, -3.5], 0.0, 8.0)
            .object(kind, [30.0, -3.5 + beside], 0.0, speed)
            .build()
            .unwrap();
        let (call, _) = called(&scene, LEAVES, PlanAgentSettings::default());
        call.attempts[0].reflection.as_ref().unwrap().threshold
    }

    #[test]
    fn a_lane_is_left_for_what_blocks_it_or_is_slow_or_may_step_into_it() {
        use ObjectKind::{Pedestrian, Vehicle};
        let usual = PlanAgentSettings::default()
            .reflection
            .lane_change_threshold;
        for (kind, beside, speed) in [
            (Vehicle, 0.0, 0.0),
            (Vehicle, 0.0, 1.0),
            (Pedestrian, -3.0, 0.0),
        ] {
            let needed = needed_to_leave(kind, beside, speed);
            assert!((needed - usual).abs() < 1e-9, "{kind} {speed}: {needed}");
        }
        for (kind, beside) in [(Vehicle, -1.4), (Vehicle, -3.0), (Pedestrian, -6.0)] {
            let needed = needed_to_leave(kind, beside, 0.0);
            assert!(needed > 1.0, "{kind} {beside}: {needed}");
        }
    }

    /// The code that drives, and whether the model was asked for it, where the model keeps the right
    /// one of two lanes, and the goal's lane is the left one.
    fn driven(has_goal: bool, further_codes: bool, beside: Option<(f64, f64)>) -> (String, bool) {
        let mut scene =
            Scene::builder()
                .lanes(2, [[-50.0, 0.0], [250.0, 0.0]])
                .ego([0.0, -3.5], 0.0, 8.0);
        if let Some((x, speed)) = beside {
            scene = scene.vehicle([x, 0.0], 0.0, speed);
        }
        let mut scene = scene.build().unwrap();
        if has_goal {
            scene.route.goal = Some(Pose::new(200.0, 0.0, 0.0));
            scene.route.goal_lane = Some(LaneId(0));
        }
        let mut settings = PlanAgentSettings::default();
        settings.reflection.further_codes = further_codes;
        let code = "Generate_IDM_Planner(c=ego_lane, la=None, v0=12, acc=1.5, dec=3)";
        let (call, _) = called(&scene, code, settings);
        let driven = call.accepted().unwrap();
        (driven.answer.unwrap().to_string(), driven.is_asked)
    }

    #[test]
    fn an_agent_changes_to_the_goals_lane_also_where_the_model_does_not() {
        let (kept, left) = ("c=ego_lane", "c=left_lane");
        for (has_goal, further_codes) in [(false, true), (true, false)] {
            let (code, is_asked) = driven(has_goal, further_codes, None);
            assert!(code.contains(kept) && is_asked, "{code}");
        }
        let (free, is_asked) = driven(true, true, None);
        assert!(free.contains(left) && !is_asked, "{free}");
        for beside in [(0.0, 8.0), (9.0, 6.0)] {
            let (code, _) = driven(true, true, Some(beside));
            assert!(
                code.contains(kept),
                "{beside:?}: the ego would brake, {code}"
            );
        }
    }

    /// The code that drives, and whether the source was asked for it, where the source waits behind a
    /// broken-down car on the only lane of its direction. By default it may name the oncoming lane.
    fn waits(limit: f64, further_codes: bool, comes: bool) -> (String, bool) {
        let mut scene = Scene::builder()
            .speed_limit(limit)
            .lane([[-200.0, 0.0], [300.0, 0.0]])
            .lane([[300.0, 3.5], [-200.0, 3.5]])
            .ego([0.0, 0.0], 0.0, 0.0)
            .vehicle([17.5, 0.0], 0.0, 0.0);
        if comes {
            scene = scene.vehicle([70.0, 3.5], std::f64::consts::PI, 8.0);
        }
        let mut settings = PlanAgentSettings::default();
        settings.reflection.further_codes = further_codes;
        let code = "Generate_IDM_Planner(c=ego_lane, la=None, v0=12, acc=1.5, dec=3)";
        let (call, _) = called(&scene.build().unwrap(), code, settings);
        let driven = call.accepted().unwrap();
        (driven.answer.unwrap().to_string(), driven.is_asked)
    }

    #[test]
    fn an_agent_that_waits_passes_as_soon_as_it_may_and_firmly_where_that_needs_less_sight() {
        let past = |(code, is_asked): (String, bool), acc: &str| {
            assert!(!is_asked && code.contains("c=oncoming_lane"), "{code}");
            assert!(code.contains(acc), "{code}");
        };
        past(waits(13.0, true, false), "acc=1.5");
        past(waits(15.0, true, false), "acc=2,");
        for (limit, further_codes, comes) in [
            (13.0, false, false),
            (13.0, true, true),
            (28.0, true, false),
        ] {
            let (code, _) = waits(limit, further_codes, comes);
            assert!(code.contains("c=ego_lane"), "{limit} {comes}: {code}");
        }
    }

    /// Whether an agent leaves a blocked lane, and where it comes back, when no score gets its codes
    /// accepted.
    fn leaves(further_codes: bool, threshold: f64) -> (bool, Option<usize>) {
        let scene = Scene::builder()
            .lanes(3, [[-50.0, 0.0], [250.0, 0.0]])
            .ego([0.0, -7.0], 0.0, 4.0)
            .vehicle([21.5, -7.0], 0.0, 0.0)
            .build()
            .unwrap();
        let view = scene.view();
        let mut settings = PlanAgentSettings::default();
        settings.reflection.threshold = threshold;
        settings.reflection.lane_change_threshold = 1.1;
        settings.reflection.further_codes = further_codes;
        let (call, plan) = called(&scene, LEAVES, settings);
        let Some(ActivePlan::Generated(plan)) = plan else {
            panic!("the plan of a code is active");
        };
        assert!(matches!(call.decision, Decision::Exhausted(_)));
        let graph = LaneGraph::build(&view, DEFAULT_NODE_LENGTH).unwrap();
        let left = &graph.centerline(CenterlineName::LeftLane).unwrap().path;
        let beside = left.centerline.project(view.ego.center().position()).s;
        (
            plan.lane_now(&view) == left.lane_at(beside),
            call.aborted_lane_change,
        )
    }

    #[test]
    fn a_refused_plan_leaves_a_blocked_lane_where_other_lanes_are_tried_and_it_scores_lambda() {
        assert_eq!(leaves(true, 0.75), (true, None));
        assert_eq!(leaves(false, 0.75), (false, Some(0)));
        assert_eq!(leaves(true, 1.1), (false, Some(0)));
    }
}
