//! One step of PDM-Closed: forecast, proposals, simulation, score, trajectory (`tuplan_garage`
//! `abstract_pdm_closed_planner.py`).

use super::emergency_brake::{emergency_brake, needs_emergency_brake, standing};
use super::parameters::TRAJECTORY_STEPS;
use super::proposals::{PROPOSAL_STEPS, Proposals};
use super::{
    Collided, DrivableLayers, DrivableMap, Forecast, NoReferencePath, OvertakeVerdict,
    PdmParameters, Proposal, ProposalScore, ReferencePath, ScoringScene, score_overtake,
    score_proposals,
};
use crate::metrics::MetricError;
use planagent_world::dynamics::{JerkPenalty, simulate_proposal};
use planagent_world::geometry::{Polyline, Pose};
use planagent_world::{EgoState, LaneId, STEP_US, SceneView, Trajectory, TrajectoryError};
use std::collections::BTreeSet;

/// Scores that differ by less are equal. UTM coordinates in `f64` round at 1e-10 m, and the
/// progress of 0.1 m divides that.
const EQUAL_SCORES: f64 = 1e-8;

/// Why PDM-Closed gives no plan.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the message of a variant says what it is")]
pub enum PdmError {
    #[error(transparent)]
    NoReferencePath(#[from] NoReferencePath),
    #[error("the proposals cannot be scored")]
    Score(#[from] MetricError),
    #[error("the planned states make no trajectory")]
    Trajectory(#[from] TrajectoryError),
}

/// The memory of PDM-Closed over its iterations.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PdmMemory {
    /// The objects that the ego has touched.
    pub collided: Collided,
    /// The reference path; PDM-Closed chooses it at its first iteration and keeps it.
    pub reference_path: Option<ReferencePath>,
}

impl PdmMemory {
    /// Chooses the reference path for the ego's present place; none where the route has no lanes.
    pub fn choose_reference_path(&mut self, scene: &SceneView<'_>) {
        self.reference_path = ReferencePath::find(scene.map, scene.route, scene.ego).ok();
    }

    /// Chooses the reference path if there is none.
    pub fn keep_reference_path(&mut self, scene: &SceneView<'_>) {
        if self.reference_path.is_none() {
            self.choose_reference_path(scene);
        }
    }
}

/// PDM-Closed's view of the scene at one instant.
pub struct PdmInstant<'a> {
    /// The drivable polygons around the ego.
    pub drivable: DrivableMap<'a>,
    /// The forecast of all objects.
    pub forecast: Forecast,
}

impl<'a> PdmInstant<'a> {
    /// The view for a route of these lanes. What the ego touches now is added to `collided`.
    pub fn new(
        scene: &SceneView<'a>,
        route_lanes: &BTreeSet<LaneId>,
        layers: DrivableLayers,
        collided: &mut Collided,
    ) -> Self {
        let SceneView {
            map,
            ego,
            objects,
            lights,
            ..
        } = *scene;
        let forecast = Forecast::new(map, route_lanes, ego, objects, lights, collided);
        let drivable = DrivableMap::around(map, route_lanes, ego.center().position(), layers);
        Self { drivable, forecast }
    }

    /// The view along a reference path.
    pub fn along(
        reference_path: &ReferencePath,
        scene: &SceneView<'a>,
        collided: &mut Collided,
    ) -> Self {
        Self::new(
            scene,
            reference_path.lane_set(),
            reference_path.layers(),
            collided,
        )
    }

    /// The proposals along a reference path from the ego's present state, `steps` steps of 0.1 s
    /// long.
    pub fn proposals<'s>(
        &'s self,
        reference_path: &'s ReferencePath,
        ego: &EgoState,
        steps: usize,
    ) -> Proposals<'s> {
        self.tuned_proposals(reference_path, ego, PdmParameters::default(), steps)
    }

    /// As [`Self::proposals`], with other parameters than PDM-Closed's.
    pub(crate) fn tuned_proposals<'s>(
        &'s self,
        reference_path: &'s ReferencePath,
        ego: &EgoState,
        parameters: PdmParameters,
        steps: usize,
    ) -> Proposals<'s> {
        let map = self.drivable.map();
        Proposals::generate(
            map,
            reference_path.paths(),
            &self.forecast,
            ego,
            reference_path.speed_limit(map, ego),
            parameters,
            steps,
        )
    }

    /// The input of the score beside the proposals; progress is measured along `centerline`,
    /// `rival_progress` is that of [`ScoringScene`].
    pub fn scoring<'s>(
        &'s self,
        centerline: &'s Polyline,
        rival_progress: f64,
    ) -> ScoringScene<'s> {
        ScoringScene {
            drivable: &self.drivable,
            forecast: &self.forecast,
            centerline,
            rival_progress,
        }
    }
}

