//! Planner codes of a scene that need no model: a fixed one, and grids of them.

use crate::environment::lane_graph::GoalLane;
use crate::environment::{CenterlineName, LaneGraph};
use crate::reasoning::PlannerCode;

/// acc and dec of the fixed code, m/s²; the label search of nano prefers them too.
pub const DEFAULT_ACCELERATIONS: (f64, f64) = (1.5, 3.0);
/// Desired speeds of the grid, as fractions of the limit.
const GRID_SPEEDS: [f64; 7] = [1.0, 0.85, 0.7, 0.55, 0.4, 0.2, 0.0];
/// acc and dec of a firm code, m/s².
const FIRM_ACCELERATIONS: (f64, f64) = (2.0, 4.0);
/// Pairs of acc and dec of the grid, m/s²: default, gentle, firm, emergency.
const GRID_ACCELERATIONS: [(f64, f64); 4] = [
    DEFAULT_ACCELERATIONS,
    (1.0, 2.0),
    FIRM_ACCELERATIONS,
    (1.5, 6.0),
];

/// The ego's lane at the speed limit.
pub fn fixed_code(graph: &LaneGraph) -> PlannerCode {
    planner_code(graph, CenterlineName::EgoLane, 1.0, DEFAULT_ACCELERATIONS)
}

/// All codes of the grid: the ego's lane before others, fast before slow.
pub fn grid_codes(graph: &LaneGraph) -> Vec<PlannerCode> {
    let mut centerlines: Vec<CenterlineName> =
        graph.named().map(|centerline| centerline.name).collect();
    centerlines.sort_by_key(|&name| name != CenterlineName::EgoLane);
    let mut codes = Vec::new();
    for centerline in centerlines {
        for fraction in GRID_SPEEDS {
            for accelerations in GRID_ACCELERATIONS {
                codes.push(planner_code(graph, centerline, fraction, accelerations));
            }
        }
    }
    codes.dedup();
    codes
}

/// Codes that do not look: each lane at the limit, then the ego's lane more slowly.
pub fn plain_codes(graph: &LaneGraph) -> impl Iterator<Item = PlannerCode> {
    let lanes = graph.named().map(|centerline| (centerline.name, 1.0));
    let slower = GRID_SPEEDS
        .iter()
        .skip(1)
        .step_by(2)
        .map(|&fraction| (CenterlineName::EgoLane, fraction));
    lanes
        .chain(slower)
        .map(|(name, fraction)| planner_code(graph, name, fraction, DEFAULT_ACCELERATIONS))
}

/// Codes that are tried where Reflection refused all of a call. Before a blocked lane that the ego
/// can leave, the whole grid; elsewhere the ego's lane from the limit down, and where something
/// blocks it, the lanes beside at the limit. Behind moving traffic, a change into another lane comes
/// near others more often than it helps.
/// Why: docs/decisions/129-judged-handover.md, docs/decisions/149-a-cause-to-leave.md.
pub(super) fn further_codes(graph: &LaneGraph) -> Vec<PlannerCode> {
    if graph.stop_point().is_some() {
        return grid_codes(graph);
    }
    let own = moving().map(|fraction| (CenterlineName::EgoLane, fraction));
    let others = graph
        .centerlines
        .iter()
        .filter(|centerline| graph.blocked.is_some() && centerline.name != CenterlineName::EgoLane)
        .map(|centerline| (centerline.name, 1.0));
    own.chain(others)
        .map(|(name, fraction)| planner_code(graph, name, fraction, DEFAULT_ACCELERATIONS))
        .collect()
}

/// Codes that pass what blocks the ego's lane over the oncoming one, at the limit. A firm
/// acceleration brings the ego back sooner, so it needs less sight and a shorter gap.
/// Why: docs/decisions/144-wait-where-the-way-begins.md.
pub(super) fn codes_past(graph: &LaneGraph) -> Vec<PlannerCode> {
    if graph.oncoming.is_none() {
        return Vec::new();
    }
    [DEFAULT_ACCELERATIONS, FIRM_ACCELERATIONS]
        .map(|pair| planner_code(graph, CenterlineName::OncomingLane, 1.0, pair))
        .to_vec()
}

/// Codes that begin the way to the goal's lane, from the limit down. They are tried where the plan
/// of a call does not.
/// Why: docs/decisions/136-to-the-goals-lane.md.
pub(super) fn codes_to_goal(graph: &LaneGraph, goal: GoalLane) -> Vec<PlannerCode> {
    let leads_there = |name: &CenterlineName| goal.is_towards(name.lane_changes());
    let lanes = graph.named().map(|centerline| centerline.name);
    lanes
        .filter(leads_there)
        .flat_map(|name| moving().map(move |fraction| (name, fraction)))
        .map(|(name, fraction)| planner_code(graph, name, fraction, DEFAULT_ACCELERATIONS))
        .collect()
}

/// Desired speeds of the grid but the standstill.
fn moving() -> impl Iterator<Item = f64> {
    GRID_SPEEDS.into_iter().filter(|&fraction| fraction > 0.0)
}

/// The code for a centerline of the scene behind its lead agent, at a fraction of the speed limit
/// (whole m/s).
pub fn planner_code(
    graph: &LaneGraph,
    centerline: CenterlineName,
    fraction: f64,
    (accel_max, decel_max): (f64, f64),
) -> PlannerCode {
    PlannerCode {
        centerline,
        lead_agent: graph.lead_agent(centerline).map(|agent| agent.name),
        target_speed: (fraction * graph.limit()).round(),
        accel_max,
        decel_max,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::environment::DEFAULT_NODE_LENGTH;
    use planagent_world::Scene;

    /// The numbers of further codes and of the grid's, where a car stands ahead on the last of some
    /// lanes.
    fn numbers(lanes: usize, x: f64) -> (usize, usize) {
        let scene = Scene::builder()
            .lanes(lanes, [[-50.0, 0.0], [250.0, 0.0]])
            .ego([0.0, -3.5 * (lanes - 1) as f64], 0.0, 8.0)
            .vehicle([x, -3.5 * (lanes - 1) as f64], 0.0, 0.0)
            .build()
            .unwrap();
        let graph = LaneGraph::build(&scene.view(), DEFAULT_NODE_LENGTH).unwrap();
        (further_codes(&graph).len(), grid_codes(&graph).len())
    }

    #[test]
    fn the_whole_grid_is_tried_where_the_ego_can_leave_a_blocked_lane() {
        let (further, grid) = numbers(2, 40.0);
        assert_eq!(further, grid);
        for (lanes, x) in [(1, 40.0), (2, 200.0)] {
            let (further, grid) = numbers(lanes, x);
            assert!(further < 10 && grid > 10, "{lanes} {x}: {further} {grid}");
        }
    }
}
