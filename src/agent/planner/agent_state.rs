//! The state that an agent's layers share: the active plan, PDM's memory, and the records of
//! planning calls.

use super::clock::Clock;
use super::code_question::begins_lane_change;
use super::record::{Decision, NoPlan, PlanningCall};
use super::{PlanAgentSettings, PlannerError, PlannerName};
use crate::environment::lane_graph::ReturnLane;
use crate::environment::{GraphedScene, LaneGraph, LaneGraphError};
use crate::reflection::{IdmPlan, PlanBuilder};
use planagent_score::pdm::PdmMemory;
use planagent_world::SceneView;

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
    /// Shared by the gate, Reflection and the emergency brake: the objects that the ego has
    /// touched, and the reference path of the last planning call.
    pub(super) memory: PdmMemory,
    pub(super) calls: Vec<PlanningCall>,
    pub(super) clock: Clock,
    pub(super) builder: PlanBuilder,
    interval_s: f64,
    blocked_interval_s: f64,
    node_length_m: f64,
    /// Whether its codes may name the oncoming lane.
    oncoming_lane: bool,
    /// The lane that it left to pass what blocked it.
    return_lane: Option<ReturnLane>,
}

impl AgentState {
    pub(super) fn new(name: PlannerName, settings: &PlanAgentSettings) -> Self {
        Self {
            name,
            active: ActivePlan::None,
            memory: PdmMemory::default(),
            calls: Vec::new(),
            clock: Clock::default(),
            builder: settings.reflection.plan_builder(),
            interval_s: settings.agent.interval_s,
            blocked_interval_s: settings.agent.blocked_interval_s,
            node_length_m: settings.environment.node_length_m,
            oncoming_lane: false,
            return_lane: None,
        }
    }

    pub(super) fn naming_oncoming_lane(self, oncoming_lane: bool) -> Self {
        Self {
            oncoming_lane,
            ..self
        }
    }

    pub(super) fn reset(&mut self) {
        (self.active, self.memory) = (ActivePlan::None, PdmMemory::default());
        (self.calls, self.clock, self.return_lane) = (Vec::new(), Clock::default(), None);
    }

    /// The generated plan that is active.
    pub fn active_plan(&self) -> Option<&IdmPlan> {
        match &self.active {
            ActivePlan::Generated(plan) => Some(plan),
            ActivePlan::None | ActivePlan::PdmClosed => None,
        }
    }

    /// Whether the next step, in this scene, begins with a planning call.
    pub fn begins_with_call(&self, scene: &SceneView<'_>) -> bool {
        let mut clock = self.clock.clone();
        clock.step(scene.ego.time_us);
        self.is_due(&clock, scene)
    }

    /// Whether this step, in this scene, begins with a planning call.
    pub(super) fn is_call_due(&self, scene: &SceneView<'_>) -> bool {
        self.is_due(&self.clock, scene)
    }

    fn is_due(&self, clock: &Clock, scene: &SceneView<'_>) -> bool {
        let is_obstructed = || {
            self.lane_graph(scene)
                .is_ok_and(|graph| graph.is_obstructed())
        };
        clock.is_due(self.interval_s) || (clock.is_due(self.blocked_interval_s) && is_obstructed())
    }

    /// Makes a planning call due at the next step.
    pub fn request_call(&mut self) {
        self.clock.set_due();
    }

    pub(super) fn lane_graph(&self, scene: &SceneView<'_>) -> Result<LaneGraph, LaneGraphError> {
        let graph = LaneGraph::build(scene, self.node_length_m)?;
        let graph = if self.oncoming_lane {
            graph.with_oncoming_lane(scene)
        } else {
            graph
        };
        Ok(match &self.return_lane {
            Some(lane) => graph.with_return_lane(scene, lane),
            None => graph,
        })
    }

    /// Remembers the ego's lane where it leaves that to pass what blocks it, and forgets it when
    /// the ego is back.
    pub(super) fn note_lane_change(&mut self, plan: &IdmPlan, seen: GraphedScene<'_>) {
        self.return_lane.take_if(|lane| lane.is_reached(seen));
        if plan.oncoming().is_none() && begins_lane_change(plan, seen, self) {
            self.return_lane = ReturnLane::from_graph(seen.graph).or(self.return_lane.take());
        }
    }

    /// The generated plan that is active, and the lane graph, where there is one.
    pub(super) fn plan_and_graph(&self, scene: &SceneView<'_>) -> Option<(&IdmPlan, LaneGraph)> {
        self.active_plan().zip(self.lane_graph(scene).ok())
    }

    /// Extends the path of the active plan from the ego's present place, if there is a lane graph.
    pub(super) fn extend(&mut self, scene: &SceneView<'_>) -> Result<(), PlannerError> {
        if let Some((plan, graph)) = self.plan_and_graph(scene) {
            self.active = self
                .builder
                .extend(plan, GraphedScene::new(scene, &graph))?
                .into();
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
