//! One step of PDM-Closed: forecast, proposals, simulation, score, and what is driven (`tuplan_garage`
//! `abstract_pdm_closed_planner.py`).

use super::emergency_brake::{emergency_brake, needs_emergency_brake, standing};
use super::proposals::{PROPOSAL_STEPS, Proposals, TRAJECTORY_STEPS};
use super::{Collided, DrivableMap, Forecast, NoWay, Proposal, ProposalScore, ScoringScene, Way, score_proposals};
use crate::dynamics::{JerkPenalty, simulate_proposal};
use crate::metrics::MetricError;
use crate::world::{EgoState, STEP_US, Scene, Trajectory, TrajectoryError};

/// Why PDM-Closed gives no plan.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PdmError {
    /// There is no way to drive.
    #[error(transparent)]
    NoWay(#[from] NoWay),
    /// The proposals cannot be scored.
    #[error("the proposals cannot be scored")]
    Score(#[from] MetricError),
    /// The planned states are not finite.
    #[error("the planned states make no trajectory")]
    Trajectory(#[from] TrajectoryError),
}

/// What one PDM-Closed planner remembers over its iterations.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PdmMemory {
    /// What the ego has touched.
    pub collided: Collided,
    /// The way that was chosen at the first iteration.
    pub way: Option<Way>,
}

/// What PDM-Closed sees and proposes at one instant.
pub struct PdmInstant<'a> {
    /// The drivable polygons around the ego.
    pub drivable: DrivableMap<'a>,
    /// Everyone else.
    pub forecast: Forecast,
    way: &'a Way,
    scene: &'a Scene<'a>,
}

impl<'a> PdmInstant<'a> {
    /// Looks at a scene along a way. What the ego touches now is added to `collided`.
    pub fn new(scene: &'a Scene<'a>, way: &'a Way, collided: &mut Collided) -> Self {
        let Scene { map, ego, objects, lights, .. } = *scene;
        let forecast = Forecast::new(map, way.lane_set(), ego, objects, lights, collided);
        let drivable = DrivableMap::around(map, way.lane_set(), ego.center().position(), way.layers());
        Self { drivable, forecast, way, scene }
    }

    /// The proposals, rolled out for `steps` steps of 0.1 s.
    pub fn proposals(&self, steps: usize) -> Proposals<'_> {
        let Scene { map, ego, .. } = *self.scene;
        let speed_limit = self.way.speed_limit(map, ego);
        Proposals::generate(map, self.way.paths(), &self.forecast, ego, speed_limit, steps)
    }

    /// What a score needs; `rival_progress` as [`ScoringScene`] has it.
    pub fn scoring(&self, rival_progress: f64) -> ScoringScene<'_> {
        let (drivable, forecast, centerline) = (&self.drivable, &self.forecast, self.way.centerline().line());
        ScoringScene { drivable, forecast, centerline, rival_progress }
    }
}

/// The proposals as PDM's tracker would drive them from the present state, 0.1 s apart.
pub fn simulate_proposals(ego: &EgoState, proposals: &[Proposal]) -> Vec<Vec<EgoState>> {
    proposals.iter().map(|proposal| simulate_proposal(ego, &proposal.poses, JerkPenalty::PdmClosed)).collect()
}

/// What came out of one step.
#[derive(Debug, Clone, PartialEq)]
pub struct PdmPlan {
    /// The proposals; the best one is rolled out over the whole trajectory.
    pub proposals: Vec<Proposal>,
    /// Each as the ego would drive it.
    pub simulated: Vec<Vec<EgoState>>,
    /// Their scores.
    pub scores: Vec<ProposalScore>,
    /// The best proposal, the first of equals.
    pub best: usize,
    /// Whether the emergency brake overrules it.
    pub emergency_brake: bool,
    /// What is to be driven: 81 states 0.1 s apart, of which only the poses are planned.
    pub trajectory: Trajectory,
}

/// One step of PDM-Closed along a way.
///
/// # Errors
/// When the proposals cannot be scored or are not finite.
pub fn plan_along(way: &Way, scene: &Scene<'_>, collided: &mut Collided) -> Result<PdmPlan, PdmError> {
    let ego = scene.ego;
    let instant = PdmInstant::new(scene, way, collided);
    let mut proposals = instant.proposals(PROPOSAL_STEPS);
    let simulated = simulate_proposals(ego, proposals.all());
    let scores = score_proposals(&instant.scoring(0.0), &simulated)?;
    let best = best_of(&scores);
    let brake = needs_emergency_brake(scores[best].first_at_fault_s, ego);
    let trajectory = if brake {
        emergency_brake(ego, TRAJECTORY_STEPS)?
    } else {
        let poses = proposals.continued(best, TRAJECTORY_STEPS).iter().enumerate();
        Trajectory::new(poses.map(|(step, &pose)| standing(ego.time_us + step as i64 * STEP_US, pose)).collect())?
    };
    let proposals = proposals.into_all();
    Ok(PdmPlan { proposals, simulated, scores, best, emergency_brake: brake, trajectory })
}

/// One step of PDM-Closed; the way is chosen at the first one and kept in `memory`.
///
/// # Errors
/// When there is no way, or the proposals cannot be scored or are not finite.
pub fn plan(memory: &mut PdmMemory, scene: &Scene<'_>) -> Result<PdmPlan, PdmError> {
    let PdmMemory { collided, way } = memory;
    let way = match way {
        Some(way) => way,
        None => way.insert(Way::find(scene.map, scene.route, scene.ego)?),
    };
    plan_along(way, scene, collided)
}

/// The first of the best.
fn best_of(scores: &[ProposalScore]) -> usize {
    let better = |best: usize, index: usize| if scores[index].total > scores[best].total { index } else { best };
    (0..scores.len()).fold(0, better)
}
