//! The result of a metric: a score, statistics and a time series, under nuPlan's names, categories
//! and units.

use planagent_world::EgoState;
use serde::{Deserialize, Serialize};

/// nuPlan's category of a metric (devkit `simulation_metric/**/*.yaml`, key `category`): the groups
/// of its `nuBoard`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum MetricCategory {
    /// How the ego moves; collisions too.
    Dynamics,
    /// The ego's path against road, route and expert.
    Planning,
    /// Broken rules.
    Violations,
    /// Metrics of some scenario types only.
    #[serde(rename = "Scenario dependent")]
    ScenarioDependent,
}

impl MetricCategory {
    /// nuPlan's word.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Dynamics => "Dynamics",
            Self::Planning => "Planning",
            Self::Violations => "Violations",
            Self::ScenarioDependent => "Scenario dependent",
        }
    }
}

/// nuPlan's `metric_score_unit`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum ScoreUnit {
    /// A truth value; nuPlan says so of `driving_direction_compliance` too, which may be 0.5.
    Bool,
    /// A number in [0, 1].
    Float,
}

impl ScoreUnit {
    /// nuPlan's word.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Bool => "bool",
            Self::Float => "float",
        }
    }
}

/// nuPlan's `MetricStatisticsType`, as far as its challenges use it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "SCREAMING_SNAKE_CASE")]
#[non_exhaustive]
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

impl StatisticKind {
    /// nuPlan's word.
    #[doc(hidden)]
    pub fn name(self) -> &'static str {
        match self {
            Self::Max => "MAX",
            Self::Min => "MIN",
            Self::P90 => "P90",
            Self::Mean => "MEAN",
            Self::Count => "COUNT",
            Self::Value => "VALUE",
            Self::Ratio => "RATIO",
            Self::Boolean => "BOOLEAN",
        }
    }
}

/// One number about a simulation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Statistic {
    /// nuPlan's name of it.
    pub name: String,
    /// nuPlan's name of its unit.
    pub unit: String,
    /// Truth values are 1 and 0.
    pub value: f64,
    /// Its kind.
    pub kind: StatisticKind,
}

impl Statistic {
    /// A statistic from its parts.
    pub fn new(
        kind: StatisticKind,
        name: impl Into<String>,
        unit: impl Into<String>,
        value: f64,
    ) -> Self {
        Self {
            name: name.into(),
            unit: unit.into(),
            value,
            kind,
        }
    }

    /// A truth value.
    pub fn boolean(name: impl Into<String>, value: bool) -> Self {
        Self::new(
            StatisticKind::Boolean,
            name,
            "boolean",
            f64::from(u8::from(value)),
        )
    }

    /// A number of things.
    pub fn count(name: impl Into<String>, value: usize) -> Self {
        Self::new(StatisticKind::Count, name, "count", value as f64)
    }
}

/// One value per sample.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TimeSeries {
    /// nuPlan's name of the unit of the values.
    pub unit: String,
    /// Times of the samples, µs.
    pub time_stamps: Vec<i64>,
    /// One value per time.
    pub values: Vec<f64>,
    /// Indices of the samples; `None`: all.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub selected_frames: Option<Vec<usize>>,
}

impl TimeSeries {
    /// A series with a value at every state.
    pub fn of_states(unit: impl Into<String>, states: &[EgoState], values: Vec<f64>) -> Self {
        let time_stamps = states.iter().map(|state| state.time_us).collect();
        Self {
            unit: unit.into(),
            time_stamps,
            values,
            selected_frames: None,
        }
    }

    /// The statistics of these kinds; NaN is ignored. A series has a maximum, minimum, mean and
    /// 90th percentile only.
    pub fn statistics_of(&self, metric: &str, kinds: &[StatisticKind]) -> Vec<Statistic> {
        let all = self.statistics(metric);
        kinds
            .iter()
            .filter_map(|kind| all.iter().find(|s| s.kind == *kind).cloned())
            .collect()
    }

    /// nuPlan's four statistics of a series, in its order: maximum, minimum, mean, 90th percentile;
    /// NaN is ignored.
    pub fn statistics(&self, metric: &str) -> Vec<Statistic> {
        let mut known: Vec<f64> = self
            .values
            .iter()
            .copied()
            .filter(|v| !v.is_nan())
            .collect();
        known.sort_by(f64::total_cmp);
        let of = |kind, prefix: &str, value| {
            Statistic::new(kind, format!("{prefix}_{metric}"), &*self.unit, value)
        };
        let mean = known.iter().sum::<f64>() / known.len() as f64;
        vec![
            of(
                StatisticKind::Max,
                "max",
                known.last().copied().unwrap_or(f64::NAN),
            ),
            of(
                StatisticKind::Min,
                "min",
                known.first().copied().unwrap_or(f64::NAN),
            ),
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

/// The result of one metric.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MetricResult {
    /// nuPlan's name of the result (`metric_statistics_name`).
    pub name: String,
    /// nuPlan's name of the metric that computed it (`metric_computator`); it differs from `name`
    /// for a metric with several results.
    pub computator: String,
    /// nuPlan's category.
    pub category: MetricCategory,
    /// Its score in [0, 1]; `None` for metrics that do not enter the score.
    pub score: Option<f64>,
    /// Unit of the score; `None` without one.
    pub score_unit: Option<ScoreUnit>,
    /// Its statistics, in nuPlan's order.
    pub statistics: Vec<Statistic>,
    /// Its value at every sample.
    pub time_series: Option<TimeSeries>,
}

impl MetricResult {
    /// A result without score.
    pub fn unscored(name: &str, category: MetricCategory, statistics: Vec<Statistic>) -> Self {
        Self {
            name: name.to_owned(),
            computator: name.to_owned(),
            category,
            score: None,
            score_unit: None,
            statistics,
            time_series: None,
        }
    }

    /// Adds a time series.
    pub fn with_series(self, series: TimeSeries) -> Self {
        Self {
            time_series: Some(series),
            ..self
        }
    }

    /// A statistic by its name.
    pub fn statistic(&self, name: &str) -> Option<f64> {
        self.statistics
            .iter()
            .find(|s| s.name == name)
            .map(|s| s.value)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ninetieth_percentile_takes_numpys_closest_observation() {
        let upto = |n: i32| (0..n).map(f64::from).collect::<Vec<_>>();
        // Position 0.9 n − 1.5: the next observation above, unless the position is a whole, even
        // number.
        for (n, expected) in [
            (1, 0.0),
            (5, 4.0),
            (10, 8.0),
            (12, 10.0),
            (15, 12.0),
            (149, 133.0),
        ] {
            assert!((percentile_90(&upto(n)) - expected).abs() < 1e-12, "{n}");
        }
        assert!(percentile_90(&[]).is_nan());
    }
}
