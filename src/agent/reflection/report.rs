//! Reflection's report on a plan.

use super::behavior::BehaviorScores;
use planagent_score::pdm::DrivableLayers;
use planagent_world::EgoState;

/// Whether a plan is executed (paper, section 3, Reflection).
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize, schemars::JsonSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// s ≥ λ: the plan is executed.
    Execute,
    /// s < λ: the model is asked again.
    Rethink,
}

/// What the progress of a plan is divided by.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize, schemars::JsonSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum ProgressReference {
    /// The best progress among this plan and PDM-Closed's 15 proposals of the same instant.
    PdmProposals,
    /// What could be reached beyond the horizon by these and by plans at the limit, on the ego's
    /// lane and those beside: something that stands permanently blocks the ego's lane, or all
    /// proposals stand. A plan that reaches less than it made of its 4 s has less progress.
    Reach,
    /// The plan's own progress: PDM-Closed found no reference path (a route without lanes), so
    /// there are no proposals to compare with. A plan that moves without fault gets the whole term.
    OwnProgress,
}

/// The parts of the score (PDM's, with its weights).
#[derive(
    Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize, schemars::JsonSchema,
)]
pub struct SubScores {
    /// Multiplier: 1 without an at-fault collision, 0.5 or 0 with one.
    pub no_collision: f64,
    /// Multiplier: 1 while all corners stay on drivable area.
    pub drivable_area: f64,
    /// Multiplier: 1, 0.5 or 0 by meters driven in oncoming lanes.
    pub driving_direction: f64,
    /// Weight 5: progress along the route centerline, relative to the reference.
    pub progress: f64,
    /// Weight 5: 1 when no collision is near at constant speed.
    pub time_to_collision: f64,
    /// Weight 2: 1 when all comfort bounds hold.
    pub comfort: f64,
}

impl SubScores {
    /// Whether nothing but progress is missing.
    pub(crate) fn lacks_only_progress(&self) -> bool {
        *self
            == Self {
                no_collision: 1.0,
                drivable_area: 1.0,
                driving_direction: 1.0,
                time_to_collision: 1.0,
                comfort: 1.0,
                ..*self
            }
    }

    /// The parts by the short names that the model reads.
    pub fn named(&self) -> [(&'static str, f64); 6] {
        [
            ("collision", self.no_collision),
            ("area", self.drivable_area),
            ("direction", self.driving_direction),
            ("progress", self.progress),
            ("ttc", self.time_to_collision),
            ("comfort", self.comfort),
        ]
    }
}

/// Reflection's record of one plan.
#[derive(Debug, Clone, PartialEq)]
pub struct ReflectionReport {
    /// s, in [0, 1].
    pub score: f64,
    /// The parts of the score.
    pub parts: SubScores,
    /// The score where crossing traffic does not keep its course, and the mean of all.
    pub behaviors: BehaviorScores,
    /// How progress was normalised.
    pub progress_reference: ProgressReference,
    /// The areas that counted as drivable.
    pub drivable_layers: DrivableLayers,
    /// λ: the score that the plan needs.
    pub threshold: f64,
    /// Whether the plan is executed.
    pub verdict: Verdict,
    /// Progress along the centerline, meters.
    pub progress_m: f64,
    /// Time of the first collision at fault, seconds from now.
    pub first_at_fault_s: Option<f64>,
    /// Time of the first state with a collision near, seconds from now.
    pub first_ttc_s: Option<f64>,
    /// The simulated states, every 0.1 s, the present one first.
    pub states: Vec<EgoState>,
}
