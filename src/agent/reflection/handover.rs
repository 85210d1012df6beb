//! PDM-Closed's proposals beside the versions of a plan, judged by the same score.

use super::judge::{ReflectionError, observe_along, score_versions};
use super::rollout::{IdmPlan, Rollout, Version};
use planagent_score::pdm::{
    PdmMemory, ProposalScore, TRAJECTORY_STEPS, score_proposals, simulate_proposals,
};
use planagent_world::dynamics::{JerkPenalty, simulate_proposal};
use planagent_world::{STEP_S, SceneView};

/// What a proposal must score more than the plan.
/// Why: docs/decisions/129-judged-handover.md.
const MIN_GAIN: f64 = 0.05;
/// Below this progress of the best, standing still is as good as any, meters (PDM's scorer).
const STANDS: f64 = 0.1;

/// A proposal of PDM-Closed that scores more than a version of a plan.
pub(super) struct Handover {
    /// Its score, with progress relative to the best of all.
    pub(super) score: ProposalScore,
    /// Its roll-out, as long as a trajectory.
    pub(super) rollout: Rollout,
}

/// The best of PDM-Closed's proposals, the first of equals, where it scores more than a version of
/// `plan`. All have the same forecast, areas and centerline, and progress is relative to the best
/// of all. `None` where PDM-Closed has no reference path.
///
/// # Errors
/// When the roll-outs are too short to be scored.
pub(super) fn better_proposal(
    scene: &SceneView<'_>,
    (plan, version): (&IdmPlan, Version),
    memory: &mut PdmMemory,
    steps: usize,
) -> Result<Option<Handover>, ReflectionError> {
    let PdmMemory {
        reference_path: Some(reference_path),
        collided,
    } = memory
    else {
        return Ok(None);
    };
    let instant = observe_along(reference_path, scene, collided);
    let scoring = instant.scoring(reference_path.centerline().line(), 0.0);
    let rollout = plan.roll_out_version(version, scene, steps);
    let own = [simulate_proposal(
        scene.ego,
        &rollout.poses,
        JerkPenalty::PdmClosed,
    )];
    let own = score_versions(scene, plan, &[version], &scoring, &own)?;
    let mut proposals = instant.proposals(reference_path, scene.ego, steps);
    let scores = score_proposals(&scoring, &simulate_proposals(scene.ego, proposals.all()))?;
    let progress = |score: &ProposalScore| score.progress_m * score.multiplier();
    let most = own.iter().chain(&scores).map(progress).fold(0.0, f64::max);
    let relative = |score: &ProposalScore| {
        score.with_progress(if most > STANDS {
            progress(score) / most
        } else {
            f64::from(u8::from(score.multiplier() > 0.0))
        })
    };
    let needed = own
        .iter()
        .map(|own| relative(own).total)
        .fold(0.0, f64::max)
        + MIN_GAIN;
    let scores = scores.iter().map(relative).enumerate().rev();
    let best = scores.max_by(|(_, a), (_, b)| a.total.total_cmp(&b.total));
    let Some((index, score)) = best.filter(|(_, score)| score.total > needed) else {
        return Ok(None);
    };
    let poses = proposals.continued(index, TRAJECTORY_STEPS).to_vec();
    let speeds = std::iter::once(scene.ego.velocity.x.max(0.0))
        .chain(poses.windows(2).map(|w| w[0].distance(&w[1]) / STEP_S))
        .collect();
    Ok(Some(Handover {
        score,
        rollout: Rollout { poses, speeds },
    }))
}

#[cfg(test)]
mod tests {
    use crate::environment::{CenterlineName, DEFAULT_NODE_LENGTH, GraphedScene, LaneGraph};
    use crate::reflection::{LeadPolicy, MonitoredStep, PlanBuilder, PlanMonitor, Ride};
    use planagent_score::pdm::PdmMemory;
    use planagent_world::{Scene, SceneBuilder};

    /// Two lanes to the east, the left one along y = 0, and the ego in the right one.
    fn road() -> SceneBuilder {
        Scene::builder()
            .lanes(2, [[-50.0, 0.0], [250.0, 0.0]])
            .ego([0.0, -3.5], 0.0, 10.0)
    }

    /// A step of the plan at the limit on a lane.
    fn step(scene: SceneBuilder, lane: CenterlineName, handover: bool) -> MonitoredStep {
        let scene = scene.build().unwrap();
        let view = scene.view();
        let graph = LaneGraph::build(&view, DEFAULT_NODE_LENGTH).unwrap();
        let builder = PlanBuilder {
            lead_policy: LeadPolicy::Nearest,
            ride: Ride::Idm,
            horizon_s: 8.0,
        };
        let plan = builder
            .at_limit(GraphedScene::new(&view, &graph), lane)
            .unwrap()
            .unwrap();
        let monitor = PlanMonitor {
            steps: 40,
            threshold: 0.75,
            emergency_brake: true,
            handover,
        };
        monitor
            .step(&view, &plan, &mut PdmMemory::default())
            .unwrap()
    }

    #[test]
    fn a_proposal_drives_where_the_plan_would_touch_a_car_beside_the_ego() {
        let beside = || road().vehicle([1.0, 0.0], 0.0, 10.0);
        let without = step(beside(), CenterlineName::LeftLane, false);
        let with = step(beside(), CenterlineName::LeftLane, true);
        assert!(!without.is_handover && without.score < 0.75, "{without:?}");
        assert!(with.is_handover && with.score > without.score, "{with:?}");
        let end = with.trajectory.states().last().unwrap().rear_axle;
        assert!(end.x > 40.0 && (end.y + 3.5).abs() < 1.1, "{end:?}");
    }

    #[test]
    fn a_plan_that_scores_the_threshold_drives_itself() {
        for lane in [CenterlineName::EgoLane, CenterlineName::LeftLane] {
            let with = step(road(), lane, true);
            assert!(!with.is_handover && with.score >= 0.75, "{with:?}");
            assert_eq!(with.trajectory, step(road(), lane, false).trajectory);
        }
    }
}
