//! What may be tuned of PDM-Closed.

use crate::dynamics::IdmParameters;
use serde::{Deserialize, Serialize};

/// Parameters of PDM-Closed's proposals and of its last resort. The default is PDM-Closed as published.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PdmParameters {
    /// The fastest proposal's speed on a free road, m/s, where that is less than the limit; above 0. `None`: the limit.
    pub speed_cap: Option<f64>,
    /// Gap kept at standstill, metres.
    pub min_gap: f64,
    /// Headway, seconds.
    pub headway: f64,
    /// Largest acceleration, m/s².
    pub accel_max: f64,
    /// Largest deceleration as a positive magnitude, m/s².
    pub decel_max: f64,
    /// Whether the emergency brake may overrule the best proposal.
    pub emergency_brake: bool,
}

impl Default for PdmParameters {
    fn default() -> Self {
        Self { speed_cap: None, min_gap: 1.0, headway: 1.5, accel_max: 1.5, decel_max: 3.0, emergency_brake: true }
    }
}

impl PdmParameters {
    /// The law of a proposal with this speed on a free road, m/s.
    pub(super) fn policy(&self, target_velocity: f64) -> IdmParameters {
        let Self { min_gap, headway, accel_max, decel_max, .. } = *self;
        IdmParameters { target_velocity, min_gap, headway, accel_max, decel_max, exponent: 10 }
    }

    /// What the fastest proposal drives on a free road with this limit, m/s.
    pub(super) fn fastest(&self, limit: f64) -> f64 {
        self.speed_cap.map_or(limit, |cap| cap.min(limit))
    }
}
