//! The controllers that move the ego from one iteration to the next.

use planagent_scenario::Frame;
use planagent_world::dynamics::{TrackingError, follow};
use planagent_world::{EgoState, Trajectory};

/// nuPlan's ego controllers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum EgoController {
    /// `two_stage_controller`: an LQR tracker follows the planned trajectory through a kinematic
    /// bicycle model.
    TwoStage,
    /// `log_playback`: the ego replays the log.
    LogPlayback,
}

impl EgoController {
    /// The ego at the time of the recorded frame `next`.
    pub(super) fn update(
        self,
        ego: &EgoState,
        plan: &Trajectory,
        next: &Frame,
    ) -> Result<EgoState, TrackingError> {
        match self {
            Self::TwoStage => follow(ego, plan, next.ego.time_us - ego.time_us),
            Self::LogPlayback => Ok(next.ego),
        }
    }
}
