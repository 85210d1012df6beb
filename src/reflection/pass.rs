//! The rules under which a plan may pass something over the oncoming lane.

use super::plan_builder::PlanBuilder;
use super::rollout::{IdmPlan, LeadPolicy};
use crate::environment::lane_graph::{ONCOMING_SIGHT, OncomingAgent, OncomingLane};
use crate::environment::{CenterlineName, LaneGraph};
use crate::geometry::{OrientedBox, Point, Pose};
use crate::pdm::FALLBACK_LIMIT;
use crate::world::{PACIFICA, STEP_S, SceneView};

/// Time within which a pass has to be complete, steps of 0.1 s.
const STEPS: usize = 120;
/// Distance to an oncoming agent when the ego is back in its lane: at standstill, meters, and as a time of the agent's speed, seconds.
const MIN_GAP: f64 = 2.0;
const HEADWAY: f64 = 1.0;
/// A corner of the ego this far over the border of its lane is on the oncoming one, meters.
const OVER_BORDER: f64 = 0.1;
/// From this distance between front bumper and obstacle on the ego has begun to pass, and does not turn back, meters.
const BEGUN: f64 = 2.0;

/// Whether a pass keeps its rules.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum PassVerdict {
    /// The ego may leave its lane.
    Allowed,
    /// The ego is beside what it passes: it completes the pass.
    Begun,
    /// A rule is broken: the ego stays in its lane.
    Refused,
}

impl PassVerdict {
    /// The verdict on a plan; a plan that stays on lanes of its direction needs none.
    pub(super) fn of(plan: &IdmPlan, scene: &SceneView<'_>) -> Self {
        let Some(way) = plan.oncoming() else { return Self::Allowed };
        let front = way.own.project(PACIFICA.front_of(scene.ego.rear_axle)).s;
        if front > way.blocked.from_s - BEGUN {
            return Self::Begun;
        }
        if keeps_rules(plan, way, scene) { Self::Allowed } else { Self::Refused }
    }
}

/// The way past what blocks the ego's lane, if a plan at the limit may take it now.
pub fn allowed_pass<'g>(scene: &SceneView<'_>, graph: &'g LaneGraph) -> Option<&'g OncomingLane> {
    let way = graph.oncoming.as_ref()?;
    let builder = PlanBuilder { lead_policy: LeadPolicy::Nearest, horizon_s: at(STEPS) };
    let plan = builder.at_limit(scene, graph, CenterlineName::OncomingLane).ok()??;
    (PassVerdict::of(&plan, scene) != PassVerdict::Refused).then_some(way)
}

/// The rules way back, gap and sight, at constant speeds of all others. The ego must be back in its lane and before what is
/// next there. It must keep a distance to all that comes, seen or from beyond the sight.
fn keeps_rules(plan: &IdmPlan, way: &OncomingLane, scene: &SceneView<'_>) -> bool {
    let poses = plan.roll_out(scene, STEPS).poses;
    let is_out = |pose: &Pose| is_over_border(way, &PACIFICA.footprint(*pose));
    let Some(first) = poses.iter().position(is_out) else { return true };
    let last = poses.iter().rposition(is_out).unwrap_or(first);
    let Some(back) = poses.get(last + 1) else { return false };
    let (leaves, returns) = (at(first), at(last + 1));
    let front = PACIFICA.front_of(*back);
    let is_past = way.own.project(back.position()).s > way.blocked.to_s;
    is_past && has_gap(way, scene, front, returns) && is_clear(way, scene, (poses[first], leaves), (front, returns))
}

fn at(step: usize) -> f64 {
    step as f64 * STEP_S
}

fn is_over_border(way: &OncomingLane, ego: &OrientedBox) -> bool {
    let side = way.border.signum();
    ego.corners().iter().any(|&corner| way.own.project(corner).lateral * side > way.border.abs() + OVER_BORDER)
}

/// Whether there is room for the ego in its lane behind what it passes.
fn has_gap(way: &OncomingLane, scene: &SceneView<'_>, front: Point, returns: f64) -> bool {
    let needed = way.own.project(front).s + MIN_GAP;
    scene.objects.iter().all(|object| {
        let foot = way.own.project(object.shape.center.position());
        let half = object.shape.length / 2.0;
        let is_beyond = foot.s - half > way.blocked.to_s && foot.lateral.abs() <= way.border.abs();
        let along = object.velocity.x * foot.heading.cos() + object.velocity.y * foot.heading.sin();
        !is_beyond || foot.s - half + along.max(0.0) * returns >= needed
    })
}

