//! The rules under which a plan may pass something over the oncoming lane.

use super::idm_plan::LeadPolicy;
use super::plan_builder::PlanBuilder;
use super::ride::Ride;
use crate::environment::lane_graph::{ONCOMING_SIGHT, OncomingAgent, OncomingLane};
use crate::environment::{CenterlineName, GraphedScene};
use planagent_score::pdm::{FALLBACK_LIMIT, OvertakeVerdict};
use planagent_world::dynamics::IDM_AGENT;
use planagent_world::geometry::{OrientedBox, Point, Pose};
use planagent_world::{PACIFICA, STEP_S, SceneView};

/// Time within which an overtake has to be complete, steps of 0.1 s.
/// Why: docs/decisions/114-oncoming-lane.md.
const STEPS: usize = 120;
/// Distance to an oncoming agent when the ego is back in its lane: at standstill, meters, and as a
/// time at the agent's limit, seconds.
/// Why: docs/decisions/114-oncoming-lane.md.
const MIN_GAP: f64 = 2.0;
const HEADWAY: f64 = 1.0;
/// A corner of the ego this far over the border of its lane is on the oncoming one, meters.
const OVER_BORDER: f64 = 0.1;
/// From this distance between front bumper and obstacle on, an ego over its border has begun to
/// pass, and does not turn back, meters.
const BEGUN: f64 = 2.0;
/// Acceleration of oncoming traffic up to its limit, m/s²: that of nuPlan's IDM agents.
const ACCELERATION: f64 = IDM_AGENT.accel_max;

/// The rules of an overtake at one instant.
#[derive(Debug)]
pub struct OvertakeRules<'a> {
    lane: &'a OncomingLane,
    scene: &'a SceneView<'a>,
    oncoming: Vec<OncomingAgent>,
}

impl<'a> OvertakeRules<'a> {
    /// Length of the roll-outs that [`Self::verdict`] judges, steps of 0.1 s.
    pub const STEPS: usize = STEPS;

    /// The rules on an oncoming lane.
    pub fn new(lane: &'a OncomingLane, scene: &'a SceneView<'a>) -> Self {
        Self {
            lane,
            scene,
            oncoming: lane.agents(scene).collect(),
        }
    }

    /// Whether the ego is beside what it passes: it completes the overtake, whatever comes.
    pub(crate) fn has_begun(&self) -> bool {
        let front = self
            .lane
            .own
            .project(PACIFICA.front_of(self.scene.ego.rear_axle))
            .s;
        is_over_border(self.lane, &self.scene.ego.footprint())
            && front > self.lane.blocked.from_s - BEGUN
    }

    /// The verdict on a roll-out: poses of the rear axle every 0.1 s, the present one first.
    pub fn verdict(&self, poses: &[Pose]) -> OvertakeVerdict {
        if self.has_begun() {
            return OvertakeVerdict::Allowed;
        }
        match self.are_kept(poses) {
            None => OvertakeVerdict::Stays,
            Some(true) => OvertakeVerdict::Allowed,
            Some(false) => OvertakeVerdict::Refused,
        }
    }

    /// Whether the rules about return, gap and sight are kept; `None` where the ego stays in its
    /// lane. The ego must be back in its lane and before what is next there. It must keep a distance to
    /// all that comes, seen or from beyond the sight.
    fn are_kept(&self, poses: &[Pose]) -> Option<bool> {
        let is_out = |pose: &Pose| is_over_border(self.lane, &PACIFICA.footprint(*pose));
        let first = poses.iter().position(is_out)?;
        let last = poses.iter().rposition(is_out).unwrap_or(first);
        let Some(back) = poses.get(last + 1) else {
            return Some(false);
        };
        let (leaves, returns) = (at(first), at(last + 1));
        let front = PACIFICA.front_of(*back);
        let is_past = self.lane.own.project(back.position()).s > self.lane.blocked.to_s;
        Some(
            is_past
                && self.has_gap(front, returns)
                && self.is_clear(poses[first], leaves, front, returns),
        )
    }

    /// Whether there is room for the ego in its lane behind what it passes.
    fn has_gap(&self, front: Point, returns: f64) -> bool {
        let lane = self.lane;
        let needed = lane.own.project(front).s + MIN_GAP;
        self.scene.objects.iter().all(|object| {
            let foot = lane.own.project(object.shape.center.position());
            let half = object.shape.length / 2.0;
            let is_beyond =
                foot.s - half > lane.blocked.to_s && foot.lateral.abs() <= lane.border.abs();
            let along =
                object.velocity.x * foot.heading.cos() + object.velocity.y * foot.heading.sin();
            !is_beyond || foot.s - half + along.max(0.0) * returns >= needed
        })
    }

