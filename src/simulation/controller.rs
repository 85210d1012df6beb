//! Who moves the ego from one iteration to the next.

use super::observation::Challenge;
use crate::dynamics::{TrackingError, drive};
use crate::scenario::Frame;
use crate::world::{EgoState, Trajectory};

/// nuPlan's ego controllers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum EgoController {
    /// `two_stage_controller`: the tracker follows the planned trajectory, the kinematic bicycle carries it out.
    TwoStage,
    /// `log_playback`: the ego does what was recorded, whatever was planned.
    LogPlayback,
}

impl EgoController {
    /// The controller of a challenge.
    pub(super) fn of(challenge: Challenge) -> Self {
        match challenge {
            Challenge::ClosedLoopNonreactiveAgents | Challenge::ClosedLoopReactiveAgents => Self::TwoStage,
            Challenge::OpenLoopBoxes => Self::LogPlayback,
        }
    }

    /// The ego at the time of the recorded frame `next`.
    ///
    /// # Errors
    /// When the trajectory is to be followed and does not cover the step.
    pub(super) fn update(self, ego: &EgoState, plan: &Trajectory, next: &Frame) -> Result<EgoState, TrackingError> {
        match self {
            Self::TwoStage => drive(ego, plan, next.ego.time_us - ego.time_us),
            Self::LogPlayback => Ok(next.ego),
        }
    }
}
