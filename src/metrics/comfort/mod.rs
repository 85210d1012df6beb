//! Comfort: smoothed accelerations, jerks and yaw motion, and whether they stay within the bounds.

mod quantity;
mod savgol;

pub(crate) use quantity::{ACCELERATION_WINDOW, YAW_WINDOW};
pub use quantity::{Bound, ComfortQuantity};
pub use savgol::{SavitzkyGolay, differentiated, mean_step_s, smoothed};
