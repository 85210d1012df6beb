//! What Reflection says about a planner.

use crate::pdm::DrivableLayers;
use crate::world::EgoState;

/// Whether a planner may drive (paper, section 3, Reflection).
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// s ≥ λ: the planner drives.
    Execute,
    /// s < λ: the model thinks again.
    Rethink,
}

/// By what the progress of a planner is divided.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ProgressReference {
    /// The best progress among this planner and PDM-Closed's 15 proposals of the same instant.
    PdmProposals,
    /// The planner's own: PDM-Closed found no way here (a route without lanes), so there are no proposals to compare with, and
    /// whoever moves without fault has all of the term.
    OwnProgress,
}

/// The parts of the score (PDM's, with its weights).
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct SubScores {
    /// Multiplier: 1 without an at-fault collision, 0.5 or 0 with one.
    pub no_collision: f64,
    /// Multiplier: 1 while all corners stay on drivable area.
    pub drivable_area: f64,
    /// Multiplier: 1, 0.5 or 0 by metres driven in oncoming lanes.
    pub driving_direction: f64,
    /// Weight 5: progress along the route centreline, relative to the reference.
    pub progress: f64,
    /// Weight 5: 1 when no collision is near at constant speed.
    pub time_to_collision: f64,
    /// Weight 2: 1 when all comfort bounds hold.
    pub comfort: f64,
}

impl SubScores {
    /// The parts by the short names that are told to the model.
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

/// Reflection's record of one planner.
#[derive(Debug, Clone, PartialEq)]
pub struct ReflectionReport {
    /// s, in [0, 1].
    pub score: f64,
    /// Its parts.
    pub parts: SubScores,
    /// How progress was normalised.
    pub progress_reference: ProgressReference,
    /// What counted as drivable.
    pub drivable_layers: DrivableLayers,
    /// Whether the planner may drive.
    pub verdict: Verdict,
    /// The simulated states, every 0.1 s, the present one first.
    pub states: Vec<EgoState>,
}