    /// Whether nothing that comes is near when the ego is back. The ego leaves its lane at `out` and
    /// has its front back in it at `front`, after `leaves` and `returns` seconds. What comes may accelerate until then; whether it has passed before, its
    /// present speed says.
    fn is_clear(&self, out: Pose, leaves: f64, front: Point, returns: f64) -> bool {
        let line = &self.lane.traffic;
        let here = line.project(PACIFICA.front_of(self.scene.ego.rear_axle)).s;
        let (out, back) = (
            line.project(PACIFICA.front_of(out)).s,
            line.project(front).s,
        );
        let limit = self.lane.speed_limit.unwrap_or(FALLBACK_LIMIT);
        // Whatever may come from beyond the sight. Nothing comes from before the start of a lane.
        let unseen = (here > ONCOMING_SIGHT).then_some(OncomingAgent {
            front_s: here - ONCOMING_SIGHT,
            length: 0.0,
            speed: limit,
        });
        let keeps = |agent: &OncomingAgent, headway: f64| {
            let has_passed = agent.front_s - agent.length + agent.speed * leaves >= out + MIN_GAP;
            let comes = driven(agent.speed, limit, returns) + headway * agent.speed.max(limit);
            has_passed || agent.front_s + comes + MIN_GAP <= back
        };
        unseen.is_none_or(|unseen| keeps(&unseen, 0.0))
            && self.oncoming.iter().all(|agent| keeps(agent, HEADWAY))
    }
}

/// The oncoming lane past what blocks the ego's, if a plan at the limit may overtake there now.
pub(crate) fn allowed_overtake(seen: GraphedScene<'_>) -> Option<&OncomingLane> {
    let GraphedScene { scene, graph } = seen;
    let lane = graph.oncoming.as_ref()?;
    let builder = PlanBuilder {
        lead_policy: LeadPolicy::Nearest,
        ride: Ride::Idm,
        horizon_s: at(STEPS),
    };
    let plan = builder
        .at_limit(seen, CenterlineName::OncomingLane)
        .ok()??;
    let verdict = OvertakeRules::new(lane, scene).verdict(&plan.roll_out(scene, STEPS).poses);
    (verdict == OvertakeVerdict::Allowed).then_some(lane)
}

/// How far traffic comes in a time at most, meters: it accelerates up to the limit.
fn driven(speed: f64, limit: f64, seconds: f64) -> f64 {
    let fastest = limit.max(speed);
    let accelerating = ((fastest - speed) / ACCELERATION).min(seconds);
    let reached = speed + ACCELERATION * accelerating;
    f64::midpoint(speed, reached) * accelerating + reached * (seconds - accelerating)
}

fn at(step: usize) -> f64 {
    step as f64 * STEP_S
}

