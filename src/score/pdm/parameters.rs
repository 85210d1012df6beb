//! Parameters of PDM-Closed.

use planagent_world::dynamics::IdmParameters;
use serde::{Deserialize, Serialize};

/// Steps of 0.1 s of an executed trajectory: 8 s, as nuPlan's planners give and its open-loop
/// metrics look at.
pub const TRAJECTORY_STEPS: usize = 80;

/// Parameters of PDM-Closed's proposals and of its emergency brake. The default is PDM-Closed as
/// published.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PdmParameters {
    /// Upper bound of the fastest proposal's speed on a free road, m/s, above 0; `None` for the
    /// speed limit.
    pub speed_cap: Option<f64>,
    /// Gap at standstill, meters.
    pub min_gap: f64,
    /// Headway, seconds.
    pub headway: f64,
    /// Maximum acceleration, m/s².
    pub accel_max: f64,
    /// Maximum deceleration as a positive magnitude, m/s².
    pub decel_max: f64,
    /// Whether the emergency brake may overrule the best proposal.
    pub emergency_brake: bool,
}

impl Default for PdmParameters {
    fn default() -> Self {
        Self {
            speed_cap: None,
            min_gap: 1.0,
            headway: 1.5,
            accel_max: 1.5,
            decel_max: 3.0,
            emergency_brake: true,
        }
    }
}

impl PdmParameters {
    /// The IDM of a proposal with this speed on a free road, m/s.
    pub(super) fn policy(&self, target_velocity: f64) -> IdmParameters {
        let Self {
            min_gap,
            headway,
            accel_max,
            decel_max,
            ..
        } = *self;
        IdmParameters {
            target_velocity,
            min_gap,
            headway,
            accel_max,
            decel_max,
            exponent: 10,
        }
    }

    /// The fastest proposal's speed on a free road with this limit, m/s.
    pub(super) fn fastest(&self, limit: f64) -> f64 {
        self.speed_cap.map_or(limit, |cap| cap.min(limit))
    }
}
