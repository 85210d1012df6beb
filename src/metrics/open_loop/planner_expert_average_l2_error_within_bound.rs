//! `planner_expert_average_l2_error_within_bound`: the mean distance between planned and recorded centres (ADE).

use super::comparison::{HorizonErrors, PlannerExpertErrors};
use crate::metrics::{MetricName, MetricResult};

/// Mean distance at which the score is 0, metres (devkit `planner_expert_average_l2_error_within_bound_statistics.yaml`).
pub const MAX_AVERAGE_L2_ERROR: f64 = 8.0;

/// Scores it: 1 − mean / threshold, not below 0.
pub fn planner_expert_average_l2_error_within_bound(errors: &PlannerExpertErrors) -> MetricResult {
    let read = |errors: &HorizonErrors| errors.average_displacement;
    errors.mean_within(
        MetricName::PlannerExpertAverageL2ErrorWithinBound,
        ("planner_expert_ADE", "meter"),
        MAX_AVERAGE_L2_ERROR,
        read,
    )
}
