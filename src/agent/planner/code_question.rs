//! The attempts of PlanAgent: planner codes, and Reflection on their plans.

use super::PlannerError;
use super::agent_state::AgentState;
use super::attempts::{Question, Trial};
use super::code_source::Codes;
use crate::environment::{CenterlineName, GraphedScene};
use crate::reasoning::{Feedback, PlannerCode, ReasoningError, ReasoningTrace};
use crate::reflection::{IdmPlan, Judge};

/// What a plan that leaves the ego's lane must score more than the same code within it.
/// Why: docs/decisions/135-within-the-lane.md, docs/decisions/149-a-cause-to-leave.md.
const MIN_GAIN: f64 = 0.02;
/// A lead agent this much slower than a code asks for is a cause to leave the lane, m/s.
/// Why: docs/decisions/149-a-cause-to-leave.md.
const SLOWER: f64 = 1.0;

/// The planner codes of a planning call, and Reflection on their plans.
pub(super) struct CodeQuestion<'a> {
    pub(super) codes: Codes<'a>,
    pub(super) seen: GraphedScene<'a>,
    pub(super) judge: Option<&'a Judge<'a>>,
    pub(super) state: &'a AgentState,
    /// λ of plans that keep the lane or change to the goal's, and of those that begin another lane
    /// change or stay in a blocked lane that can be left.
    pub(super) thresholds: (f64, f64),
}

impl Question for CodeQuestion<'_> {
    type Answer = PlannerCode;
    type Plan = IdmPlan;

    fn ask(
        &mut self,
        feedback: Option<&Feedback>,
    ) -> Result<Option<ReasoningTrace<PlannerCode>>, ReasoningError> {
        self.codes.next(feedback)
    }

    /// Builds the plan of a code and judges it. It ends a lane change where the active plan does
    /// (docs/decisions/124-lane-changes-go-on.md). A lane change, and a plan that stays in a
    /// blocked lane, need a higher score (docs/decisions/122-before-what-stands.md).
    fn try_out(&mut self, code: PlannerCode) -> Result<Option<Trial<IdmPlan>>, PlannerError> {
        let builder = &self.state.builder;
        let GraphedScene { scene, graph } = self.seen;
        let Some(mut plan) = builder.build(self.seen, code)? else {
            return Ok(None);
        };
        if let Some(active) = self.state.active_plan() {
            plan = plan.after(active, scene, builder.horizon_s)?;
        }
        let (lane_kept, lane_changed) = self.thresholds;
        let changes_lane = begins_lane_change(&plan, self.seen, self.state);
        let is_towards_goal = graph
            .goal
            .is_some_and(|goal| goal.is_towards(code.centerline.lane_changes()));
        // Staying behind what blocks the lane is as much of a decision as leaving it.
        let stays_behind = !changes_lane
            && plan.oncoming().is_none()
            && graph.stop_point().is_some()
            && !plan.leads_past(self.seen);
        let leaves_lane = changes_lane && !is_towards_goal;
        let mut threshold = if stays_behind || leaves_lane {
            lane_kept.max(lane_changed)
        } else {
            lane_kept
        };
        if leaves_lane && let Some(within) = self.score_within_lane(code)? {
            threshold = threshold.max(within + MIN_GAIN);
        }
        let reflection = self
            .judge
            .map(|judge| judge.reflect(&plan, threshold))
            .transpose()?;
        Ok(Some(Trial {
            path: plan.path().vertex_poses(),
            plan,
            reflection,
            threshold,
        }))
    }
}

impl CodeQuestion<'_> {
    /// What a code scores within the ego's lane, where that has no cause to be left or the plan
    /// leads past what stands in it. `None` elsewhere, and without a judge.
    fn score_within_lane(&self, code: PlannerCode) -> Result<Option<f64>, PlannerError> {
        let is_obstructed = self.seen.graph.is_obstructed();
        let judge = self
            .judge
            .filter(|_| is_obstructed || !self.has_cause_to_leave(code));
        let Some(judge) = judge else {
            return Ok(None);
        };
        let code = PlannerCode {
            centerline: CenterlineName::EgoLane,
            lead_agent: None,
            ..code
        };
        let plan = self.state.builder.build(self.seen, code)?;
        let Some(plan) = plan.filter(|plan| !is_obstructed || plan.leads_past(self.seen)) else {
            return Ok(None);
        };
        Ok(Some(judge.reflect(&plan, self.thresholds.0)?.score))
    }

    /// Whether traffic in the ego's lane is slower than the code asks for, or a person may step into
    /// the lane and stop there.
    fn has_cause_to_leave(&self, code: PlannerCode) -> bool {
        let GraphedScene { scene, graph } = self.seen;
        let lead = graph.lead_agent(CenterlineName::EgoLane);
        lead.is_some_and(|lead| lead.speed < code.target_speed - SLOWER)
            || graph.has_person_near(scene)
    }
}

/// Whether a plan is bound for another lane than the ego's and the active plan's.
pub(super) fn begins_lane_change(
    plan: &IdmPlan,
    seen: GraphedScene<'_>,
    state: &AgentState,
) -> bool {
    let GraphedScene { scene, graph } = seen;
    if plan.oncoming().is_some() {
        return state
            .active_plan()
            .is_none_or(|active| active.oncoming().is_none());
    }
    let bound_for = plan.lane_now(scene);
    !graph.ego_lane().path.lanes.contains(&bound_for)
        && state
            .active_plan()
            .is_none_or(|active| active.lane_now(scene) != bound_for)
}
