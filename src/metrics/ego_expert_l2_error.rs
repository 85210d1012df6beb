//! `ego_expert_L2_error`: how far the ego was from where the recorded driver was at the same time. It has no score.

use super::{MetricCategory, MetricError, MetricResult, StatisticKind, TimeSeries};
use crate::world::EgoState;

/// Distance between the centres of ego and expert at every sample, metres. nuPlan's discount of later samples is 1 in its
/// configuration, so there is none.
///
/// # Errors
/// When the expert trajectory is neither as long as the drive nor one state longer.
pub fn ego_expert_l2_error(states: &[EgoState], expert: &[EgoState]) -> Result<MetricResult, MetricError> {
    error_series("ego_expert_L2_error", states, expert, |ego, expert| ego.center().distance(&expert.center()))
}

/// A metric that is one distance to the expert a sample, with nuPlan's three statistics of it.
pub(super) fn error_series(
    name: &str,
    states: &[EgoState],
    expert: &[EgoState],
    error: impl Fn(&EgoState, &EgoState) -> f64,
) -> Result<MetricResult, MetricError> {
    if !(states.len()..=states.len() + 1).contains(&expert.len()) {
        return Err(MetricError::ExpertLength { samples: states.len(), expert: expert.len() });
    }
    let errors = states.iter().zip(expert).map(|(ego, expert)| error(ego, expert)).collect();
    let series = TimeSeries::of_states("meters", states, errors);
    let statistics = series.statistics_of(name, &[StatisticKind::Max, StatisticKind::Mean, StatisticKind::P90]);
    Ok(MetricResult::unscored(name, MetricCategory::Planning, statistics).with_series(series))
}
