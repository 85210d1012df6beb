//! Runtime monitoring: scores the active plan and its versions at every step and chooses one.

use super::handover::{Handover, better_proposal};
use super::idm_plan::IdmPlan;
use super::judge::{ReflectionError, contest_of_versions, observe, verdicts};
use super::rollout::Version;
use planagent_score::metrics::MetricError;
use planagent_score::pdm::{
    Contest, PdmMemory, ProposalScore, TRAJECTORY_STEPS, emergency_brake, needs_emergency_brake,
};
use planagent_world::dynamics::{JerkPenalty, simulate_proposal};
use planagent_world::{EgoState, SceneView, Trajectory};

/// How a plan is monitored.
/// Why: docs/decisions/101-monitoring.md.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlanMonitor {
    /// Length of the roll-outs, steps of 0.1 s.
    pub steps: usize,
    /// λ: a version on the plan's own path that scores this is executed, whatever the others score.
    pub threshold: f64,
    /// Whether the ego may brake hard: by the stop, or by PDM-Closed's emergency brake.
    pub emergency_brake: bool,
    /// Whether the best of PDM-Closed's proposals drives where the chosen version scores less than
    /// λ and the proposal scores more.
    /// Why: docs/decisions/129-judged-handover.md.
    pub handover: bool,
    /// What the plan of the same code in a lane beside must score for the ego to swerve there, where
    /// people are near and its own plan scores less than λ; `None` where it does not.
    /// Why: docs/decisions/154-evade-at-once.md.
    pub evasion: Option<f64>,
}

/// The version that the monitor chooses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Choice {
    /// The version.
    pub version: Version,
    /// Its score by PDM's measure.
    pub score: f64,
    /// Whether PDM-Closed's emergency brake overrules it.
    pub emergency_brake: bool,
    /// Whether it is an overtake over the oncoming lane that breaks a rule.
    pub is_refused: bool,
}

/// One monitored step.
#[derive(Debug, Clone, PartialEq)]
pub struct MonitoredStep {
    /// The trajectory of the chosen version, or of the emergency brake.
    pub trajectory: Trajectory,
    /// The version's score by PDM's measure.
    pub score: f64,
    /// Whether the ego brakes hard: the version is the stop, or the emergency brake overrules it.
    pub brakes: bool,
    /// Whether the version is an overtake over the oncoming lane that breaks a rule.
    pub is_refused: bool,
    /// Whether it is one of PDM-Closed's proposals in place of a version.
    pub is_handover: bool,
}

impl MonitoredStep {
    /// Whether it keeps the rules of an overtake where `other` does not, or else avoids hard
    /// braking where `other` does not, or else has the higher score. Scores of hard braking say
    /// little: their progress is relative to versions that all collide.
    pub(crate) fn is_better_than(&self, other: &Self) -> bool {
        (!self.is_refused, !self.brakes, self.score)
            > (!other.is_refused, !other.brakes, other.score)
    }
}

impl PlanMonitor {
    /// The trajectory of the version that [`Self::choose`] chooses, or of one of PDM-Closed's
    /// proposals ([`Self::handed_over`]).
    ///
    /// # Errors
    /// When the roll-outs are too short to be scored, or the ego's state is not finite.
    pub fn step(
        &self,
        scene: &SceneView<'_>,
        plan: &IdmPlan,
        memory: &mut PdmMemory,
    ) -> Result<MonitoredStep, ReflectionError> {
        let (choice, step) = self.own_step(scene, plan, memory)?;
        let handover = self.handed_over(scene, (plan, choice), memory)?;
        Ok(handover.unwrap_or(step))
    }

    /// The trajectory of the version that [`Self::choose`] chooses.
    pub(crate) fn own_step(
        &self,
        scene: &SceneView<'_>,
        plan: &IdmPlan,
        memory: &mut PdmMemory,
    ) -> Result<(Choice, MonitoredStep), ReflectionError> {
        let choice = self.choose(scene, plan, memory)?;
        let trajectory = if choice.emergency_brake {
            emergency_brake(scene.ego, TRAJECTORY_STEPS)?
        } else {
            plan.roll_out_version(choice.version, scene, TRAJECTORY_STEPS)
                .to_trajectory(scene.ego)?
        };
        let step = MonitoredStep {
            trajectory,
            score: choice.score,
            brakes: choice.emergency_brake || choice.version == Version::STOP,
            is_refused: choice.is_refused,
            is_handover: false,
        };
        Ok((choice, step))
    }

    /// The step of the best of PDM-Closed's proposals, where the version scores less than λ and the
    /// proposal more.
    pub(crate) fn handed_over(
        &self,
        scene: &SceneView<'_>,
        (plan, choice): (&IdmPlan, Choice),
        memory: &mut PdmMemory,
    ) -> Result<Option<MonitoredStep>, ReflectionError> {
        if !self.handover || choice.score >= self.threshold {
            return Ok(None);
        }
        better_proposal(scene, (plan, choice.version), memory, self.steps)?
            .map(|better| self.hand_over(scene.ego, &better))
            .transpose()
    }

