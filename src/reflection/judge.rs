//! Scores generated planners by PDM's measure over a short horizon.

use super::report::{ProgressReference, ReflectionReport, SubScores, Verdict};
use super::rollout::{GeneratedPlanner, LeadPolicy, Rollout};
use crate::dynamics::{JerkPenalty, simulate_proposal};
use crate::environment::{CenterlineName, LaneGraph};
use crate::geometry::GeometryError;
use crate::metrics::MetricError;
use crate::pdm::{
    Collided, DrivableLayers, DrivableMap, EgoAreas, Forecast, ProposalScore, ScoringScene, no_at_fault_collisions,
    score_proposals,
};
use crate::reasoning::PlannerCode;
use crate::world::{EgoState, STEP_S, Scene};

/// Speeds of the proposals that progress is compared with, as fractions of the speed limit (PDM-Closed's).
const SPEED_FRACTIONS: [f64; 5] = [0.2, 0.4, 0.6, 0.8, 1.0];
/// Speed limit where the map has none, m/s (PDM-Closed's).
const FALLBACK_LIMIT: f64 = 15.0;
/// Maximum acceleration of the proposals, m/s² (PDM-Closed's).
const PROPOSAL_ACCEL: f64 = 1.5;
/// Maximum deceleration of the proposals, m/s² (PDM-Closed's).
const PROPOSAL_DECEL: f64 = 3.0;

/// The emergency brake looks this far ahead, seconds (PDM-Closed's).
const EMERGENCY_S: f64 = 2.0;
/// It overrules only at this speed or below, m/s (PDM-Closed's).
const EMERGENCY_SPEED: f64 = 5.0;

/// Whether PDM-Closed's emergency brake would overrule this roll-out: the ego is slow and would be at fault for a collision
/// within two seconds.
pub fn needs_emergency_brake(scene: &Scene<'_>, rollout: &Rollout) -> bool {
    if scene.ego.speed() > EMERGENCY_SPEED {
        return false;
    }
    let steps = (EMERGENCY_S / STEP_S).round() as usize;
    let reference = rollout.poses.get(..=steps).unwrap_or(&rollout.poses);
    let states = simulate_proposal(scene.ego, reference, JerkPenalty::PdmClosed);
    let Scene { map, ego, objects, lights, .. } = *scene;
    let route_lanes = scene.route.lanes(map);
    let forecast = Forecast::new(map, &route_lanes, ego, objects, lights, &mut Collided::default());
    let drivable = DrivableMap::around(map, &route_lanes, ego.center().position(), DrivableLayers::DrivableArea);
    let areas: Vec<EgoAreas> = states.iter().map(|state| drivable.areas_of(state)).collect();
    no_at_fault_collisions(&states, &areas, &forecast).state.is_some()
}

/// Why a planner cannot be judged at all.
#[derive(Debug, thiserror::Error)]
pub enum ReflectionError {
    /// The horizon has too few states.
    #[error("the roll-out cannot be scored")]
    Score(#[from] MetricError),
    /// The ego's pose is not finite.
    #[error("the roll-out has no path")]
    Path(#[from] GeometryError),
}

/// What all planners of one planning call are judged against.
pub struct Judge<'a> {
    scene: &'a Scene<'a>,
    graph: &'a LaneGraph,
    drivable: DrivableMap<'a>,
    forecast: Forecast,
    steps: usize,
    rival_progress: f64,
}

impl<'a> Judge<'a> {
    /// Looks at the scene: forecast, areas, and the progress of the proposals on the ego's own centreline.
    ///
    /// # Errors
    /// When the horizon is too short to be scored or the ego's pose is not finite.
    pub fn new(scene: &'a Scene<'a>, graph: &'a LaneGraph, horizon_s: f64) -> Result<Self, ReflectionError> {
        let route_lanes = scene.route.lanes(scene.map);
        let center = scene.ego.center().position();
        let drivable = DrivableMap::around(scene.map, &route_lanes, center, DrivableLayers::DrivableArea);
        let Scene { map, ego, objects, lights, .. } = *scene;
        let forecast = Forecast::new(map, &route_lanes, ego, objects, lights, &mut Collided::default());
        let steps = (horizon_s / STEP_S).round() as usize;
        let mut judge = Self { scene, graph, drivable, forecast, steps, rival_progress: 0.0 };
        let proposals = judge.proposals(horizon_s)?;
        let scores = score_proposals(&judge.scoring(), &proposals)?;
        judge.rival_progress = scores.iter().map(|s| s.progress_m * s.multiplier()).fold(0.0, f64::max);
        Ok(judge)
    }

    /// Simulated IDM roll-outs along the ego's own centreline, one a speed.
    fn proposals(&self, horizon_s: f64) -> Result<Vec<Vec<EgoState>>, ReflectionError> {
        let own = self.graph.ego_lane();
        let limit = own.speed_limit.unwrap_or(FALLBACK_LIMIT);
        let proposal = |fraction: f64| {
            let code = PlannerCode {
                centerline: CenterlineName::EgoLane.to_string(),
                leader: None,
                target_speed: fraction * limit,
                accel_max: PROPOSAL_ACCEL,
                decel_max: PROPOSAL_DECEL,
            };
            let planner =
                GeneratedPlanner::new(self.scene, code, own.path.clone(), None, LeadPolicy::Nearest, horizon_s)?;
            Ok(self.simulate(&planner))
        };
        SPEED_FRACTIONS.into_iter().map(proposal).collect()
    }

    fn simulate(&self, planner: &GeneratedPlanner) -> Vec<EgoState> {
        let rollout = planner.roll_out(self.scene, self.steps);
        simulate_proposal(self.scene.ego, &rollout.poses, JerkPenalty::PdmClosed)
    }

    fn scoring(&self) -> ScoringScene<'_> {
        ScoringScene {
            drivable: &self.drivable,
            forecast: &self.forecast,
            centerline: &self.graph.ego_lane().path.centerline,
            rival_progress: self.rival_progress,
        }
    }

    /// Rolls a planner out, scores it, and compares the score with λ.
    ///
    /// # Errors
    /// When the horizon is too short to be scored.
    pub fn reflect(&self, planner: &GeneratedPlanner, threshold: f64) -> Result<ReflectionReport, ReflectionError> {
        let batch = [self.simulate(planner)];
        let scores = score_proposals(&self.scoring(), &batch)?;
        let [states] = batch;
        // One proposal in, one score out.
        let score = scores.first().copied().ok_or(MetricError::TooFewSamples { needed: 1, got: 0 })?;
        let verdict = if score.total >= threshold { Verdict::Execute } else { Verdict::Rethink };
        Ok(ReflectionReport {
            score: score.total,
            parts: parts(&score),
            progress_reference: ProgressReference::CenterlineProposals,
            verdict,
            states,
        })
    }
}

fn parts(score: &ProposalScore) -> SubScores {
    SubScores {
        no_collision: score.no_at_fault_collisions,
        drivable_area: score.drivable_area,
        driving_direction: score.driving_direction,
        progress: score.progress,
        time_to_collision: score.time_to_collision,
        comfort: score.comfort,
    }
}
