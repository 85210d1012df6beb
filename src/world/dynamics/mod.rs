//! Motion models: the intelligent driver model, the kinematic bicycle, the LQR tracker and reactive
//! IDM agents.

mod bicycle;
mod idm;
mod lqr;
mod profile;
mod progress_path;
mod traffic;
mod two_stage;

#[cfg(test)]
pub(crate) mod test_road;

pub use bicycle::{Command, advance};
pub use idm::{IdmParameters, Lead};
pub use lqr::{TrackingError, track};
pub use profile::{JerkPenalty, MotionProfile};
pub use progress_path::ProgressPath;
pub use traffic::{CrossingActors, IDM_AGENT, IdmTraffic, InteractiveTraffic};
pub use two_stage::{follow, simulate_proposal};
