//! How the metrics of one scenario become its score.

use super::{MetricCategory, MetricResult, ScoreUnit};
use serde::{Deserialize, Serialize};
use std::fmt;

/// The metrics that enter a score: eight in closed loop, five in open loop.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MetricName {
    /// Closed loop, multiplier: 0, 0.5 or 1.
    NoEgoAtFaultCollisions,
    /// Closed loop, multiplier: 0 or 1.
    DrivableAreaCompliance,
    /// Closed loop, multiplier: 0 or 1.
    EgoIsMakingProgress,
    /// Closed loop, multiplier: 0, 0.5 or 1.
    DrivingDirectionCompliance,
    /// Closed loop, weight 5.
    EgoProgressAlongExpertRoute,
    /// Closed loop, weight 5.
    TimeToCollisionWithinBound,
    /// Closed loop, weight 4.
    SpeedLimitCompliance,
    /// Closed loop, weight 2.
    EgoIsComfortable,
    /// Open loop, multiplier: 0 or 1.
    PlannerMissRateWithinBound,
    /// Open loop, weight 1: average displacement error.
    #[serde(rename = "planner_expert_average_l2_error_within_bound")]
    PlannerExpertAverageL2ErrorWithinBound,
    /// Open loop, weight 1: final displacement error.
    #[serde(rename = "planner_expert_final_l2_error_within_bound")]
    PlannerExpertFinalL2ErrorWithinBound,
    /// Open loop, weight 2: average heading error.
    PlannerExpertAverageHeadingErrorWithinBound,
    /// Open loop, weight 2: final heading error.
    PlannerExpertFinalHeadingErrorWithinBound,
}

/// What a metric does in a score.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Role {
    /// It multiplies the weighted mean.
    Multiplier,
    /// It enters the weighted mean with this weight.
    Weight(f64),
}

/// nuPlan's lists of metrics.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MetricList {
    /// Of the two closed-loop challenges.
    ClosedLoop,
    /// Of the challenge `open_loop_boxes`.
    OpenLoop,
}

impl MetricList {
    /// The metrics that enter the score, multipliers first.
    pub fn scored(self) -> &'static [MetricName] {
        match self {
            Self::ClosedLoop => &MetricName::CLOSED_LOOP,
            Self::OpenLoop => &MetricName::OPEN_LOOP,
        }
    }
}

impl MetricName {
    /// The eight of the closed-loop score, multipliers first.
    pub const CLOSED_LOOP: [Self; 8] = [
        Self::NoEgoAtFaultCollisions,
        Self::DrivableAreaCompliance,
        Self::EgoIsMakingProgress,
        Self::DrivingDirectionCompliance,
        Self::EgoProgressAlongExpertRoute,
        Self::TimeToCollisionWithinBound,
        Self::SpeedLimitCompliance,
        Self::EgoIsComfortable,
    ];

    /// The five of the open-loop score, the multiplier first.
    pub const OPEN_LOOP: [Self; 5] = [
        Self::PlannerMissRateWithinBound,
        Self::PlannerExpertAverageL2ErrorWithinBound,
        Self::PlannerExpertFinalL2ErrorWithinBound,
        Self::PlannerExpertAverageHeadingErrorWithinBound,
        Self::PlannerExpertFinalHeadingErrorWithinBound,
    ];

