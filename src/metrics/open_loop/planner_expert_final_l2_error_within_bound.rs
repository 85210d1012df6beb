//! `planner_expert_final_l2_error_within_bound`: the distance between planned and recorded centre at the end of a horizon (FDE).

use super::comparison::{HorizonErrors, PlannerExpertErrors};
use crate::metrics::{MetricName, MetricResult};

/// Mean final distance at which the score is 0, metres (devkit `planner_expert_final_l2_error_within_bound_statistics.yaml`).
pub const MAX_FINAL_L2_ERROR: f64 = 8.0;

/// Scores it: 1 − mean / threshold, not below 0.
pub fn planner_expert_final_l2_error_within_bound(errors: &PlannerExpertErrors) -> MetricResult {
    let read = |errors: &HorizonErrors| errors.final_displacement;
    errors.mean_within(
        MetricName::PlannerExpertFinalL2ErrorWithinBound,
        ("planner_expert_FDE", "meter"),
        MAX_FINAL_L2_ERROR,
        read,
    )
}
