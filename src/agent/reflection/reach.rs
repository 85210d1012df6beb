//! What could be reached beyond the horizon of a roll-out, where something stands in the ego's way.

use super::idm_plan::{IdmPlan, LeadPolicy};
use super::judge::{ReflectionError, score_versions};
use super::plan_builder::PlanBuilder;
use super::ride::Ride;
use super::rollout::{Rollout, Version};
use crate::environment::{CenterlineName, GraphedScene, LaneGraph};
use planagent_score::pdm::{ProposalScore, ScoringScene, score_proposals};
use planagent_world::dynamics::{JerkPenalty, simulate_proposal};
use planagent_world::{EgoState, SceneView};

/// Time beyond the horizon for which an ego is taken to keep its final speed, seconds.
/// Why: docs/decisions/113-standing-progress.md.
const BEYOND_S: f64 = 4.0;
/// A shorter reach does not count, meters: an ego that waits may creep that far. About the length
/// of the ego.
pub(super) const MIN_REACH: f64 = 5.0;
/// Below this progress of PDM-Closed's proposals standing still is as good as any, meters (PDM's
/// scorer).
const STANDS: f64 = 0.1;

/// How far a roll-out comes along the line of progress, meters, times its multipliers.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Reach {
    /// Within the horizon.
    pub(super) progress_m: f64,
    /// Within [`BEYOND_S`] more, at its final speed.
    pub(super) reach_m: f64,
}

impl Reach {
    pub(super) fn from_rollout(score: &ProposalScore, states: &[EgoState]) -> Self {
        let progress_m = score.progress_m * score.multiplier();
        let beyond = states.last().map_or(0.0, EgoState::speed) * BEYOND_S;
        Self {
            progress_m,
            reach_m: (score.progress_m + beyond) * score.multiplier(),
        }
    }

    /// That of a rival: one that comes near a collision reaches nothing.
    pub(super) fn of_rival(score: &ProposalScore, states: &[EgoState]) -> Self {
        let reach = Self::from_rollout(score, states);
        if score.time_to_collision < 1.0 {
            Self {
                reach_m: 0.0,
                ..reach
            }
        } else {
            reach
        }
    }

    /// The largest progress and the largest reach of some rivals.
    pub(super) fn best(rivals: impl IntoIterator<Item = Self>) -> Self {
        rivals.into_iter().fold(Self::default(), |best, one| Self {
            progress_m: best.progress_m.max(one.progress_m),
            reach_m: best.reach_m.max(one.reach_m),
        })
    }
}

/// What plans at the limit reach.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct LaneReach {
    /// In the ego's lane.
    pub(super) own: Reach,
    /// On all lanes, meters.
    pub(super) best_m: f64,
}

/// Whether progress is compared with what can be reached: the ego's lane is blocked by what stands
/// permanently, or PDM-Closed's best proposal stands.
pub(super) fn is_compared(graph: &LaneGraph, rival_progress: f64) -> bool {
    graph.blocked.is_some() || rival_progress <= STANDS
}

/// What plans are compared with: plans at the limit that drive as they do.
pub(super) struct Compared<'a, 'g> {
    pub(super) scene: &'a SceneView<'a>,
    pub(super) graph: &'g LaneGraph,
    pub(super) ride: Ride,
    /// Length of path that the plans need, seconds.
    pub(super) horizon_s: f64,
    /// Length of the roll-outs, steps of 0.1 s.
    pub(super) steps: usize,
}

impl Compared<'_, '_> {
    /// The most that a plan could do: at the limit, behind the nearest agent, with the whole
    /// acceleration.
    fn at_limit(&self, lane: CenterlineName) -> Result<Option<IdmPlan>, ReflectionError> {
        let builder = PlanBuilder {
            lead_policy: LeadPolicy::Nearest,
            ride: self.ride,
            horizon_s: self.horizon_s,
        };
        Ok(builder.at_limit(GraphedScene::new(self.scene, self.graph), lane)?)
    }

    fn simulate(&self, rollout: &Rollout) -> Vec<EgoState> {
        simulate_proposal(self.scene.ego, &rollout.poses, JerkPenalty::PdmClosed)
    }

    /// The reach of plans at the limit: on the ego's lane and, where that is blocked, on those that
    /// lead past. A red light, a queue and a person stop these plans as they stop any other.
    pub(super) fn reach_of_lanes(
        &self,
        scoring: &ScoringScene<'_>,
    ) -> Result<LaneReach, ReflectionError> {
        let mut lanes = LaneReach::default();
        for lane in self.graph.named() {
            if lane.name != CenterlineName::EgoLane && self.graph.blocked.is_none() {
                continue;
            }
            let Some(plan) = self.at_limit(lane.name)? else {
                continue;
            };
            let simulated = [self.simulate(&plan.roll_out(self.scene, self.steps))];
            let scores = score_versions(self.scene, &plan, &[Version::PLAN], scoring, &simulated)?;
            let reach = Reach::best(rivals(&scores, &simulated));
            lanes.best_m = lanes.best_m.max(reach.reach_m);
            if lane.name == CenterlineName::EgoLane {
                lanes.own = reach;
            }
        }
        Ok(lanes)
    }

    /// The reach of each version of the plan at the limit in the ego's lane that rides as the plan
    /// does: brisk versions speed up without a limit of jerk, too. They drive on where
    /// something blocks the lane, as PDM-Closed's proposals do.
    pub(super) fn versions_at_limit(
        &self,
        scoring: &ScoringScene<'_>,
    ) -> Result<Vec<Reach>, ReflectionError> {
        let Some(plan) = self.at_limit(CenterlineName::EgoLane)? else {
            return Ok(Vec::new());
        };
        let simulated: Vec<Vec<EgoState>> = plan
            .without_waiting_place()
            .roll_out_versions(self.scene, self.steps)
            .iter()
            .filter(|(version, _)| version.rides_as_plan())
            .map(|(_, rollout)| self.simulate(rollout))
            .collect();
        let scores = score_proposals(scoring, &simulated)?;
        Ok(rivals(&scores, &simulated).collect())
    }
}