    /// nuPlan's name.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::NoEgoAtFaultCollisions => "no_ego_at_fault_collisions",
            Self::DrivableAreaCompliance => "drivable_area_compliance",
            Self::EgoIsMakingProgress => "ego_is_making_progress",
            Self::DrivingDirectionCompliance => "driving_direction_compliance",
            Self::EgoProgressAlongExpertRoute => "ego_progress_along_expert_route",
            Self::TimeToCollisionWithinBound => "time_to_collision_within_bound",
            Self::SpeedLimitCompliance => "speed_limit_compliance",
            Self::EgoIsComfortable => "ego_is_comfortable",
            Self::PlannerMissRateWithinBound => "planner_miss_rate_within_bound",
            Self::PlannerExpertAverageL2ErrorWithinBound => "planner_expert_average_l2_error_within_bound",
            Self::PlannerExpertFinalL2ErrorWithinBound => "planner_expert_final_l2_error_within_bound",
            Self::PlannerExpertAverageHeadingErrorWithinBound => "planner_expert_average_heading_error_within_bound",
            Self::PlannerExpertFinalHeadingErrorWithinBound => "planner_expert_final_heading_error_within_bound",
        }
    }

    /// What it does in its score (devkit `closed_loop_*_agents_weighted_average.yaml`,
    /// `open_loop_boxes_weighted_average.yaml`).
    pub fn role(self) -> Role {
        match self {
            Self::NoEgoAtFaultCollisions
            | Self::DrivableAreaCompliance
            | Self::EgoIsMakingProgress
            | Self::DrivingDirectionCompliance
            | Self::PlannerMissRateWithinBound => Role::Multiplier,
            Self::EgoProgressAlongExpertRoute | Self::TimeToCollisionWithinBound => Role::Weight(5.0),
            Self::SpeedLimitCompliance => Role::Weight(4.0),
            Self::EgoIsComfortable
            | Self::PlannerExpertAverageHeadingErrorWithinBound
            | Self::PlannerExpertFinalHeadingErrorWithinBound => Role::Weight(2.0),
            Self::PlannerExpertAverageL2ErrorWithinBound | Self::PlannerExpertFinalL2ErrorWithinBound => {
                Role::Weight(1.0)
            }
        }
    }

    /// nuPlan's category of it (devkit `simulation_metric/**/*.yaml`).
    pub fn category(self) -> MetricCategory {
        match self {
            Self::NoEgoAtFaultCollisions => MetricCategory::Dynamics,
            Self::SpeedLimitCompliance | Self::EgoIsComfortable => MetricCategory::Violations,
            _ => MetricCategory::Planning,
        }
    }

    /// nuPlan's unit of its score (devkit `simulation_metric/**/*.yaml`).
    pub fn score_unit(self) -> ScoreUnit {
        match self {
            Self::DrivableAreaCompliance
            | Self::EgoIsMakingProgress
            | Self::DrivingDirectionCompliance
            | Self::TimeToCollisionWithinBound
            | Self::EgoIsComfortable
            | Self::PlannerMissRateWithinBound => ScoreUnit::Bool,
            Self::NoEgoAtFaultCollisions
            | Self::EgoProgressAlongExpertRoute
            | Self::SpeedLimitCompliance
            | Self::PlannerExpertAverageL2ErrorWithinBound
            | Self::PlannerExpertFinalL2ErrorWithinBound
            | Self::PlannerExpertAverageHeadingErrorWithinBound
            | Self::PlannerExpertFinalHeadingErrorWithinBound => ScoreUnit::Float,
        }
    }

    /// Whether it multiplies.
    pub fn is_multiplier(self) -> bool {
        self.role() == Role::Multiplier
    }
}

impl fmt::Display for MetricName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// Which metrics multiply and how much the others weigh.
#[derive(Debug, Clone, PartialEq)]
pub struct Weighting {
    /// Names of the metrics whose product multiplies the average.
    pub multipliers: Vec<String>,
    /// Weights by name.
    pub weights: Vec<(String, f64)>,
    /// Weight of a metric that is not named.
    pub default_weight: f64,
}

impl Weighting {
    /// nuPlan's weighting of a list of metrics; the same for non-reactive and reactive traffic.
    pub fn of(list: MetricList) -> Self {
        let mut weighting = Self { multipliers: Vec::new(), weights: Vec::new(), default_weight: 1.0 };
        for metric in list.scored() {
            match metric.role() {
                Role::Multiplier => weighting.multipliers.push(metric.to_string()),
                Role::Weight(weight) => weighting.weights.push((metric.to_string(), weight)),
            }
        }
        weighting
    }

    fn is_multiplier(&self, name: &str) -> bool {
        self.multipliers.iter().any(|m| m == name)
    }

    fn weight(&self, name: &str) -> f64 {
        self.weights.iter().find(|(n, _)| n == name).map_or(self.default_weight, |&(_, w)| w)
    }
}

/// Product of the multipliers times the weighted mean of the other metrics. A metric without score leaves both sums;
/// without any weighted score the mean is 0.
pub fn combine<'a>(metrics: impl IntoIterator<Item = (&'a str, Option<f64>)>, weighting: &Weighting) -> f64 {
    let (mut product, mut sum, mut weights) = (1.0, 0.0, 0.0);
    for (name, score) in metrics {
        let Some(score) = score else { continue };
        if weighting.is_multiplier(name) {
            product *= score;
        } else {
            let weight = weighting.weight(name);
            sum += weight * score;
            weights += weight;
        }
    }
    if weights > 0.0 { product * sum / weights } else { 0.0 }
}

/// A metric that should carry a score does not.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the metric {0} has no score")]
pub struct ScoreError(pub MetricName);

/// What one metric contributes to a score.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ScorePart {
    /// Which metric; its [`MetricName::role`] says what it does.
    pub name: MetricName,
    /// Its score, in [0, 1].
    pub score: f64,
}

