//! The planner in force under Reflection's eyes, between planning calls.

use super::PlannerError;
use super::plan_agent::{PLAN_STEPS, build_idm_plan, reflection_failed};
use crate::environment::{CenterlineName, LaneGraph};
use crate::pdm::{PdmMemory, emergency_brake};
use crate::reasoning::PlannerCode;
use crate::reflection::{IdmPlan, LeadPolicy, PlanMonitor, Version};
use crate::world::{SceneView, Trajectory};

/// How a watched planner drives on.
#[derive(Debug, Clone, PartialEq)]
pub struct MonitoredStep {
    /// What drives: the version that is chosen, or the emergency brake.
    pub trajectory: Trajectory,
    /// The version's score by PDM's measure.
    pub score: f64,
    /// Whether the ego brakes hard: the version is the stop, or the emergency brake overrules it.
    pub brakes: bool,
}

impl MonitoredStep {
    /// Whether it does without hard braking where `other` does not, or else has the higher score. Scores of hard braking say little:
    /// progress is relative to versions that all collide.
    pub(super) fn is_better_than(&self, other: &Self) -> bool {
        (!self.brakes, self.score) > (!other.brakes, other.score)
    }
}

/// Lets Reflection choose what of a planner drives on.
///
/// # Errors
/// When the horizon is too short to be scored, or the state of the ego is not finite.
pub fn monitored_step(
    planner: &IdmPlan,
    scene: &SceneView<'_>,
    monitor: &PlanMonitor,
    memory: &mut PdmMemory,
) -> Result<MonitoredStep, PlannerError> {
    let choice = monitor.choose(scene, planner, memory).map_err(reflection_failed)?;
    let trajectory = if choice.emergency_brake {
        emergency_brake(scene.ego, PLAN_STEPS)?
    } else {
        planner.roll_out_version(choice.version, scene, PLAN_STEPS).to_trajectory(scene.ego)?
    };
    let brakes = choice.emergency_brake || choice.version == Version::STOP;
    Ok(MonitoredStep { trajectory, score: choice.score, brakes })
}

/// The planner of the same code in the ego's present lane; `None` when it is bound for that lane already.
///
/// # Errors
/// When the ego's pose is not finite.
pub(super) fn back_to_own_lane(
    planner: &IdmPlan,
    scene: &SceneView<'_>,
    graph: &LaneGraph,
    lead_policy: LeadPolicy,
    path_s: f64,
) -> Result<Option<IdmPlan>, PlannerError> {
    if graph.ego_lane().path.lanes.contains(&planner.lane_now(scene)) {
        return Ok(None);
    }
    let code = PlannerCode {
        centerline: CenterlineName::EgoLane.to_string(),
        lead_agent: graph.lead_agent(CenterlineName::EgoLane).map(|agent| agent.name.to_string()),
        ..planner.code.clone()
    };
    build_idm_plan(scene, graph, code, lead_policy, path_s)
}
