//! `ego_is_making_progress`: a multiplier that is 0 when the ego came less than a fifth as far as the expert.

use super::{MetricName, MetricResult, Statistic};

/// Least share of the expert's progress (devkit `ego_is_making_progress_statistics.yaml`).
pub const MIN_PROGRESS_RATIO: f64 = 0.2;

/// Scores the ratio that `ego_progress_along_expert_route` found.
pub fn ego_is_making_progress(progress_ratio: f64) -> MetricResult {
    let metric = MetricName::EgoIsMakingProgress;
    let progresses = progress_ratio >= MIN_PROGRESS_RATIO;
    let statistics = vec![Statistic::boolean(metric.as_str(), progresses)];
    MetricResult::scored(metric, f64::from(u8::from(progresses)), statistics)
}
