//! The score of proposals (`tuplan_garage` `pdm_scorer.py`).

use super::areas::NearAreas;
use super::collision::{SimulatedProposal, approach, collide};
use super::encounters::Encounters;
use super::{DrivableMap, EgoAreas, Forecast, Placed, is_comfortable};
use crate::metrics::{MetricError, direction_score};
use planagent_world::geometry::{Bounds, Polyline};
use planagent_world::{EgoState, LaneId, STEP_S};
use serde::{Deserialize, Serialize};

/// Weight of progress.
pub const WEIGHT_PROGRESS: f64 = 5.0;
/// Weight of the time to collision.
pub const WEIGHT_TTC: f64 = 5.0;
/// Weight of comfort.
pub const WEIGHT_COMFORT: f64 = 2.0;
/// Below this best progress, standing still is as good as any, meters.
const PROGRESS_THRESHOLD: f64 = 0.1;

/// The input of the score beside the proposals.
#[derive(Clone, Copy)]
pub struct ScoringScene<'a> {
    /// The drivable polygons around the ego.
    pub drivable: &'a DrivableMap<'a>,
    /// The forecast of all objects.
    pub forecast: &'a Forecast,
    /// The line along which progress is measured.
    pub centerline: &'a Polyline,
    /// Progress of a rival outside of the batch, meters; 0 without one.
    pub rival_progress: f64,
}

/// The score of one proposal with its parts.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ProposalScore {
    /// Product of the multipliers times the weighted mean of progress, time to collision and
    /// comfort, in [0, 1].
    pub total: f64,
    /// Multiplier: 1, 0.5 (an object) or 0.
    pub no_at_fault_collisions: f64,
    /// Multiplier: 1 or 0.
    pub drivable_area: f64,
    /// Multiplier: 1, 0.5 or 0.
    pub driving_direction: f64,
    /// Weight 5: progress relative to the best of the batch, in [0, 1].
    pub progress: f64,
    /// Weight 5: 1 or 0.
    pub time_to_collision: f64,
    /// Weight 2: 1 or 0.
    pub comfort: f64,
    /// Progress along the centerline, meters, not below 0.
    pub progress_m: f64,
    /// Time of the first collision at fault, seconds from the first state.
    pub first_at_fault_s: Option<f64>,
    /// Time of the first state from which a collision was less than 0.9 s away, seconds from the
    /// first state.
    pub first_ttc_s: Option<f64>,
}

impl ProposalScore {
    /// Product of the three multipliers.
    pub fn multiplier(&self) -> f64 {
        self.no_at_fault_collisions * self.drivable_area * self.driving_direction
    }

    /// The same score with another relative progress, in [0, 1].
    #[must_use]
    pub fn with_progress(self, progress: f64) -> Self {
        let weighted = WEIGHT_PROGRESS * progress
            + WEIGHT_TTC * self.time_to_collision
            + WEIGHT_COMFORT * self.comfort;
        let total = self.multiplier() * weighted / (WEIGHT_PROGRESS + WEIGHT_TTC + WEIGHT_COMFORT);
        Self {
            total,
            progress,
            ..self
        }
    }
}

/// Scores proposals: each a sequence of simulated states 0.1 s apart, the present one first. The
/// horizon is their length; PDM's is 41. The n-th score belongs to the n-th proposal.
///
/// # Errors
/// When a proposal has fewer than 4 states.
pub fn score_proposals(
    scene: &ScoringScene<'_>,
    proposals: &[Vec<EgoState>],
) -> Result<Vec<ProposalScore>, MetricError> {
    Ok(compared(judge_all(scene, proposals)?, scene.rival_progress))
}

/// Whether a proposal may use lanes against traffic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OvertakeVerdict {
    /// It does not leave the lanes of its direction: there is nothing to allow.
    Stays,
    /// It may.
    Allowed,
    /// It may not, and has 0 for the driving direction.
    Refused,
}