fn rivals(scores: &[ProposalScore], simulated: &[Vec<EgoState>]) -> impl Iterator<Item = Reach> {
    scores
        .iter()
        .zip(simulated)
        .map(|(score, states)| Reach::of_rival(score, states))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reflection::test_reports::judged_beside;
    use crate::reflection::{ProgressReference, ReflectionReport};
    use planagent_world::{ObjectKind, Scene, SceneBuilder, SignalStatus};

    /// Two lanes to the east, the left one along y = 0, and behind them an intersection from x =
    /// 150 on.
    fn road() -> SceneBuilder {
        Scene::builder().lanes(2, [[-50.0, 0.0], [150.0, 0.0]])
    }

    /// The report on a code at the limit on a lane.
    fn judged(scene: SceneBuilder, centerline: CenterlineName) -> ReflectionReport {
        judged_beside(scene, centerline, (Ride::Idm, Ride::Idm))
    }

    #[test]
    fn an_ego_that_stands_behind_a_broken_down_car_has_little_progress_where_there_is_room_beside()
    {
        for (gap, speed) in [(14.0, 0.0), (30.0, 7.0)] {
            let scene = || {
                road()
                    .ego([0.0, -3.5], 0.0, speed)
                    .vehicle([5.0 + gap, -3.5], 0.0, 0.0)
            };
            let (own, left) = (
                judged(scene(), CenterlineName::EgoLane),
                judged(scene(), CenterlineName::LeftLane),
            );
            assert_eq!(own.progress_reference, ProgressReference::Reach);
            let parts = (own.parts, left.parts);
            assert!(
                own.parts.progress < 0.7 && own.score < left.score,
                "{gap}: {parts:?}"
            );
            assert!(left.parts.progress > 0.95, "{gap}: {parts:?}");
        }
    }

    #[test]
    fn an_ego_has_full_progress_where_it_waits() {
        let waiting: [(&str, SceneBuilder); 5] = [
            (
                "no way past",
                road()
                    .vehicle([6.0, -3.5], 0.0, 0.0)
                    .vehicle([4.0, 0.0], 0.0, 0.0),
            ),
            (
                "a person before it",
                road().vehicle([6.0, -3.5], 0.0, 0.0).object(
                    ObjectKind::Pedestrian,
                    [11.0, -5.0],
                    1.6,
                    1.0,
                ),
            ),
            (
                "a person",
                road().object(ObjectKind::Pedestrian, [4.0, -3.5], 1.6, 0.0),
            ),
            (
                "slow traffic",
                road()
                    .vehicle([6.0, -3.5], 0.0, 0.0)
                    .vehicle([12.0, -3.5], 0.0, 0.5),
            ),
            (
                "a red light",
                Scene::builder()
                    .lanes(2, [[-50.0, 0.0], [11.0, 0.0]])
                    .connector([[11.0, 0.0], [30.0, 0.0]])
                    .connector([[11.0, -3.5], [30.0, -3.5]])
                    .light(2, SignalStatus::Red)
                    .light(3, SignalStatus::Red)
                    .vehicle([6.0, -3.5], 0.0, 0.0),
            ),
        ];
        for (why, scene) in waiting {
            let report = judged(scene.ego([0.0, -3.5], 0.0, 0.0), CenterlineName::EgoLane);
            assert!(report.parts.progress >= 1.0, "{why}: {:?}", report.parts);
            assert!(report.progress_m < 0.5, "{why}: it stands");
        }
    }

    /// The same scene with an ego that brakes at 2 m/s².
    fn braking(scene: impl Fn() -> SceneBuilder) -> SceneBuilder {
        let mut ego = *scene().build().unwrap().view().ego;
        ego.acceleration.x = -2.0;
        scene().ego_state(ego)
    }

    #[test]
    fn rivals_ride_as_the_plan_does() {
        let progress = |rides| {
            let scene = braking(|| road().ego([0.0, -3.5], 0.0, 4.0));
            judged_beside(scene, CenterlineName::EgoLane, rides)
                .parts
                .progress
        };
        assert!(progress((Ride::Comfortable, Ride::Comfortable)) > 0.98);
        assert!(progress((Ride::Comfortable, Ride::Idm)) < 0.95);
    }

    #[test]
    fn an_ego_that_brakes_leaves_a_blocked_lane_at_once() {
        for (speed, gap) in [(3.0, 13.0), (4.0, 15.0), (5.0, 17.0)] {
            let of = |lane, ride| {
                let scene = braking(|| {
                    Scene::builder()
                        .lanes(3, [[-50.0, 0.0], [150.0, 0.0]])
                        .ego([0.0, -7.0], 0.0, speed)
                        .vehicle([6.5 + gap, -7.0], 0.0, 0.0)
                });
                judged_beside(scene, lane, (ride, ride))
            };
            let (own, left) = (
                of(CenterlineName::EgoLane, Ride::Comfortable),
                of(CenterlineName::LeftLane, Ride::Comfortable),
            );
            let parts = (own.parts, left.parts);
            assert!(
                left.score >= 0.98 && own.score < 0.98,
                "{speed} {gap}: {parts:?}"
            );
            let idm = of(CenterlineName::LeftLane, Ride::Idm);
            assert_eq!(left.states, idm.states, "{speed} {gap}");
        }
    }
}