fn is_over_border(lane: &OncomingLane, ego: &OrientedBox) -> bool {
    let side = lane.border.signum();
    ego.corners()
        .iter()
        .any(|&corner| lane.own.project(corner).lateral * side > lane.border.abs() + OVER_BORDER)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::environment::{DEFAULT_NODE_LENGTH, LaneGraph};
    use crate::reflection::{IdmPlan, Judge, MonitoredStep, PlanMonitor, ReflectionReport};
    use planagent_score::pdm::PdmMemory;
    use planagent_world::{Scene, SceneBuilder};
    use std::f64::consts::PI;

    const BUILDER: PlanBuilder = PlanBuilder {
        lead_policy: LeadPolicy::Nearest,
        ride: Ride::Idm,
        horizon_s: 8.0,
    };

    /// A lane to the east along y = 0 and one against it, a broken-down car at x = 25, and the ego
    /// at x = 0.
    fn road(limit: f64, speed: f64) -> SceneBuilder {
        let lanes = Scene::builder()
            .speed_limit(limit)
            .lane([[-100.0, 0.0], [300.0, 0.0]])
            .lane([[300.0, 3.5], [-100.0, 3.5]]);
        lanes
            .ego([0.0, 0.0], 0.0, speed)
            .vehicle([25.0, 0.0], 0.0, 0.0)
    }

    fn plan(scene: &Scene, name: CenterlineName) -> (IdmPlan, LaneGraph) {
        let view = scene.view();
        let graph = LaneGraph::build(&view, DEFAULT_NODE_LENGTH)
            .unwrap()
            .with_oncoming_lane(&view);
        (
            BUILDER
                .at_limit(GraphedScene::new(&view, &graph), name)
                .unwrap()
                .unwrap(),
            graph,
        )
    }

    fn verdict(scene: SceneBuilder) -> OvertakeVerdict {
        let scene = scene.build().unwrap();
        let (view, (plan, graph)) = (scene.view(), plan(&scene, CenterlineName::OncomingLane));
        let poses = plan.roll_out(&view, STEPS).poses;
        OvertakeRules::new(graph.oncoming.as_ref().unwrap(), &view).verdict(&poses)
    }

    fn judged(scene: &Scene, name: CenterlineName) -> ReflectionReport {
        let (view, (plan, graph)) = (scene.view(), plan(scene, name));
        Judge::new(&view, &graph, 4.0, &mut PdmMemory::default())
            .unwrap()
            .reflect(&plan, 0.98)
            .unwrap()
    }

    #[test]
    fn an_overtake_needs_sight_a_gap_and_room_to_return() {
        assert_eq!(verdict(road(13.0, 8.0)), OvertakeVerdict::Allowed);
        assert_eq!(
            verdict(road(13.0, 8.0).vehicle([70.0, 3.5], PI, 8.0)),
            OvertakeVerdict::Refused,
            "a car comes"
        );
        assert_eq!(
            verdict(road(13.0, 8.0).vehicle([140.0, 3.5], PI, 4.0)),
            OvertakeVerdict::Allowed,
            "it is far away"
        );
        assert_eq!(
            verdict(road(13.0, 8.0).vehicle([4.0, 3.5], PI, 8.0)),
            OvertakeVerdict::Allowed,
            "it has passed before"
        );
        assert_eq!(
            verdict(road(28.0, 1.0)),
            OvertakeVerdict::Refused,
            "something fast may come from beyond the sight"
        );
        assert_eq!(
            verdict(road(13.0, 8.0).vehicle([43.0, 0.0], 0.0, 0.5)),
            OvertakeVerdict::Refused,
            "no room behind it"
        );
        assert_eq!(
            verdict(road(13.0, 8.0).vehicle([35.0, 3.5], PI, 0.0)),
            OvertakeVerdict::Refused,
            "no room to return"
        );
    }

    #[test]
    fn the_driving_direction_refuses_an_overtake_only_where_a_rule_is_broken() {
        let free = road(13.0, 8.0).build().unwrap();
        let (overtake, own) = (
            judged(&free, CenterlineName::OncomingLane),
            judged(&free, CenterlineName::EgoLane),
        );
        assert!(
            overtake.parts.driving_direction >= 1.0 && overtake.score > own.score,
            "{:?} {:?}",
            overtake.parts,
            own.parts
        );
        assert!(
            overtake.parts.progress > 0.95 && own.parts.progress < 0.7,
            "{:?} {:?}",
            overtake.parts,
            own.parts
        );
        let busy = road(13.0, 8.0)
            .vehicle([70.0, 3.5], PI, 8.0)
            .build()
            .unwrap();
        let (overtake, own) = (
            judged(&busy, CenterlineName::OncomingLane),
            judged(&busy, CenterlineName::EgoLane),
        );
        assert!(
            overtake.parts.driving_direction <= 0.0 && overtake.score <= 0.0,
            "{:?}",
            overtake.parts
        );
        assert!(own.parts.progress >= 1.0, "the ego waits: {:?}", own.parts);
    }

    #[test]
    fn an_ego_that_waits_stops_where_it_can_still_leave_its_lane() {
        let scene = road(13.0, 6.0).build().unwrap();
        let (plan, _) = plan(&scene, CenterlineName::EgoLane);
        let rollout = plan.roll_out(&scene.view(), 150);
        let front = rollout.poses.last().unwrap().x + PACIFICA.front_length;
        let rear_of_car = 25.0 - 2.3;
        assert!(
            rear_of_car - front > 9.5 && rear_of_car - front < 13.0,
            "{front}"
        );
    }

    /// How far before a broken-down car an ego stops that comes at 14 m/s, and how hard it brakes.
    fn stops(scene: SceneBuilder, car: f64) -> (f64, f64) {
        let scene = scene.vehicle([car, 0.0], 0.0, 0.0).build().unwrap();
        let (plan, _) = plan(&scene, CenterlineName::EgoLane);
        let rollout = plan.roll_out(&scene.view(), 150);
        let front = rollout.poses.last().unwrap().x + PACIFICA.front_length;
        let speeds = rollout.speeds.windows(2);
        let hardest = speeds.fold(0.0, |most: f64, w| most.max((w[0] - w[1]) / STEP_S));
        (car - 2.3 - front, hardest)
    }

    #[test]
    fn an_ego_brakes_for_the_waiting_place_as_hard_as_it_must() {
        let lanes = |count| {
            Scene::builder()
                .lanes(count, [[-100.0, 0.0], [300.0, 0.0]])
                .lane([[300.0, 3.5], [-100.0, 3.5]])
                .ego([0.0, 0.0], 0.0, 14.0)
        };
        let (far, gently) = stops(lanes(1), 58.0);
        assert!(far > 9.5 && gently < 3.2, "{far} {gently}");
        let (near, hard) = stops(lanes(1), 42.0);
        assert!(near > 9.5 && hard > 3.5 && hard < 6.01, "{near} {hard}");
        let (nearer, hardest) = stops(lanes(1), 30.0);
        assert!(nearer > 0.5 && hardest > 5.9, "as soon as it may: {nearer}");
        let (beside_a_lane, as_hard) = stops(lanes(2), 42.0);
        assert!(
            beside_a_lane > 9.5 && as_hard > 3.5 && as_hard < 6.01,
            "{beside_a_lane} {as_hard}"
        );
    }

    #[test]
    fn monitoring_gives_an_overtake_up_when_a_rule_breaks_and_completes_one_that_has_begun() {
        let monitor = PlanMonitor {
            steps: 40,
            threshold: 0.75,
            emergency_brake: true,
            handover: false,
            evasion: None,
        };
        let choice = |scene: SceneBuilder| {
            let scene = scene.build().unwrap();
            let (plan, _) = plan(&scene, CenterlineName::OncomingLane);
            monitor
                .choose(&scene.view(), &plan, &mut PdmMemory::default())
                .unwrap()
        };
        assert!(choice(road(13.0, 8.0)).score >= 0.75);
        let refused = choice(road(13.0, 8.0).vehicle([70.0, 3.5], PI, 8.0));
        assert!(refused.is_refused && refused.score <= 0.0, "{refused:?}");
        let lanes = Scene::builder()
            .lane([[-100.0, 0.0], [300.0, 0.0]])
            .lane([[300.0, 3.5], [-100.0, 3.5]]);
        let beside = |y: f64| {
            lanes
                .clone()
                .ego([22.0, y], 0.0, 8.0)
                .vehicle([25.0, 0.0], 0.0, 0.0)
                .route([0])
        };
        assert_eq!(
            verdict(beside(2.9).vehicle([90.0, 3.5], PI, 8.0)),
            OvertakeVerdict::Allowed,
            "it has begun"
        );
        assert!(choice(beside(2.9)).score > 0.5);
    }

    #[test]
    fn the_ego_gives_a_refused_overtake_up_also_where_that_needs_hard_braking() {
        let monitor = PlanMonitor {
            steps: 40,
            threshold: 0.75,
            emergency_brake: true,
            handover: false,
            evasion: None,
        };
        let scene = road(13.0, 8.0)
            .vehicle([70.0, 3.5], PI, 8.0)
            .build()
            .unwrap();
        let step = |name| {
            monitor
                .step(
                    &scene.view(),
                    &plan(&scene, name).0,
                    &mut PdmMemory::default(),
                )
                .unwrap()
        };
        let (overtake, own) = (
            step(CenterlineName::OncomingLane),
            step(CenterlineName::EgoLane),
        );
        assert!(overtake.is_refused && !overtake.brakes && !own.is_refused);
        assert!(own.is_better_than(&overtake));
        assert!(
            MonitoredStep {
                brakes: true,
                score: 0.0,
                ..own
            }
            .is_better_than(&overtake)
        );
    }

    #[test]
    fn an_ego_that_waits_behind_the_obstacle_has_not_begun_to_pass_it() {
        let waits = road(13.0, 0.0).ego([17.5, 0.0], 0.0, 0.0);
        assert_ne!(
            verdict(waits.vehicle([60.0, 3.5], PI, 8.0)),
            OvertakeVerdict::Allowed
        );
    }

    #[test]
    fn a_plan_that_stays_behind_what_blocks_its_lane_needs_no_verdict() {
        let scene = road(13.0, 0.0).build().unwrap();
        let (view, (plan, graph)) = (scene.view(), plan(&scene, CenterlineName::EgoLane));
        let rules = OvertakeRules::new(graph.oncoming.as_ref().unwrap(), &view);
        assert_eq!(
            rules.verdict(&plan.roll_out(&view, STEPS).poses),
            OvertakeVerdict::Stays
        );
    }

    #[test]
    fn traffic_accelerates_up_to_its_limit() {
        for (speed, seconds, meters) in [
            (8.0, 1.0, 8.5),
            (8.0, 4.0, 8.0 * 2.0 + 2.0 + 10.0 * 2.0),
            (12.0, 2.0, 24.0),
        ] {
            assert!((driven(speed, 10.0, seconds) - meters).abs() < 1e-12);
        }
    }
}