/// nuPlan's score of one scenario, in [0, 1], with all that it is made of.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Score {
    /// The score: product of the multipliers times the weighted mean.
    pub value: f64,
    /// Product of the multipliers.
    pub multiplier: f64,
    /// Weighted mean of the other metrics.
    pub weighted_average: f64,
    /// Which list of metrics it is made of.
    pub list: MetricList,
    /// The metrics of the list in its order, multipliers first.
    pub parts: Vec<ScorePart>,
}

impl Score {
    /// The score made of the results of a list's metrics; others are ignored.
    ///
    /// # Errors
    /// When one of the list is missing or has no score.
    pub fn of(list: MetricList, results: &[MetricResult]) -> Result<Self, ScoreError> {
        let score = |name: MetricName| {
            results.iter().find(|r| r.name == name.as_str()).and_then(|r| r.score).ok_or(ScoreError(name))
        };
        let parts: Vec<ScorePart> =
            list.scored().iter().map(|&name| Ok(ScorePart { name, score: score(name)? })).collect::<Result<_, _>>()?;
        let weighting = Weighting::of(list);
        let named = |part: &ScorePart| (part.name.as_str(), Some(part.score));
        let (multipliers, weighted): (Vec<ScorePart>, Vec<ScorePart>) =
            parts.iter().partition(|part| part.name.is_multiplier());
        Ok(Self {
            value: combine(parts.iter().map(named), &weighting),
            multiplier: multipliers.iter().map(|part| part.score).product(),
            weighted_average: combine(weighted.iter().map(named), &weighting),
            list,
            parts,
        })
    }

    /// The score of one metric; `None` when it does not enter this score.
    pub fn metric(&self, name: MetricName) -> Option<f64> {
        self.parts.iter().find(|part| part.name == name).map(|part| part.score)
    }

    /// Every multiplier that is 0, in the order of the list.
    pub fn zero_multipliers(&self) -> impl Iterator<Item = MetricName> + '_ {
        self.parts.iter().filter(|part| part.name.is_multiplier() && part.score <= 0.0).map(|part| part.name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn results<const N: usize>(list: MetricList, scores: [f64; N]) -> Vec<MetricResult> {
        assert_eq!(list.scored().len(), N);
        list.scored().iter().zip(scores).map(|(&name, score)| MetricResult::scored(name, score, vec![])).collect()
    }

    fn closed_loop(scores: [f64; 8]) -> Score {
        Score::of(MetricList::ClosedLoop, &results(MetricList::ClosedLoop, scores)).unwrap()
    }

    #[test]
    fn weights_sum_to_sixteen_and_multipliers_multiply() {
        // 0.5 · (5·0.8 + 5·0 + 4·0.5 + 2·1)/16 = 0.5 · 8/16.
        let score = closed_loop([0.5, 1.0, 1.0, 1.0, 0.8, 0.0, 0.5, 1.0]);
        assert!((score.value - 0.25).abs() < 1e-12);
        assert!((score.weighted_average - 0.5).abs() < 1e-12 && (score.multiplier - 0.5).abs() < 1e-12);
        assert_eq!(score.zero_multipliers().next(), None);
    }

    #[test]
    fn the_open_loop_score_weighs_headings_twice() {
        // (1·0.5 + 1·0.2 + 2·0.9 + 2·0.4)/6 = 3.3/6; a miss makes it 0.
        let of = |miss: f64| {
            let list = MetricList::OpenLoop;
            Score::of(list, &results(list, [miss, 0.5, 0.2, 0.9, 0.4])).unwrap()
        };
        assert!((of(1.0).value - 0.55).abs() < 1e-12);
        assert!(of(0.0).value.abs() < 1e-12 && (of(0.0).weighted_average - 0.55).abs() < 1e-12);
        assert_eq!(of(0.0).zero_multipliers().next(), Some(MetricName::PlannerMissRateWithinBound));
        assert_eq!(of(1.0).metric(MetricName::EgoIsComfortable), None);
    }

    #[test]
    fn a_score_of_zero_names_its_multipliers() {
        let score = closed_loop([1.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 1.0]);
        assert!(score.value.abs() < 1e-12);
        let all: Vec<_> = score.zero_multipliers().collect();
        assert_eq!(all, [MetricName::DrivableAreaCompliance, MetricName::EgoIsMakingProgress]);
    }

    #[test]
    fn a_missing_metric_is_an_error() {
        let missing = &results(MetricList::ClosedLoop, [1.0; 8])[1..];
        let error = Score::of(MetricList::ClosedLoop, missing);
        assert_eq!(error, Err(ScoreError(MetricName::NoEgoAtFaultCollisions)));
    }

    #[test]
    fn serialised_names_are_nuplans() {
        for name in MetricName::CLOSED_LOOP.into_iter().chain(MetricName::OPEN_LOOP) {
            assert_eq!(serde_json::to_value(name).unwrap(), name.as_str());
        }
    }
}
