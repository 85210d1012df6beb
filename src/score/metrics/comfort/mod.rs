//! Comfort: smoothed accelerations, jerks and yaw motion, and whether they stay within the bounds.

mod quantity;
mod savgol;

pub(super) use quantity::{
    ACCELERATION, JERK, LAT_ACCELERATION, LAT_JERK, LON_ACCELERATION, LON_JERK, YAW_ACCELERATION,
    YAW_RATE,
};
pub(crate) use quantity::{ACCELERATION_WINDOW, YAW_WINDOW};
pub use quantity::{Bound, ComfortQuantity};
pub use savgol::SavitzkyGolay;
pub(crate) use savgol::mean_step_s;
#[cfg(test)]
pub(crate) use savgol::{differentiated, smoothed};

use super::{MetricCategory, MetricError, MetricList, MetricResult, MetricSpec};
use planagent_world::EgoState;

pub(super) const SPEC: MetricSpec = MetricSpec::new("ego_is_comfortable", |input| {
    ego_is_comfortable(input.states()).map(Some)
})
.only(MetricList::ClosedLoop)
.weight(2.0)
.category(MetricCategory::Violations)
.truth_value()
.label("comf");

/// 1 when every bounded quantity stays within its bounds at every sample, else 0.
pub fn ego_is_comfortable(states: &[EgoState]) -> Result<MetricResult, MetricError> {
    let mut comfortable = true;
    for quantity in ComfortQuantity::ALL {
        if let Some(bound) = quantity.bound() {
            comfortable &= bound.holds(&quantity.signal(states)?);
        }
    }
    Ok(SPEC.judged(comfortable, vec![]))
}
