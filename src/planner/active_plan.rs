//! Who drives between planning calls, and who will once the time of a call has passed.

use super::PlannerError;
use super::plan_agent::build_idm_plan;
use crate::environment::{CenterlineName, LaneGraph};
use crate::reasoning::PlannerCode;
use crate::reflection::{IdmPlan, LeadPolicy};
use crate::world::SceneView;

/// acc and dec of an ego that goes on as it is, m/s².
const GO_ON: (f64, f64) = (1.0, 3.0);

/// Who drives.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) enum ActivePlan {
    /// Nobody yet: the ego brakes.
    #[default]
    None,
    /// A generated planner.
    Generated(Box<IdmPlan>),
    /// PDM-Closed, along the way that it chose when it took over.
    PdmClosed,
}

impl ActivePlan {
    /// Lays the path of a generated planner anew from where the ego is now, along the centreline that it is bound for.
    ///
    /// # Errors
    /// When the ego's pose is not finite.
    pub(super) fn follow_on(
        &mut self,
        scene: &SceneView<'_>,
        graph: &LaneGraph,
        path_s: f64,
    ) -> Result<(), PlannerError> {
        if let Self::Generated(planner) = self {
            **planner = followed_on(planner, scene, graph, path_s)?;
        }
        Ok(())
    }
}

/// A planning call that still lasts in the simulated world.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Underway {
    /// The iteration at which it is over.
    pub(super) arrives: usize,
    /// The planner that it brings, if it brings one.
    pub(super) planner: Option<IdmPlan>,
}

/// What drives before the first planner arrives: the ego keeps its lane and its speed, behind whatever leads.
///
/// # Errors
/// When the ego's pose is not finite.
pub(super) fn keep_lane_and_speed(
    scene: &SceneView<'_>,
    graph: &LaneGraph,
    lead_policy: LeadPolicy,
    path_s: f64,
) -> Result<ActivePlan, PlannerError> {
    let code = PlannerCode {
        centerline: CenterlineName::EgoLane.to_string(),
        lead_agent: graph.lead_agent(CenterlineName::EgoLane).map(|agent| agent.name.to_string()),
        target_speed: scene.ego.speed(),
        accel_max: GO_ON.0,
        decel_max: GO_ON.1,
    };
    let planner = build_idm_plan(scene, graph, code, lead_policy, path_s)?;
    Ok(planner.map_or(ActivePlan::None, |planner| ActivePlan::Generated(Box::new(planner))))
}

/// A planner that stays in force, with its path laid anew along the centreline that it is bound for.
///
/// # Errors
/// When the ego's pose is not finite.
pub(super) fn followed_on(
    planner: &IdmPlan,
    scene: &SceneView<'_>,
    graph: &LaneGraph,
    path_s: f64,
) -> Result<IdmPlan, PlannerError> {
    let mut planner = planner.clone();
    let lane = planner.lane_now(scene);
    let bound = graph.centerlines.iter().find(|centerline| centerline.path.lanes.contains(&lane));
    let path = bound.unwrap_or(graph.ego_lane()).path.clone();
    planner
        .follow_on(scene, path, path_s)
        .map_err(|e| PlannerError::Failed { doing: "laying the path of the planner", source: Box::new(e) })?;
    Ok(planner)
}