    /// Whether something else may drive in place of a step: it brakes hard, or scores less than λ.
    pub(crate) fn is_poor(&self, step: &MonitoredStep) -> bool {
        step.brakes || step.score < self.threshold
    }

    fn hand_over(&self, ego: &EgoState, to: &Handover) -> Result<MonitoredStep, ReflectionError> {
        let brakes = self.emergency_brake && needs_emergency_brake(to.score.first_at_fault_s, ego);
        let trajectory = if brakes {
            emergency_brake(ego, TRAJECTORY_STEPS)?
        } else {
            to.rollout.to_trajectory(ego)?
        };
        Ok(MonitoredStep {
            trajectory,
            score: to.score.total,
            brakes,
            is_refused: false,
            is_handover: true,
        })
    }

    /// Chooses between the versions of a plan by PDM's measure, as PDM-Closed does between its
    /// proposals; progress is relative to the best of them. In this order:
    /// 1. The best version on the plan's own path, if it scores λ. A path beside the centerline is
    ///    often a little shorter; without this rule the ego drifts towards the next lane for a gain
    ///    of centimeters.
    /// 2. The best of all versions but the stop.
    /// 3. The stop, where that version would be at fault for a collision or come near one, or is a
    ///    refused overtake, and the stop scores more.
    ///
    /// Of equals the first is chosen. Where nothing avoids the collision, a slow ego brakes by
    /// PDM-Closed's rule, and a fast one executes the plan: such forecasts are often wrong.
    ///
    /// A version that passes something over the oncoming lane and breaks a rule has the score 0,
    /// until the ego is beside what it passes.
    ///
    /// Areas and progress are those of the reference path in `memory`, which is chosen now if there
    /// is none. Where PDM-Closed finds none, progress is measured along the plan's own path. What
    /// the ego touches is added to `memory`.
    ///
    /// # Errors
    /// When the roll-outs are too short to be scored.
    pub fn choose(
        &self,
        scene: &SceneView<'_>,
        plan: &IdmPlan,
        memory: &mut PdmMemory,
    ) -> Result<Choice, ReflectionError> {
        memory.keep_reference_path(scene);
        let instant = observe(scene, memory);
        let centerline = memory
            .reference_path
            .as_ref()
            .map_or(plan.path(), |path| path.centerline().line());
        let (versions, batch): (Vec<Version>, Vec<Vec<EgoState>>) = plan
            .roll_out_versions(scene, self.steps)
            .into_iter()
            .map(|(version, rollout)| {
                (
                    version,
                    simulate_proposal(scene.ego, &rollout.poses, JerkPenalty::PdmClosed),
                )
            })
            // All versions are in one contest, since progress is relative to the best of them.
            .unzip();
        let verdicts = verdicts(scene, plan, &versions);
        let scoring = instant.scoring(centerline, 0.0);
        let mut contest = contest_of_versions(plan, &verdicts, &scoring, &batch)?;
        self.best(
            &versions,
            &mut contest,
            plan.oncoming().is_some(),
            scene.ego,
        )?
        .ok_or(ReflectionError::Score(MetricError::TooFewSamples {
            needed: 1,
            got: 0,
        }))
    }

    /// The version to execute: the best one on the plan's own path where it scores λ, else the best
    /// of all but the stop. The stop where that one is in danger or refused, and the stop scores
    /// more.
    /// Why: docs/decisions/101-monitoring.md.
    fn best(
        &self,
        versions: &[Version],
        contest: &mut Contest<'_>,
        overtakes: bool,
        ego: &EgoState,
    ) -> Result<Option<Choice>, MetricError> {
        let is_refused = |score: &ProposalScore| overtakes && score.driving_direction <= 0.0;
        let own = contest
            .best(|index| versions[index].is_on_own_path())?
            .filter(|(_, score)| score.total >= self.threshold);
        let moving = match own {
            Some(own) => Some(own),
            None => contest.best(|index| versions[index] != Version::STOP)?,
        };
        let Some(mut chosen) = moving else {
            return Ok(None);
        };
        // The stop is judged last, since it rarely matters.
        let matters = is_in_danger(&chosen.1) || is_refused(&chosen.1);
        if self.emergency_brake
            && matters
            && let Some(stop) = contest.best(|index| versions[index] == Version::STOP)?
            && stop.1.total > chosen.1.total
        {
            chosen = stop;
        }
        let (index, score) = chosen;
        let emergency_brake =
            self.emergency_brake && needs_emergency_brake(score.first_at_fault_s, ego);
        Ok(Some(Choice {
            version: versions[index],
            score: score.total,
            emergency_brake,
            is_refused: is_refused(&score),
        }))
    }
}

/// Whether a version would be at fault for a collision, or come near one while all of its path can
/// be driven. A path that leaves the drivable area does not count: at the mouth of a junction the
/// ego would stop and never start again.
fn is_in_danger(moving: &ProposalScore) -> bool {
    moving.no_at_fault_collisions < 1.0
        || (moving.time_to_collision < 1.0 && moving.multiplier() > 0.0)
}
