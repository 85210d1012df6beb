//! Reports on plans in scenes that tests build.

use super::{Judge, LeadPolicy, PlanBuilder, ReflectionReport, Ride};
use crate::environment::{CenterlineName, DEFAULT_NODE_LENGTH, GraphedScene, LaneGraph};
use planagent_score::pdm::PdmMemory;
use planagent_world::SceneBuilder;

/// The report on a code at the limit on a lane, of a plan with one ride, beside rivals with another.
pub(super) fn judged_beside(
    scene: SceneBuilder,
    centerline: CenterlineName,
    (ride, of_rivals): (Ride, Ride),
) -> ReflectionReport {
    let scene = scene.build().unwrap();
    let view = scene.view();
    let graph = LaneGraph::build(&view, DEFAULT_NODE_LENGTH).unwrap();
    let builder = PlanBuilder {
        lead_policy: LeadPolicy::Nearest,
        ride,
        horizon_s: 4.0,
    };
    let plan = builder
        .at_limit(GraphedScene::new(&view, &graph), centerline)
        .unwrap()
        .unwrap();
    Judge::of_plans(&view, &graph, (of_rivals, 4.0), &mut PdmMemory::default())
        .unwrap()
        .reflect(&plan, 0.75)
        .unwrap()
}
