//! `planner_expert_final_heading_error_within_bound`: the turn between planned and recorded heading at the end of a horizon (FHE).

use super::comparison::{HorizonErrors, PlannerExpertErrors};
use crate::metrics::{MetricName, MetricResult};

/// Mean final turn at which the score is 0, radians (devkit `planner_expert_final_heading_error_within_bound_statistics.yaml`).
pub const MAX_FINAL_HEADING_ERROR: f64 = 0.8;

/// Scores it: 1 − mean / threshold, not below 0.
pub fn planner_expert_final_heading_error_within_bound(errors: &PlannerExpertErrors) -> MetricResult {
    let read = |errors: &HorizonErrors| errors.final_heading;
    errors.mean_within(
        MetricName::PlannerExpertFinalHeadingErrorWithinBound,
        ("planner_expert_FHE", "radian"),
        MAX_FINAL_HEADING_ERROR,
        read,
    )
}
