//! `ego_is_comfortable`: 1 when every bounded quantity of comfort stays within its bounds at every sample, else 0.

use super::{ComfortQuantity, MetricError, MetricName, MetricResult, Statistic};
use crate::world::EgoState;

/// Scores the comfort of a drive.
///
/// # Errors
/// As [`ComfortQuantity::signal`].
pub fn ego_is_comfortable(states: &[EgoState]) -> Result<MetricResult, MetricError> {
    let metric = MetricName::EgoIsComfortable;
    let mut comfortable = true;
    for quantity in ComfortQuantity::ALL {
        if let Some(bound) = quantity.bound() {
            comfortable &= bound.holds(&quantity.signal(states)?);
        }
    }
    let statistics = vec![Statistic::boolean(metric.as_str(), comfortable)];
    Ok(MetricResult::scored(metric, f64::from(u8::from(comfortable)), statistics))
}
