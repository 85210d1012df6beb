//! Builds plans from planner codes, and from plans that stay active.

use super::idm_plan::{IdmPlan, LeadPolicy};
use super::overtake::OvertakeRules;
use super::ride::Ride;
use crate::environment::{AgentName, CenterlineName, GraphedScene, LaneGraph};
use crate::reasoning::PlannerCode;
use planagent_score::pdm::FALLBACK_LIMIT;
use planagent_world::geometry::GeometryError;

/// Maximum acceleration and deceleration of an ego that keeps its lane and speed, m/s².
const KEEP_LANE_ACCELERATIONS: (f64, f64) = (1.0, 3.0);

/// The same for a plan at the limit, which shows what can be reached: PDM-Closed's.
const LIMIT_ACCELERATIONS: (f64, f64) = (1.5, 3.0);

/// What all plans of an agent have in common. Its functions fail where the ego's pose is not
/// finite.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlanBuilder {
    /// Which objects a plan follows.
    pub lead_policy: LeadPolicy,
    /// How a plan drives.
    pub ride: Ride,
    /// Time that a plan's path is long enough for, seconds.
    pub horizon_s: f64,
}

impl PlanBuilder {
    /// The plan of a code; `None` when the scene has no such centerline.
    pub fn build(
        &self,
        seen: GraphedScene<'_>,
        code: PlannerCode,
    ) -> Result<Option<IdmPlan>, GeometryError> {
        let GraphedScene { scene, graph } = seen;
        let Some(centerline) = graph.centerline(code.centerline) else {
            return Ok(None);
        };
        let name = match self.lead_policy {
            LeadPolicy::Named => code.lead_agent,
            LeadPolicy::Nearest => centerline.lead_agent,
        };
        let lead_agent = name
            .and_then(|name| graph.agent(name))
            .map(|agent| agent.token);
        let path = centerline.path.clone();
        let plan = IdmPlan::new(scene, code, path, lead_agent, self)?;
        let plan = plan.at_blocked_lane(seen, centerline.name);
        Ok(Some(plan.swerving(seen, self.horizon_s)?))
    }

    /// The plan at the speed limit along a centerline.
    pub(super) fn at_limit(
        &self,
        seen: GraphedScene<'_>,
        centerline: CenterlineName,
    ) -> Result<Option<IdmPlan>, GeometryError> {
        let (accel_max, decel_max) = LIMIT_ACCELERATIONS;
        let limit = seen.graph.ego_lane().speed_limit;
        let target_speed = limit.unwrap_or(FALLBACK_LIMIT).round();
        self.build(
            seen,
            PlannerCode {
                centerline,
                lead_agent: None,
                target_speed,
                accel_max,
                decel_max,
            },
        )
    }

    /// A plan that stays active: its path begins at the ego's present place, on the centerline that
    /// it is bound for. An overtake that has begun is completed, also where the graph no longer
    /// has its lane.
    pub fn extend(&self, plan: &IdmPlan, seen: GraphedScene<'_>) -> Result<IdmPlan, GeometryError> {
        let GraphedScene { scene, graph } = seen;
        let begun = plan
            .oncoming()
            .filter(|lane| graph.oncoming.is_none() && OvertakeRules::new(lane, scene).has_begun());
        if let Some(lane) = begun {
            let plan = plan.extended(scene, lane.centerline.path.clone(), self.horizon_s)?;
            return Ok(plan.completing(lane));
        }
        let lane = plan.lane_now(scene);
        let overtakes = graph
            .oncoming
            .as_ref()
            .map(|oncoming| &oncoming.centerline)
            .filter(|_| plan.oncoming().is_some());
        let beside = || {
            graph
                .centerlines
                .iter()
                .find(|centerline| centerline.path.lanes.contains(&lane))
        };
        let bound_for = overtakes.or_else(beside).unwrap_or(graph.ego_lane());
        let plan = plan.extended(scene, bound_for.path.clone(), self.horizon_s)?;
        plan.at_blocked_lane(seen, bound_for.name)
            .swerving(seen, self.horizon_s)
    }

    /// The plan of the same code along another centerline, behind the lead agent there; `None` when
    /// the scene has no such centerline.
    pub(crate) fn build_in(
        &self,
        centerline: CenterlineName,
        seen: GraphedScene<'_>,
        code: PlannerCode,
    ) -> Result<Option<IdmPlan>, GeometryError> {
        let lead_agent = seen.graph.lead_agent(centerline).map(|agent| agent.name);
        self.build(
            seen,
            PlannerCode {
                centerline,
                lead_agent,
                ..code
            },
        )
    }

    /// The plan of the same code in the ego's present lane; `None` when the plan is bound for that
    /// lane already, or changes no lanes: in a junction the ego is often nearer to another lane.
    pub(crate) fn back_to_ego_lane(
        &self,
        plan: &IdmPlan,
        seen: GraphedScene<'_>,
    ) -> Result<Option<IdmPlan>, GeometryError> {
        let GraphedScene { scene, graph } = seen;
        let own = &graph.ego_lane().path.lanes;
        let changes_lanes =
            plan.code.centerline != CenterlineName::EgoLane && !own.contains(&plan.lane_now(scene));
        if plan.oncoming().is_none() && !changes_lanes {
            return Ok(None);
        }
        self.build_in(CenterlineName::EgoLane, seen, plan.code)
    }

    /// The plan of an ego that keeps its lane and its speed behind the lead agent.
    pub(crate) fn keep_lane_and_speed(
        &self,
        seen: GraphedScene<'_>,
    ) -> Result<Option<IdmPlan>, GeometryError> {
        let (centerline, lead_agent) = ego_lane(seen.graph);
        let (accel_max, decel_max) = KEEP_LANE_ACCELERATIONS;
        let code = PlannerCode {
            centerline,
            lead_agent,
            target_speed: seen.scene.ego.speed(),
            accel_max,
            decel_max,
        };
        self.build(seen, code)
    }
}

fn ego_lane(graph: &LaneGraph) -> (CenterlineName, Option<AgentName>) {
    let name = CenterlineName::EgoLane;
    (name, graph.lead_agent(name).map(|agent| agent.name))
}
