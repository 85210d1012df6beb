//! The comfort term of a proposal: nuPlan's bounds on differently filtered signals (`tuplan_garage`
//! `pdm_comfort_metrics.py`).

use crate::geometry::unwrap_angles;
use crate::metrics::{
    ACCELERATION_WINDOW, ComfortQuantity, MetricError, SavitzkyGolay, YAW_WINDOW, differentiated, mean_step_s, smoothed,
};
use crate::world::EgoState;

/// Whether the six bounded quantities stay strictly within nuPlan's bounds. Accelerations are those of the rear axle,
/// smoothed by a single quadratic over all states; jerks are the derivative of a single quadratic over the acceleration
/// smoothed with nuPlan's window.
///
/// # Errors
/// When there are fewer than 4 states.
pub fn is_comfortable(states: &[EgoState]) -> Result<bool, MetricError> {
    let of = |read: fn(&EgoState) -> f64| states.iter().map(read).collect::<Vec<f64>>();
    let (all, step) = (states.len(), mean_step_s(states));
    let (forward, sideways) = (of(|s| s.acceleration.x), of(|s| s.acceleration.y));
    let norm = of(|s| s.acceleration.norm());
    let headings = unwrap_angles(&of(|s| s.rear_axle.heading));
    let jerk = |acceleration: &[f64]| {
        let filter = SavitzkyGolay { window: all, order: 2, derivative: 1 };
        differentiated(&smoothed(acceleration, ACCELERATION_WINDOW)?, step, filter)
    };
    let yaw =
        |order, derivative| differentiated(&headings, step, SavitzkyGolay { window: YAW_WINDOW, order, derivative });
    let signals = [
        (ComfortQuantity::LonAcceleration, smoothed(&forward, all)?),
        (ComfortQuantity::LatAcceleration, smoothed(&sideways, all)?),
        (ComfortQuantity::Jerk, jerk(&norm)?),
        (ComfortQuantity::LonJerk, jerk(&forward)?),
        (ComfortQuantity::YawRate, yaw(2, 1)?),
        (ComfortQuantity::YawAcceleration, yaw(3, 2)?),
    ];
    Ok(signals.iter().all(|(quantity, values)| quantity.bound().is_none_or(|bound| bound.holds(values))))
}
