//! What a metric gives: a score, statistics and a time series, under nuPlan's names and units.

use serde::{Deserialize, Serialize};

/// nuPlan's `MetricStatisticsType`, as far as the closed-loop metrics use it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "SCREAMING_SNAKE_CASE")]
pub enum StatisticKind {
    /// Largest value.
    Max,
    /// Smallest value.
    Min,
    /// 90th percentile.
    P90,
    /// Arithmetic mean.
    Mean,
    /// A number of things.
    Count,
    /// A single value.
    Value,
    /// A ratio.
    Ratio,
    /// A truth value: 1 or 0.
    Boolean,
}

/// One number about a drive.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Statistic {
    /// nuPlan's name for it.
    pub name: String,
    /// nuPlan's name for its unit.
    pub unit: String,
    /// The number; truth values are 1 and 0.
    pub value: f64,
    /// What kind of number.
    pub kind: StatisticKind,
}

impl Statistic {
    /// A statistic from its parts.
    pub fn new(kind: StatisticKind, name: impl Into<String>, unit: impl Into<String>, value: f64) -> Self {
        Self { name: name.into(), unit: unit.into(), value, kind }
    }

    /// A truth value.
    pub fn boolean(name: impl Into<String>, value: bool) -> Self {
        Self::new(StatisticKind::Boolean, name, "boolean", f64::from(u8::from(value)))
    }

    /// A number of things.
    pub fn count(name: impl Into<String>, value: usize) -> Self {
        Self::new(StatisticKind::Count, name, "count", value as f64)
    }
}

/// One value a sample.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TimeSeries {
    /// nuPlan's name for the unit of the values.
    pub unit: String,
    /// Times of the samples, µs.
    pub time_stamps: Vec<i64>,
    /// The values, as many as times.
    pub values: Vec<f64>,
}

impl TimeSeries {
    /// nuPlan's four statistics of a series, in its order: maximum, minimum, mean, 90th percentile; NaN is ignored.
    pub fn statistics(&self, metric: &str) -> Vec<Statistic> {
        let mut known: Vec<f64> = self.values.iter().copied().filter(|v| !v.is_nan()).collect();
        known.sort_by(f64::total_cmp);
        let of = |kind, prefix: &str, value| Statistic::new(kind, format!("{prefix}_{metric}"), &*self.unit, value);
        let mean = known.iter().sum::<f64>() / known.len() as f64;
        vec![
            of(StatisticKind::Max, "max", known.last().copied().unwrap_or(f64::NAN)),
            of(StatisticKind::Min, "min", known.first().copied().unwrap_or(f64::NAN)),
            of(StatisticKind::Mean, "avg", mean),
            of(StatisticKind::P90, "p90", percentile_90(&known)),
        ]
    }
}

/// The 90th percentile of sorted values by numpy's method `closest_observation`; NaN for none.
fn percentile_90(sorted: &[f64]) -> f64 {
    let position = 0.9 * sorted.len() as f64 - 1.5;
    let before = position.floor();
    // numpy takes the lower observation only at an exact, even position.
    let lower = position.total_cmp(&before).is_eq() && before.rem_euclid(2.0) < 0.5;
    let index = if lower { before } else { before + 1.0 }.max(0.0) as usize;
    sorted.get(index).copied().unwrap_or(f64::NAN)
}

/// What one metric says about a drive.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MetricResult {
    /// nuPlan's name of the metric.
    pub name: String,
    /// Its score in [0, 1]; `None` for metrics that do not enter the score.
    pub score: Option<f64>,
    /// Its statistics, in nuPlan's order.
    pub statistics: Vec<Statistic>,
    /// Its value at every sample, for metrics that have one.
    pub time_series: Option<TimeSeries>,
}

impl MetricResult {
    /// A statistic by its name.
    pub fn statistic(&self, name: &str) -> Option<f64> {
        self.statistics.iter().find(|s| s.name == name).map(|s| s.value)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ninetieth_percentile_takes_numpys_closest_observation() {
        let upto = |n: i32| (0..n).map(f64::from).collect::<Vec<_>>();
        // Position 0.9 n − 1.5: the next observation above, unless the position is a whole, even number.
        for (n, expected) in [(1, 0.0), (5, 4.0), (10, 8.0), (12, 10.0), (15, 12.0), (149, 133.0)] {
            assert!((percentile_90(&upto(n)) - expected).abs() < 1e-12, "{n}");
        }
        assert!(percentile_90(&[]).is_nan());
    }
}
