//! `planner_expert_average_heading_error_within_bound`: the mean turn between planned and recorded heading (AHE).

use super::comparison::{HorizonErrors, PlannerExpertErrors};
use crate::metrics::{MetricName, MetricResult};

/// Mean turn at which the score is 0, radians (devkit `planner_expert_average_heading_error_within_bound_statistics.yaml`).
pub const MAX_AVERAGE_HEADING_ERROR: f64 = 0.8;

/// Scores it: 1 − mean / threshold, not below 0.
pub fn planner_expert_average_heading_error_within_bound(errors: &PlannerExpertErrors) -> MetricResult {
    let read = |errors: &HorizonErrors| errors.average_heading;
    errors.mean_within(
        MetricName::PlannerExpertAverageHeadingErrorWithinBound,
        ("planner_expert_AHE", "radian"),
        MAX_AVERAGE_HEADING_ERROR,
        read,
    )
}