/// Whether nothing that comes is near when the ego is back. `leaves` and `returns`: places and times of the ego.
fn is_clear(
    way: &OncomingLane,
    scene: &SceneView<'_>,
    (out, leaves): (Pose, f64),
    (front, returns): (Point, f64),
) -> bool {
    let here = way.traffic.project(PACIFICA.front_of(scene.ego.rear_axle)).s;
    let (out, back) = (way.traffic.project(PACIFICA.front_of(out)).s, way.traffic.project(front).s);
    let limit = way.speed_limit.unwrap_or(FALLBACK_LIMIT);
    // Whatever may come from beyond the sight. Nothing comes from before the start of a lane.
    let unseen =
        (here > ONCOMING_SIGHT).then_some(OncomingAgent { front_s: here - ONCOMING_SIGHT, length: 0.0, speed: limit });
    let keeps = |agent: OncomingAgent, headway: f64| {
        let has_passed = agent.front_s - agent.length + agent.speed * leaves >= out + MIN_GAP;
        has_passed || agent.front_s + agent.speed * (returns + headway) + MIN_GAP <= back
    };
    unseen.is_none_or(|unseen| keeps(unseen, 0.0)) && way.agents(scene).all(|agent| keeps(agent, HEADWAY))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::environment::DEFAULT_NODE_LENGTH;
    use crate::pdm::PdmMemory;
    use crate::reflection::{Judge, PlanMonitor, ReflectionReport};
    use crate::world::{Scene, SceneBuilder};
    use std::f64::consts::PI;

    const BUILDER: PlanBuilder = PlanBuilder { lead_policy: LeadPolicy::Nearest, horizon_s: 8.0 };

    /// A lane to the east along y = 0 and one against it, a broken-down car at x = 25, and the ego at x = 0.
    fn road(limit: f64, speed: f64) -> SceneBuilder {
        let lanes =
            Scene::builder().speed_limit(limit).lane([[-100.0, 0.0], [300.0, 0.0]]).lane([[300.0, 3.5], [-100.0, 3.5]]);
        lanes.ego([0.0, 0.0], 0.0, speed).vehicle([25.0, 0.0], 0.0, 0.0)
    }

    fn plan(scene: &Scene, name: CenterlineName) -> (IdmPlan, LaneGraph) {
        let view = scene.view();
        let graph = LaneGraph::build(&view, DEFAULT_NODE_LENGTH).unwrap().with_oncoming_lane(&view);
        (BUILDER.at_limit(&view, &graph, name).unwrap().unwrap(), graph)
    }

    fn verdict(scene: SceneBuilder) -> PassVerdict {
        let scene = scene.build().unwrap();
        PassVerdict::of(&plan(&scene, CenterlineName::OncomingLane).0, &scene.view())
    }

    fn judged(scene: &Scene, name: CenterlineName) -> ReflectionReport {
        let (view, (plan, graph)) = (scene.view(), plan(scene, name));
        Judge::new(&view, &graph, 4.0, &mut PdmMemory::default()).unwrap().reflect(&plan, 0.98).unwrap()
    }

    #[test]
    fn a_pass_needs_sight_a_gap_and_a_way_back() {
        assert_eq!(verdict(road(13.0, 8.0)), PassVerdict::Allowed);
        assert_eq!(verdict(road(13.0, 8.0).vehicle([70.0, 3.5], PI, 8.0)), PassVerdict::Refused, "a car comes");
        assert_eq!(verdict(road(13.0, 8.0).vehicle([140.0, 3.5], PI, 4.0)), PassVerdict::Allowed, "it is far away");
        assert_eq!(verdict(road(13.0, 8.0).vehicle([4.0, 3.5], PI, 8.0)), PassVerdict::Allowed, "it has passed before");
        assert_eq!(verdict(road(28.0, 1.0)), PassVerdict::Refused, "something fast may come from beyond the sight");
        assert_eq!(verdict(road(13.0, 8.0).vehicle([43.0, 0.0], 0.0, 0.5)), PassVerdict::Refused, "no room behind it");
        assert_eq!(verdict(road(13.0, 8.0).vehicle([35.0, 3.5], PI, 0.0)), PassVerdict::Refused, "no way back");
    }

    #[test]
    fn the_driving_direction_refuses_a_pass_only_where_a_rule_is_broken() {
        let free = road(13.0, 8.0).build().unwrap();
        let (pass, own) = (judged(&free, CenterlineName::OncomingLane), judged(&free, CenterlineName::EgoLane));
        assert!(pass.parts.driving_direction >= 1.0 && pass.score > own.score, "{:?} {:?}", pass.parts, own.parts);
        assert!(pass.parts.progress > 0.95 && own.parts.progress < 0.7, "{:?} {:?}", pass.parts, own.parts);
        let busy = road(13.0, 8.0).vehicle([70.0, 3.5], PI, 8.0).build().unwrap();
        let (pass, own) = (judged(&busy, CenterlineName::OncomingLane), judged(&busy, CenterlineName::EgoLane));
        assert!(pass.parts.driving_direction <= 0.0 && pass.score <= 0.0, "{:?}", pass.parts);
        assert!(own.parts.progress >= 1.0, "the ego waits: {:?}", own.parts);
    }

    #[test]
    fn an_ego_that_waits_stops_where_it_can_still_leave_its_lane() {
        let scene = road(13.0, 6.0).build().unwrap();
        let (plan, _) = plan(&scene, CenterlineName::EgoLane);
        let rollout = plan.roll_out(&scene.view(), 150);
        let front = rollout.poses.last().unwrap().x + PACIFICA.front_length;
        let rear_of_car = 25.0 - 2.3;
        assert!(rear_of_car - front > 9.5 && rear_of_car - front < 13.0, "{front}");
    }

    #[test]
    fn monitoring_gives_a_pass_up_when_a_rule_breaks_and_completes_one_that_has_begun() {
        let monitor = PlanMonitor { steps: 40, threshold: 0.75, emergency_brake: true };
        let score = |scene: SceneBuilder| {
            let scene = scene.build().unwrap();
            let (plan, _) = plan(&scene, CenterlineName::OncomingLane);
            monitor.choose(&scene.view(), &plan, &mut PdmMemory::default()).unwrap().score
        };
        assert!(score(road(13.0, 8.0)) >= 0.75);
        assert!(score(road(13.0, 8.0).vehicle([70.0, 3.5], PI, 8.0)) <= 0.0);
        let lanes = Scene::builder().lane([[-100.0, 0.0], [300.0, 0.0]]).lane([[300.0, 3.5], [-100.0, 3.5]]);
        let beside = lanes.ego([22.0, 2.9], 0.0, 8.0).vehicle([25.0, 0.0], 0.0, 0.0).route([0]);
        assert_eq!(verdict(beside.clone().vehicle([90.0, 3.5], PI, 8.0)), PassVerdict::Begun);
        assert!(score(beside) > 0.5);
    }
}
