//! `planner_miss_rate_within_bound`: a multiplier that is 0 when too many plans stray too far from the recorded drive.

use super::comparison::{COMPARISON_HORIZONS_S, PlannerExpertErrors, mean};
use crate::metrics::{MetricName, MetricResult, Statistic, StatisticKind};

/// A plan that strays farther than this within a horizon misses it, metres (devkit
/// `planner_miss_rate_within_bound_statistics.yaml`).
pub const MAX_DISPLACEMENTS: [f64; 3] = [6.0, 8.0, 16.0];
/// Share of misses that is still acceptable, at every horizon.
pub const MAX_MISS_RATE: f64 = 0.3;

/// Scores it: 1 when at most three tenths of the plans miss, at every horizon, else 0.
pub fn planner_miss_rate_within_bound(errors: &PlannerExpertErrors) -> MetricResult {
    let metric = MetricName::PlannerMissRateWithinBound;
    let rates: Vec<f64> = MAX_DISPLACEMENTS
        .iter()
        .enumerate()
        .map(|(i, &most)| mean(errors.within(i, |e| e.maximum_displacement).map(|d| f64::from(u8::from(d > most)))))
        .collect();
    let within = rates.iter().all(|&rate| rate <= MAX_MISS_RATE);
    let named = rates.iter().zip(COMPARISON_HORIZONS_S).map(|(&rate, horizon)| {
        Statistic::new(StatisticKind::Ratio, format!("planner_miss_rate_horizon_{horizon}"), "ratio", rate)
    });
    let statistics = named.chain([Statistic::boolean(metric.as_str(), within)]).collect();
    MetricResult::scored(metric, f64::from(u8::from(within)), statistics)
}
