//! The score of proposals (`tuplan_garage` `pdm_scorer.py`).

use super::{Contest, DrivableMap, Forecast};
use crate::metrics::MetricError;
use planagent_world::geometry::Polyline;
use planagent_world::{EgoState, LaneId};
use serde::{Deserialize, Serialize};

/// Weight of progress.
pub const WEIGHT_PROGRESS: f64 = 5.0;
/// Weight of the time to collision.
pub const WEIGHT_TTC: f64 = 5.0;
/// Weight of comfort.
pub const WEIGHT_COMFORT: f64 = 2.0;
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
    /// The terms of a proposal that loses nothing, without its `total` and relative `progress`.
    pub(super) fn flawless(progress_m: f64) -> Self {
        Self {
            total: 0.0,
            no_at_fault_collisions: 1.0,
            drivable_area: 1.0,
            driving_direction: 1.0,
            progress: 0.0,
            time_to_collision: 1.0,
            comfort: 1.0,
            progress_m,
            first_at_fault_s: None,
            first_ttc_s: None,
        }
    }

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
    Contest::new(scene, proposals)?.scores()
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
pub(super) fn score_overtake(
    scene: &ScoringScene<'_>,
    against_traffic: &[LaneId],
    verdicts: &[OvertakeVerdict],
    proposals: &[Vec<EgoState>],
) -> Result<Vec<ProposalScore>, MetricError> {
    Contest::overtaking(scene, against_traffic, verdicts, proposals)?.scores()
}
