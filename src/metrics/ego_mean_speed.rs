//! `ego_mean_speed`: the mean speed of a drive. It has no score.

use super::{MetricCategory, MetricResult, Statistic, StatisticKind};
use crate::world::EgoState;

/// The mean over all states of the norm of the rear-axle velocity, m/s.
pub fn ego_mean_speed(states: &[EgoState]) -> MetricResult {
    let mean = states.iter().map(EgoState::speed).sum::<f64>() / states.len() as f64;
    let statistic = Statistic::new(StatisticKind::Value, "ego_mean_speed_value", "meters_per_second", mean);
    MetricResult::unscored("ego_mean_speed", MetricCategory::Dynamics, vec![statistic])
}
