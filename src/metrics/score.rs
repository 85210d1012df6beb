//! How the metrics of one scenario become its score.

use super::MetricResult;
use serde::{Deserialize, Serialize};
use std::fmt;

/// The eight metrics that enter nuPlan's closed-loop score.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MetricName {
    /// Multiplier: 0, 0.5 or 1.
    NoEgoAtFaultCollisions,
    /// Multiplier: 0 or 1.
    DrivableAreaCompliance,
    /// Multiplier: 0 or 1.
    EgoIsMakingProgress,
    /// Multiplier: 0, 0.5 or 1.
    DrivingDirectionCompliance,
    /// Weight 5.
    EgoProgressAlongExpertRoute,
    /// Weight 5.
    TimeToCollisionWithinBound,
    /// Weight 4.
    SpeedLimitCompliance,
    /// Weight 2.
    EgoIsComfortable,
}

impl MetricName {
    /// All eight, multipliers first.
    pub const ALL: [Self; 8] = [
        Self::NoEgoAtFaultCollisions,
        Self::DrivableAreaCompliance,
        Self::EgoIsMakingProgress,
        Self::DrivingDirectionCompliance,
        Self::EgoProgressAlongExpertRoute,
        Self::TimeToCollisionWithinBound,
        Self::SpeedLimitCompliance,
        Self::EgoIsComfortable,
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
        }
    }

    /// Weight in the average (devkit `closed_loop_*_agents_weighted_average.yaml`); `None` for a multiplier.
    pub fn weight(self) -> Option<f64> {
        match self {
            Self::EgoProgressAlongExpertRoute | Self::TimeToCollisionWithinBound => Some(5.0),
            Self::SpeedLimitCompliance => Some(4.0),
            Self::EgoIsComfortable => Some(2.0),
            _ => None,
        }
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
    /// nuPlan's closed-loop weighting, the same for non-reactive and reactive traffic.
    pub fn closed_loop() -> Self {
        let multipliers = MetricName::ALL.iter().filter(|metric| metric.weight().is_none());
        Self {
            multipliers: multipliers.map(ToString::to_string).collect(),
            weights: MetricName::ALL.iter().filter_map(|m| m.weight().map(|w| (m.to_string(), w))).collect(),
            default_weight: 1.0,
        }
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

/// nuPlan's closed-loop score of one scenario, in [0, 1], with all that it is made of.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Score {
    /// The score: product of the multipliers times the weighted mean.
    pub value: f64,
    /// Multiplier: 1, 0.5 (one collision with an object) or 0.
    pub no_ego_at_fault_collisions: f64,
    /// Multiplier: 1 or 0.
    pub drivable_area_compliance: f64,
    /// Multiplier: 1 or 0.
    pub ego_is_making_progress: f64,
    /// Multiplier: 1, 0.5 or 0.
    pub driving_direction_compliance: f64,
    /// Weight 5, in [0, 1].
    pub ego_progress_along_expert_route: f64,
    /// Weight 5: 1 or 0.
    pub time_to_collision_within_bound: f64,
    /// Weight 4, in [0, 1].
    pub speed_limit_compliance: f64,
    /// Weight 2: 1 or 0.
    pub ego_is_comfortable: f64,
    /// Product of the four multipliers.
    pub multiplier: f64,
    /// Weighted mean of the other four.
    pub weighted_average: f64,
    /// The first multiplier that made the score 0, in the order of [`MetricName::ALL`].
    pub zeroed_by: Option<MetricName>,
}

impl Score {
    /// The score made of the results of the eight metrics; others are ignored.
    ///
    /// # Errors
    /// When one of the eight is missing or has no score.
    pub fn of(results: &[MetricResult]) -> Result<Self, ScoreError> {
        let score = |name: MetricName| {
            results.iter().find(|r| r.name == name.as_str()).and_then(|r| r.score).ok_or(ScoreError(name))
        };
        let mut eight = Vec::with_capacity(MetricName::ALL.len());
        for name in MetricName::ALL {
            eight.push((name, score(name)?));
        }
        let weighting = Weighting::closed_loop();
        let (multipliers, weighted): (Vec<_>, Vec<_>) = eight.iter().partition(|(name, _)| name.weight().is_none());
        Ok(Self {
            value: combine(eight.iter().map(|&(name, s)| (name.as_str(), Some(s))), &weighting),
            no_ego_at_fault_collisions: score(MetricName::NoEgoAtFaultCollisions)?,
            drivable_area_compliance: score(MetricName::DrivableAreaCompliance)?,
            ego_is_making_progress: score(MetricName::EgoIsMakingProgress)?,
            driving_direction_compliance: score(MetricName::DrivingDirectionCompliance)?,
            ego_progress_along_expert_route: score(MetricName::EgoProgressAlongExpertRoute)?,
            time_to_collision_within_bound: score(MetricName::TimeToCollisionWithinBound)?,
            speed_limit_compliance: score(MetricName::SpeedLimitCompliance)?,
            ego_is_comfortable: score(MetricName::EgoIsComfortable)?,
            multiplier: multipliers.iter().map(|&(_, s)| s).product(),
            weighted_average: combine(weighted.iter().map(|&(name, s)| (name.as_str(), Some(s))), &weighting),
            zeroed_by: multipliers.iter().find(|&&(_, s)| s <= 0.0).map(|&(name, _)| name),
        })
    }

    /// The score of one metric.
    pub fn metric(&self, name: MetricName) -> f64 {
        match name {
            MetricName::NoEgoAtFaultCollisions => self.no_ego_at_fault_collisions,
            MetricName::DrivableAreaCompliance => self.drivable_area_compliance,
            MetricName::EgoIsMakingProgress => self.ego_is_making_progress,
            MetricName::DrivingDirectionCompliance => self.driving_direction_compliance,
            MetricName::EgoProgressAlongExpertRoute => self.ego_progress_along_expert_route,
            MetricName::TimeToCollisionWithinBound => self.time_to_collision_within_bound,
            MetricName::SpeedLimitCompliance => self.speed_limit_compliance,
            MetricName::EgoIsComfortable => self.ego_is_comfortable,
        }
    }

    /// Every multiplier that is 0.
    pub fn zero_multipliers(&self) -> impl Iterator<Item = MetricName> + '_ {
        MetricName::ALL.into_iter().filter(|&name| name.weight().is_none() && self.metric(name) <= 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn results(scores: [f64; 8]) -> Vec<MetricResult> {
        MetricName::ALL
            .into_iter()
            .zip(scores)
            .map(|(name, score)| MetricResult {
                name: name.to_string(),
                score: Some(score),
                statistics: vec![],
                time_series: None,
            })
            .collect()
    }

    #[test]
    fn weights_sum_to_sixteen_and_multipliers_multiply() {
        // 0.5 · (5·0.8 + 5·0 + 4·0.5 + 2·1)/16 = 0.5 · 8/16.
        let score = Score::of(&results([0.5, 1.0, 1.0, 1.0, 0.8, 0.0, 0.5, 1.0])).unwrap();
        assert!((score.value - 0.25).abs() < 1e-12);
        assert!((score.weighted_average - 0.5).abs() < 1e-12 && (score.multiplier - 0.5).abs() < 1e-12);
        assert_eq!(score.zeroed_by, None);
    }

    #[test]
    fn a_score_of_zero_names_its_multiplier() {
        let score = Score::of(&results([1.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 1.0])).unwrap();
        assert!(score.value.abs() < 1e-12);
        assert_eq!(score.zeroed_by, Some(MetricName::DrivableAreaCompliance));
        let all: Vec<_> = score.zero_multipliers().collect();
        assert_eq!(all, [MetricName::DrivableAreaCompliance, MetricName::EgoIsMakingProgress]);
    }

    #[test]
    fn a_missing_metric_is_an_error() {
        let missing = &results([1.0; 8])[1..];
        assert_eq!(Score::of(missing), Err(ScoreError(MetricName::NoEgoAtFaultCollisions)));
    }
}
