//! Between which values a metric's time series leaves its score alone.

use crate::metrics::{ComfortQuantity, DIRECTION_COMPLIANCE, MIN_TIME_TO_COLLISION, MetricName};

/// The lower and the upper bound of a metric's series, in the series' unit; none where it has none.
pub(super) fn of(metric: &str) -> (Option<f64>, Option<f64>) {
    if let Some(quantity) = ComfortQuantity::ALL.into_iter().find(|quantity| quantity.name() == metric) {
        let bound = quantity.bound();
        return (bound.map(|bound| bound.min), bound.map(|bound| bound.max));
    }
    match metric {
        // Seconds to a collision at constant velocity.
        _ if metric == MetricName::TimeToCollisionWithinBound.as_str() => (Some(MIN_TIME_TO_COLLISION), None),
        // Metres per second over the limit.
        _ if metric == MetricName::SpeedLimitCompliance.as_str() => (None, Some(0.0)),
        // Metres along the driving direction in a second.
        _ if metric == MetricName::DrivingDirectionCompliance.as_str() => (Some(-DIRECTION_COMPLIANCE), None),
        // 1 while all corners are on drivable area.
        "corners_in_drivable_area" => (Some(1.0), None),
        _ => (None, None),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bounds_are_those_of_the_metrics() {
        assert_eq!(of("ego_lon_acceleration"), (Some(-4.05), Some(2.40)));
        assert_eq!(of("ego_lat_jerk"), (None, None));
        assert_eq!(of("time_to_collision_within_bound"), (Some(0.95), None));
        assert_eq!(of("ego_mean_speed"), (None, None));
    }
}