/// The proposals as PDM's tracker follows them from the present state, a state every 0.1 s.
pub fn simulate_proposals(ego: &EgoState, proposals: &[Proposal]) -> Vec<Vec<EgoState>> {
    proposals
        .iter()
        .map(|proposal| simulate_proposal(ego, &proposal.poses, JerkPenalty::PdmClosed))
        .collect()
}

/// The result of one step.
#[derive(Debug, Clone, PartialEq)]
pub struct PdmPlan {
    /// The proposals; the best one is as long as the trajectory.
    pub proposals: Vec<Proposal>,
    /// Their simulated states.
    pub simulated: Vec<Vec<EgoState>>,
    /// Their scores.
    pub scores: Vec<ProposalScore>,
    /// Index of the best proposal, the first of equals.
    pub best: usize,
    /// Whether the emergency brake overrules it.
    pub emergency_brake: bool,
    /// The trajectory: 81 states 0.1 s apart, of which only the poses are planned.
    pub trajectory: Trajectory,
}

/// One step of PDM-Closed along a reference path.
///
/// # Errors
/// When the proposals cannot be scored or are not finite.
pub fn plan_along(
    reference_path: &ReferencePath,
    scene: &SceneView<'_>,
    collided: &mut Collided,
) -> Result<PdmPlan, PdmError> {
    plan_tuned(reference_path, scene, collided, PdmParameters::default())
}

/// One step of PDM-Closed with other parameters along a reference path.
///
/// # Errors
/// As [`plan_along`].
pub fn plan_tuned(
    reference_path: &ReferencePath,
    scene: &SceneView<'_>,
    collided: &mut Collided,
    parameters: PdmParameters,
) -> Result<PdmPlan, PdmError> {
    let ego = scene.ego;
    let instant = PdmInstant::along(reference_path, scene, collided);
    let mut proposals = instant.tuned_proposals(reference_path, ego, parameters, PROPOSAL_STEPS);
    let simulated = simulate_proposals(ego, proposals.all());
    let scores = score_proposals(
        &instant.scoring(reference_path.centerline().line(), 0.0),
        &simulated,
    )?;
    let best = best_of(&scores).ok_or(MetricError::TooFewSamples { needed: 1, got: 0 })?;
    let brake =
        parameters.emergency_brake && needs_emergency_brake(scores[best].first_at_fault_s, ego);
    let trajectory = if brake {
        emergency_brake(ego, TRAJECTORY_STEPS)?
    } else {
        // Only the best proposal is rolled out to the trajectory's end; scores need fewer steps.
        let poses = proposals
            .continued(best, TRAJECTORY_STEPS)
            .iter()
            .enumerate();
        Trajectory::new(
            poses
                .map(|(step, &pose)| standing(ego.time_us + step as i64 * STEP_US, pose))
                .collect(),
        )?
    };
    let proposals = proposals.into_all();
    Ok(PdmPlan {
        proposals,
        simulated,
        scores,
        best,
        emergency_brake: brake,
        trajectory,
    })
}

/// An overtake of something over lanes against traffic.
pub struct Overtake<'a> {
    /// The lanes against traffic.
    pub lanes: &'a [LaneId],
    /// Length of the roll-outs that are judged, steps of 0.1 s.
    pub steps: usize,
    /// The verdict on the poses of a roll-out.
    pub verdict: &'a dyn Fn(&[Pose]) -> OvertakeVerdict,
}

