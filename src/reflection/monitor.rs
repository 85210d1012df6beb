//! Watches the planner in force between planning calls: what of it drives on.

use super::judge::{ReflectionError, look};
use super::rollout::{IdmPlan, Version};
use crate::dynamics::{JerkPenalty, simulate_proposal};
use crate::metrics::MetricError;
use crate::pdm::{PdmMemory, ProposalScore, ReferencePath, needs_emergency_brake, score_proposals};
use crate::world::{EgoState, SceneView};

/// How a planner is watched.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlanMonitor {
    /// Length of the roll-outs, steps of 0.1 s.
    pub steps: usize,
    /// λ: what a version on the planner's own path must score for nothing else to be asked for.
    pub threshold: f64,
    /// Whether the ego may brake hard: by the stop, or by PDM-Closed's emergency brake.
    pub emergency_brake: bool,
}

/// What drives on of a planner.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Choice {
    /// Which version.
    pub version: Version,
    /// Its score by PDM's measure.
    pub score: f64,
    /// Whether PDM-Closed's emergency brake overrules it.
    pub emergency_brake: bool,
}

impl PlanMonitor {
    /// Chooses between the versions of a planner by PDM's measure, as PDM-Closed does between its proposals; progress is relative
    /// to the best of them. In this order: the best of those on the planner's own path, if it scores λ; the best of those
    /// beside it too; and where even that would be at fault for a collision or come too near one, the stop, if it scores more. Equals:
    /// the first. Where nothing helps, a slow ego brakes by PDM-Closed's rule and a fast one drives on: such forecasts are often wrong.
    ///
    /// A path beside the centreline is often a little shorter, so that without the first rule the ego drifts towards whoever drives
    /// in the next lane for a gain of centimetres.
    ///
    /// What the ego touches is remembered; areas and progress are those of the remembered way, which is chosen now if there is
    /// none yet, and progress is that along the planner's own path where there is none at all.
    ///
    /// # Errors
    /// When the roll-outs are too short to be scored.
    pub fn choose(
        &self,
        scene: &SceneView<'_>,
        planner: &IdmPlan,
        memory: &mut PdmMemory,
    ) -> Result<Choice, ReflectionError> {
        if memory.reference_path.is_none() {
            memory.reference_path = ReferencePath::find(scene.map, scene.route, scene.ego).ok();
        }
        let instant = look(scene, memory);
        let centerline =
            memory.reference_path.as_ref().map_or(planner.path(), |reference_path| reference_path.centerline().line());
        let (versions, batch): (Vec<Version>, Vec<Vec<EgoState>>) = planner
            .roll_out_versions(scene, self.steps)
            .into_iter()
            .map(|(version, rollout)| (version, simulate_proposal(scene.ego, &rollout.poses, JerkPenalty::PdmClosed)))
            .unzip();
        let scores = score_proposals(&instant.scoring(centerline, 0.0), &batch)?;
        let scored: Vec<(Version, ProposalScore)> = versions.into_iter().zip(scores).collect();
        self.best(&scored, scene.ego).ok_or(ReflectionError::Score(MetricError::TooFewSamples { needed: 1, got: 0 }))
    }

    fn best(&self, scored: &[(Version, ProposalScore)], ego: &EgoState) -> Option<Choice> {
        let best = |among: fn(Version) -> bool| {
            let among = scored.iter().filter(|&&(version, _)| among(version));
            among.rev().max_by(|(_, a), (_, b)| a.total.total_cmp(&b.total))
        };
        let own = best(Version::is_on_own_path).filter(|(_, score)| score.total >= self.threshold);
        let driving = own.or_else(|| best(|version| version != Version::STOP))?;
        let stop = scored.iter().find(|&&(version, _)| version == Version::STOP);
        let helps = |(_, stop): &&(Version, ProposalScore)| {
            self.emergency_brake && is_in_danger(&driving.1) && stop.total > driving.1.total
        };
        let &(version, score) = stop.filter(helps).unwrap_or(driving);
        let brakes = self.emergency_brake && needs_emergency_brake(score.first_at_fault_s, ego);
        Some(Choice { version, score: score.total, emergency_brake: brakes })
    }
}

/// Whether what drives would be at fault for a collision, or come too near one on a way that is otherwise fit to drive: where it leaves
/// the drivable area as well, as at the mouth of a junction, the ego would stop for good.
fn is_in_danger(driving: &ProposalScore) -> bool {
    driving.no_at_fault_collisions < 1.0 || (driving.time_to_collision < 1.0 && driving.multiplier() > 0.0)
}