/// As [`score_proposals`], where lanes against traffic count as the route's for each proposal that
/// is allowed to use them.
///
/// # Errors
/// As [`score_proposals`].
pub fn score_overtake(
    scene: &ScoringScene<'_>,
    against_traffic: &[LaneId],
    verdicts: &[OvertakeVerdict],
    proposals: &[Vec<EgoState>],
) -> Result<Vec<ProposalScore>, MetricError> {
    let drivable = scene.drivable.allowing(against_traffic);
    let allowed = judge_all(
        &ScoringScene {
            drivable: &drivable,
            ..*scene
        },
        proposals,
    )?;
    let scores = judge_all(scene, proposals)?
        .into_iter()
        .zip(allowed)
        .zip(verdicts);
    let of_verdict = scores.map(|((usual, allowed), verdict)| match verdict {
        OvertakeVerdict::Stays => usual,
        OvertakeVerdict::Allowed => allowed,
        OvertakeVerdict::Refused => ProposalScore {
            driving_direction: 0.0,
            ..usual
        },
    });
    Ok(compared(of_verdict.collect(), scene.rival_progress))
}

/// All terms of each proposal but its relative progress, which needs the whole batch.
fn judge_all(
    scene: &ScoringScene<'_>,
    proposals: &[Vec<EgoState>],
) -> Result<Vec<ProposalScore>, MetricError> {
    let batch: Vec<Vec<Placed>> = proposals
        .iter()
        .map(|states| states.iter().map(Placed::from_state).collect())
        .collect();
    let reach = batch
        .iter()
        .flatten()
        .fold(Bounds::around(&[]), |reach, placed| {
            reach.joined(placed.bounds())
        });
    let around = Around {
        areas: scene.drivable.near(&reach),
        encounters: Encounters::from_forecast(scene.forecast, &batch),
    };
    proposals
        .iter()
        .zip(&batch)
        .map(|(states, placed)| judge(scene, &around, states, placed))
        .collect()
}

/// The scores with their progress relative to the best of them, or to rivals.
fn compared(mut scores: Vec<ProposalScore>, rival_progress: f64) -> Vec<ProposalScore> {
    let best = scores
        .iter()
        .map(|s| s.progress_m * s.multiplier())
        .chain([rival_progress])
        .fold(0.0, f64::max);
    for score in &mut scores {
        *score = score.with_progress(if best > PROGRESS_THRESHOLD {
            score.progress_m * score.multiplier() / best
        } else {
            f64::from(u8::from(score.multiplier() > 0.0))
        });
    }
    scores
}

/// The objects that a batch of proposals may touch.
struct Around<'a> {
    areas: NearAreas<'a>,
    encounters: Encounters<'a>,
}

/// All terms of a proposal but its relative progress.
fn judge(
    scene: &ScoringScene<'_>,
    around: &Around<'_>,
    states: &[EgoState],
    placed: &[Placed],
) -> Result<ProposalScore, MetricError> {
    let areas: Vec<EgoAreas> = placed
        .iter()
        .map(|placed| around.areas.areas_of(placed))
        .collect();
    let proposal = SimulatedProposal {
        states,
        placed,
        areas: &areas,
    };
    let collisions = collide(proposal, &around.encounters);
    let ttc = approach(scene.drivable.map(), proposal, &around.encounters);
    let seconds = |state: Option<usize>| state.map(|i| i as f64 * STEP_S);
    // Progress counts relative to the best proposal, which the caller knows. It sets `total` and
    // `progress`.
    Ok(ProposalScore {
        total: 0.0,
        no_at_fault_collisions: collisions.score,
        drivable_area: f64::from(u8::from(!areas.iter().any(|a| a.non_drivable))),
        driving_direction: direction_score(longest_oncoming(placed, &areas)),
        progress: 0.0,
        time_to_collision: ttc.score,
        comfort: f64::from(u8::from(is_comfortable(states)?)),
        progress_m: progress(scene.centerline, states),
        first_at_fault_s: seconds(collisions.state),
        first_ttc_s: seconds(ttc.state),
    })
}

/// The longest distance of the center in one segment off the route, meters.
fn longest_oncoming(placed: &[Placed], areas: &[EgoAreas]) -> f64 {
    let (mut longest, mut stretch) = (0.0f64, 0.0);
    for (pair, areas) in placed.windows(2).zip(areas.iter().skip(1)) {
        stretch = if areas.oncoming {
            stretch + pair[0].shape.center.distance(&pair[1].shape.center)
        } else {
            0.0
        };
        longest = longest.max(stretch);
    }
    longest
}

fn progress(centerline: &Polyline, states: &[EgoState]) -> f64 {
    let along = |ego: &EgoState| centerline.project(ego.center().position()).s;
    match states {
        [first, .., last] => (along(last) - along(first)).max(0.0),
        _ => 0.0,
    }
}
