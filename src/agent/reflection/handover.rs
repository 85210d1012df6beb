//! PDM-Closed's proposals beside the versions of a plan, judged by the same score.

use super::idm_plan::IdmPlan;
use super::judge::{ReflectionError, observe_along, score_versions};
use super::rollout::{Rollout, Version};
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
    // Reversed, because `max_by` takes the last of equals and the first should win.
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
    use crate::reasoning::PlannerCode;
    use crate::reflection::{LeadPolicy, MonitoredStep, PlanBuilder, PlanMonitor, Ride};
    use planagent_score::pdm::PdmMemory;
    use planagent_world::Scene;

    /// A step of a plan in the ego's lane on a free road, of an ego at 8 m/s.
    fn step(target_speed: f64, threshold: f64, handover: bool) -> MonitoredStep {
        let scene = Scene::builder()
            .lanes(2, [[-50.0, 0.0], [250.0, 0.0]])
            .ego([0.0, -3.5], 0.0, 8.0)
            .build()
            .unwrap();
        let view = scene.view();
        let graph = LaneGraph::build(&view, DEFAULT_NODE_LENGTH).unwrap();
        let builder = PlanBuilder {
            lead_policy: LeadPolicy::Nearest,
            ride: Ride::Idm,
            horizon_s: 8.0,
        };
        let code = PlannerCode {
            centerline: CenterlineName::EgoLane,
            lead_agent: None,
            target_speed,
            accel_max: 1.5,
            decel_max: 3.0,
        };
        let plan = builder
            .build(GraphedScene::new(&view, &graph), code)
            .unwrap()
            .unwrap();
        let monitor = PlanMonitor {
            steps: 40,
            threshold,
            emergency_brake: true,
            handover,
            evasion: None,
        };
        monitor
            .step(&view, &plan, &mut PdmMemory::default())
            .unwrap()
    }

    /// How far a step's trajectory leads, meters.
    fn reach(step: &MonitoredStep) -> f64 {
        step.trajectory
            .states()
            .last()
            .map_or(0.0, |last| last.rear_axle.x)
    }

    #[test]
    fn a_proposal_drives_where_the_plan_scores_too_little_and_it_gets_further() {
        let never_passes = 1.1;
        let (own, handed) = (
            step(2.0, never_passes, false),
            step(2.0, never_passes, true),
        );
        assert!(!own.is_handover && handed.is_handover, "{}", handed.score);
        assert!(reach(&handed) > 2.0 * reach(&own), "{}", reach(&handed));
    }

    #[test]
    fn a_plan_drives_itself_where_it_passes_or_no_proposal_is_better() {
        for (target_speed, threshold) in [(2.0, 0.75), (13.0, 0.75), (30.0, 1.1)] {
            let handed = step(target_speed, threshold, true);
            assert!(!handed.is_handover, "{target_speed}: {}", handed.score);
            let own = step(target_speed, threshold, false);
            assert_eq!(handed.trajectory, own.trajectory);
        }
    }
}
