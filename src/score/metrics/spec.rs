//! What a metric is: its name, its part in a score, and the function that computes it.

use super::{MetricCategory, MetricError, MetricInput, MetricResult, ScoreUnit, Statistic};
use serde::{Deserialize, Serialize};

/// nuPlan's lists of metrics.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum MetricList {
    /// For the two closed-loop challenges.
    ClosedLoop,
    /// For the challenge `open_loop_boxes`.
    OpenLoop,
}

impl MetricList {
    /// What the labels of its challenges and its score mean.
    #[doc(hidden)]
    pub fn meanings(self) -> &'static [&'static str] {
        match self {
            Self::ClosedLoop => &[
                "NR, R = non-reactive, reactive agents",
                "score = nuPlan's closed-loop score x 100",
            ],
            Self::OpenLoop => &[
                "OLS = the ego replays the log",
                "score = nuPlan's open-loop score x 100",
            ],
        }
    }
}

/// How a metric enters the score.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum Role {
    /// It multiplies the weighted mean.
    Multiplier,
    /// It enters the weighted mean with this weight.
    Weight(f64),
    /// It is reported only.
    Unscored,
}

/// Computes one metric; `None` where the scenario has nothing to measure.
pub type Compute = fn(&MetricInput<'_>) -> Result<Option<MetricResult>, MetricError>;

/// One row of the metric table ([`super::METRICS`]).
#[derive(Debug, Clone, Copy)]
#[non_exhaustive]
pub struct MetricSpec {
    /// nuPlan's name.
    pub name: &'static str,
    /// Short name for the heads of columns.
    pub label: &'static str,
    /// The list that computes it; `None`: both.
    pub list: Option<MetricList>,
    /// How it enters the score (devkit `*_weighted_average.yaml`).
    pub role: Role,
    /// nuPlan's category.
    pub category: MetricCategory,
    /// nuPlan's unit of its score.
    pub unit: ScoreUnit,
    /// Values of its time series outside these bounds lower the score; in the unit of the series.
    pub bounds: (Option<f64>, Option<f64>),
    /// Computes it.
    pub compute: Compute,
}

impl MetricSpec {
    /// A metric of both lists without score, in the category "Planning".
    pub const fn new(name: &'static str, compute: Compute) -> Self {
        Self {
            name,
            label: name,
            list: None,
            role: Role::Unscored,
            category: MetricCategory::Planning,
            unit: ScoreUnit::Float,
            bounds: (None, None),
            compute,
        }
    }

    /// Computed for one list only.
    pub const fn only(self, list: MetricList) -> Self {
        Self {
            list: Some(list),
            ..self
        }
    }

    /// Multiplies the weighted mean.
    pub const fn multiplier(self) -> Self {
        Self {
            role: Role::Multiplier,
            ..self
        }
    }

    /// Enters the weighted mean.
    pub const fn weight(self, weight: f64) -> Self {
        Self {
            role: Role::Weight(weight),
            ..self
        }
    }

    /// With a short name.
    pub const fn label(self, label: &'static str) -> Self {
        Self { label, ..self }
    }

    /// In another category.
    pub const fn category(self, category: MetricCategory) -> Self {
        Self { category, ..self }
    }

    /// With a truth value as score.
    pub const fn truth_value(self) -> Self {
        Self {
            unit: ScoreUnit::Bool,
            ..self
        }
    }

    /// With bounds of its time series.
    pub const fn bounds(self, min: Option<f64>, max: Option<f64>) -> Self {
        Self {
            bounds: (min, max),
            ..self
        }
    }

    /// Whether it multiplies the weighted mean.
    pub fn is_multiplier(&self) -> bool {
        self.role == Role::Multiplier
    }

    /// Its result with a score in [0, 1].
    pub fn scored(&self, score: f64, statistics: Vec<Statistic>) -> MetricResult {
        MetricResult {
            score: Some(score),
            score_unit: Some(self.unit),
            ..self.unscored(statistics)
        }
    }

    /// Its result without score.
    pub fn unscored(&self, statistics: Vec<Statistic>) -> MetricResult {
        MetricResult::unscored(self.name, self.category, statistics)
    }

    /// Its result of score 1 or 0, with that truth value as its last statistic.
    pub(super) fn judged(&self, holds: bool, mut statistics: Vec<Statistic>) -> MetricResult {
        statistics.push(Statistic::boolean(self.name, holds));
        self.scored(f64::from(u8::from(holds)), statistics)
    }
}

/// The metrics of a list that enter its score, multipliers first.
pub(super) fn scored(
    specs: &[MetricSpec],
    list: MetricList,
) -> impl Iterator<Item = &MetricSpec> + Clone {
    let of_list = move || {
        specs
            .iter()
            .filter(move |spec| spec.list.is_none_or(|own| own == list))
    };
    let weighted = |spec: &&MetricSpec| matches!(spec.role, Role::Weight(_));
    of_list()
        .filter(|spec| spec.is_multiplier())
        .chain(of_list().filter(weighted))
}
