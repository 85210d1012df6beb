//! The state that an agent's layers share: the active plan, PDM's memory, and the records of planning calls.

use super::clock::Clock;
use super::record::{Decision, NoPlan, PlanningCall};
use super::{PlanAgentSettings, PlannerError, PlannerName};
use crate::environment::{LaneGraph, LaneGraphError};
use crate::pdm::{PdmMemory, TRAJECTORY_STEPS};
use crate::reflection::{IdmPlan, PlanBuilder};
use crate::world::{STEP_S, SceneView};

/// The plan that is executed.
#[derive(Debug, Clone, PartialEq, Default)]
pub enum ActivePlan {
    /// No plan yet: the ego brakes.
    #[default]
    None,
    /// The plan of a planner code.
    Generated(Box<IdmPlan>),
    /// PDM-Closed, along the reference path of the step at which it became active.
    PdmClosed,
}

impl From<IdmPlan> for ActivePlan {
    fn from(plan: IdmPlan) -> Self {
        Self::Generated(Box::new(plan))
    }
}

/// The state of an agent.
#[derive(Debug)]
pub struct AgentState {
    pub(super) name: PlannerName,
    pub(super) active: ActivePlan,
    /// Shared by the gate, Reflection and the emergency brake: the objects that the ego has touched, and the reference path of the
    /// last planning call.
    pub(super) memory: PdmMemory,
    pub(super) calls: Vec<PlanningCall>,
    pub(super) clock: Clock,
    pub(super) builder: PlanBuilder,
    pub(super) plan_interval_s: f64,
    node_length_m: f64,
    /// Whether its codes may name the oncoming lane.
    oncoming_lane: bool,
}

impl AgentState {
    pub(super) fn new(name: PlannerName, settings: &PlanAgentSettings) -> Self {
        let horizon_s = settings.reflection.horizon_s.max(TRAJECTORY_STEPS as f64 * STEP_S);
        Self {
            name,
            active: ActivePlan::None,
            memory: PdmMemory::default(),
            calls: Vec::new(),
            clock: Clock::default(),
            builder: PlanBuilder { lead_policy: settings.reflection.lead_policy, horizon_s },
            plan_interval_s: settings.plan_interval_s,
            node_length_m: settings.environment.node_length_m,
            oncoming_lane: false,
        }
    }

    pub(super) fn naming_oncoming_lane(self, oncoming_lane: bool) -> Self {
        Self { oncoming_lane, ..self }
    }

    pub(super) fn reset(&mut self) {
        (self.active, self.memory) = (ActivePlan::None, PdmMemory::default());
        (self.calls, self.clock) = (Vec::new(), Clock::default());
    }

    /// The generated plan that is active.
    pub fn active_plan(&self) -> Option<&IdmPlan> {
        match &self.active {
            ActivePlan::Generated(plan) => Some(plan),
            ActivePlan::None | ActivePlan::PdmClosed => None,
        }
    }

    /// Whether the next step, at this time of the scene in µs, begins with a planning call.
    pub fn is_call_due(&self, now_us: i64) -> bool {
        self.clock.clone().is_due(now_us)
    }

    /// Makes a planning call due at the next step.
    pub fn request_call(&mut self) {
        self.clock.set_due();
    }

    pub(super) fn lane_graph(&self, scene: &SceneView<'_>) -> Result<LaneGraph, LaneGraphError> {
        let graph = LaneGraph::build(scene, self.node_length_m)?;
        Ok(if self.oncoming_lane { graph.with_oncoming_lane(scene) } else { graph })
    }

    /// Extends the path of the active plan from the ego's present place, if there is a lane graph.
    pub(super) fn extend(&mut self, scene: &SceneView<'_>) -> Result<(), PlannerError> {
        if let (Some(plan), Ok(graph)) = (self.active_plan(), self.lane_graph(scene)) {
            self.active = self.builder.extend(plan, scene, &graph)?.into();
        }
        Ok(())
    }

    /// The decision of a planning call without a plan.
    pub(super) fn keep_or_brake(&self, why: NoPlan) -> Decision {
        match &self.active {
            ActivePlan::Generated(_) | ActivePlan::PdmClosed => Decision::KeepActivePlan(why),
            ActivePlan::None => Decision::Brake(why),
        }
    }

    /// Completes the record of the last planning call.
    pub(super) fn note(&mut self, write: impl FnOnce(&mut PlanningCall)) {
        self.calls.last_mut().map(write);
    }
}