/// One step of PDM-Closed along several reference paths at once: the best of all proposals is
/// executed. Progress is measured along the first path, and the collisions and areas are those of
/// its route. On the lanes of `overtake`, a proposal needs its verdict.
///
/// # Errors
/// As [`plan_along`].
pub fn plan_among(
    own: &ReferencePath,
    others: &[ReferencePath],
    overtake: Option<&Overtake<'_>>,
    scene: &SceneView<'_>,
    collided: &mut Collided,
) -> Result<PdmPlan, PdmError> {
    let (ego, parameters) = (scene.ego, PdmParameters::default());
    let instant = PdmInstant::along(own, scene, collided);
    let mut sets: Vec<Proposals<'_>> = std::iter::once(own)
        .chain(others)
        .map(|path| instant.proposals(path, ego, PROPOSAL_STEPS))
        .collect();
    let all = sets
        .iter()
        .flat_map(|set| simulate_proposals(ego, set.all()));
    let simulated: Vec<Vec<EgoState>> = all.collect();
    let scoring = instant.scoring(own.centerline().line(), 0.0);
    let scores = match overtake {
        None => score_proposals(&scoring, &simulated)?,
        Some(overtake) => score_overtake(
            &scoring,
            overtake.lanes,
            &verdicts(&mut sets, overtake),
            &simulated,
        )?,
    };
    let best = best_of(&scores).ok_or(MetricError::TooFewSamples { needed: 1, got: 0 })?;
    let brake =
        parameters.emergency_brake && needs_emergency_brake(scores[best].first_at_fault_s, ego);
    // A proposal continues on its own path, so its place among all becomes a set and a place there.
    let (mut set, mut place) = (0, best);
    while place >= sets[set].all().len() {
        place -= sets[set].all().len();
        set += 1;
    }
    let trajectory = if brake {
        emergency_brake(ego, TRAJECTORY_STEPS)?
    } else {
        let poses = sets[set]
            .continued(place, TRAJECTORY_STEPS)
            .iter()
            .take(TRAJECTORY_STEPS + 1)
            .enumerate();
        Trajectory::new(
            poses
                .map(|(step, &pose)| standing(ego.time_us + step as i64 * STEP_US, pose))
                .collect(),
        )?
    };
    let proposals = sets.into_iter().flat_map(Proposals::into_all).collect();
    Ok(PdmPlan {
        proposals,
        simulated,
        scores,
        best,
        emergency_brake: brake,
        trajectory,
    })
}

/// The verdicts on all proposals, rolled out as far as they have to be.
fn verdicts(sets: &mut [Proposals<'_>], overtake: &Overtake<'_>) -> Vec<OvertakeVerdict> {
    let of_set = |set: &mut Proposals<'_>| -> Vec<OvertakeVerdict> {
        (0..set.all().len())
            .map(|place| (overtake.verdict)(set.continued(place, overtake.steps)))
            .collect()
    };
    sets.iter_mut().flat_map(of_set).collect()
}

/// One step of PDM-Closed; the reference path is chosen at the first one and kept in `memory`.
///
/// # Errors
/// When there is no reference path, or the proposals cannot be scored or are not finite.
pub fn plan(memory: &mut PdmMemory, scene: &SceneView<'_>) -> Result<PdmPlan, PdmError> {
    let PdmMemory {
        collided,
        reference_path,
    } = memory;
    let reference_path = match reference_path {
        Some(reference_path) => reference_path,
        none => none.insert(ReferencePath::find(scene.map, scene.route, scene.ego)?),
    };
    plan_along(reference_path, scene, collided)
}

/// Index of the best score, the first of equals; `None` without scores.
///
/// `tuplan_garage` takes the maximum, so rounding chooses where proposals are equally far along.
/// Beside the centerline and on it they often are, where the ego has almost stopped.
pub(crate) fn best_of(scores: &[ProposalScore]) -> Option<usize> {
    let highest = scores
        .iter()
        .map(|score| score.total)
        .filter(|total| !total.is_nan())
        .max_by(f64::total_cmp)?;
    scores
        .iter()
        .position(|score| score.total >= highest - EQUAL_SCORES)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounding_does_not_choose_between_equal_scores() {
        let score = |total| ProposalScore {
            total,
            no_at_fault_collisions: 1.0,
            drivable_area: 1.0,
            driving_direction: 1.0,
            progress: 1.0,
            time_to_collision: 1.0,
            comfort: 1.0,
            progress_m: 0.1,
            first_at_fault_s: None,
            first_ttc_s: None,
        };
        assert_eq!(best_of(&[]), None);
        assert_eq!(best_of(&[0.5, 1.0 - 1e-13, 1.0].map(score)), Some(1));
        assert_eq!(best_of(&[0.5, 1.0 - 1e-6, 1.0].map(score)), Some(2));
    }
}
