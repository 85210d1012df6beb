//! The score of one scenario from its metrics.

use super::spec::scored;
use super::{MetricError, MetricList, MetricResult, MetricSpec, Role};

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
    /// The weighting by the roles of these metrics.
    pub(super) fn new<'a>(specs: impl Iterator<Item = &'a MetricSpec>) -> Self {
        let mut weighting = Self {
            multipliers: Vec::new(),
            weights: Vec::new(),
            default_weight: 1.0,
        };
        for spec in specs {
            match spec.role {
                Role::Multiplier => weighting.multipliers.push(spec.name.to_owned()),
                Role::Weight(weight) => weighting.weights.push((spec.name.to_owned(), weight)),
                Role::Unscored => {}
            }
        }
        weighting
    }

    fn is_multiplier(&self, name: &str) -> bool {
        self.multipliers.iter().any(|m| m == name)
    }

    fn weight(&self, name: &str) -> f64 {
        self.weights
            .iter()
            .find(|(n, _)| n == name)
            .map_or(self.default_weight, |&(_, w)| w)
    }
}

/// Product of the multipliers times the weighted mean of the other metrics. A metric without score
/// leaves both sums; without any weighted score the mean is 0.
pub fn combine<'a>(
    metrics: impl IntoIterator<Item = (&'a str, Option<f64>)>,
    weighting: &Weighting,
) -> f64 {
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
    if weights > 0.0 {
        product * sum / weights
    } else {
        0.0
    }
}

/// One metric of a score.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct ScorePart {
    /// nuPlan's name of the metric.
    pub name: &'static str,
    /// How it enters the score.
    pub role: Role,
    /// Its score, in [0, 1].
    pub score: f64,
}

/// nuPlan's score of one scenario, in [0, 1], with its parts.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Score {
    /// The score: product of the multipliers times the weighted mean.
    pub value: f64,
    /// Product of the multipliers.
    pub multiplier: f64,
    /// Weighted mean of the other metrics.
    pub weighted_average: f64,
    /// The list of metrics.
    pub list: MetricList,
    /// The multipliers, then the weighted metrics.
    pub parts: Vec<ScorePart>,
}

impl Score {
    /// The score of the metrics of a list; other results are ignored.
    pub fn from_results(
        list: MetricList,
        specs: &[MetricSpec],
        results: &[MetricResult],
    ) -> Result<Self, MetricError> {
        let part = |spec: &MetricSpec| {
            let score = results
                .iter()
                .find(|r| r.name == spec.name)
                .and_then(|r| r.score);
            // A missing metric is an error: a score without it would not compare with others.
            let score = score.ok_or(MetricError::NoScore(spec.name))?;
            Ok(ScorePart {
                name: spec.name,
                role: spec.role,
                score,
            })
        };
        let parts: Vec<ScorePart> = scored(specs, list).map(part).collect::<Result<_, _>>()?;
        let weighting = Weighting::new(scored(specs, list));
        let named = |part: &ScorePart| (part.name, Some(part.score));
        let weighted = parts.iter().filter(|part| part.role != Role::Multiplier);
        Ok(Self {
            value: combine(parts.iter().map(named), &weighting),
            multiplier: parts
                .iter()
                .filter(|part| part.role == Role::Multiplier)
                .map(|part| part.score)
                .product(),
            weighted_average: combine(weighted.map(named), &weighting),
            list,
            parts,
        })
    }

    /// The score of one metric by its name; `None` when it does not enter this score.
    pub fn metric(&self, name: &str) -> Option<f64> {
        self.parts
            .iter()
            .find(|part| part.name == name)
            .map(|part| part.score)
    }

    /// The names of the multipliers that are 0.
    pub fn zero_multipliers(&self) -> impl Iterator<Item = &'static str> + '_ {
        self.parts
            .iter()
            .filter(|part| part.role == Role::Multiplier && part.score <= 0.0)
            .map(|part| part.name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    use crate::metrics::METRICS;

    fn results<const N: usize>(list: MetricList, scores: [f64; N]) -> Vec<MetricResult> {
        assert_eq!(list.scored().count(), N);
        list.scored()
            .zip(scores)
            .map(|(spec, score)| spec.scored(score, vec![]))
            .collect()
    }

    fn score<const N: usize>(list: MetricList, scores: [f64; N]) -> Score {
        Score::from_results(list, &METRICS, &results(list, scores)).unwrap()
    }

    #[test]
    fn weights_sum_to_sixteen_and_multipliers_multiply() {
        // 0.5 · (5·0.8 + 5·0 + 4·0.5 + 2·1)/16 = 0.5 · 8/16.
        let score = score(
            MetricList::ClosedLoop,
            [0.5, 1.0, 1.0, 1.0, 0.8, 0.0, 0.5, 1.0],
        );
        assert!((score.value - 0.25).abs() < 1e-12);
        assert!(
            (score.weighted_average - 0.5).abs() < 1e-12 && (score.multiplier - 0.5).abs() < 1e-12
        );
        assert_eq!(score.zero_multipliers().next(), None);
    }

    #[test]
    fn the_open_loop_score_weighs_headings_twice() {
        // (1·0.5 + 1·0.2 + 2·0.9 + 2·0.4)/6 = 3.3/6; a miss makes it 0.
        let of = |miss: f64| score(MetricList::OpenLoop, [miss, 0.5, 0.2, 0.9, 0.4]);
        assert!((of(1.0).value - 0.55).abs() < 1e-12);
        assert!(of(0.0).value.abs() < 1e-12 && (of(0.0).weighted_average - 0.55).abs() < 1e-12);
        assert_eq!(
            of(0.0).zero_multipliers().next(),
            Some("planner_miss_rate_within_bound")
        );
        assert_eq!(of(1.0).metric("ego_is_comfortable"), None);
    }

    #[test]
    fn a_score_of_zero_names_its_multipliers() {
        let score = score(
            MetricList::ClosedLoop,
            [1.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 1.0],
        );
        assert!(score.value.abs() < 1e-12);
        let all: Vec<_> = score.zero_multipliers().collect();
        assert_eq!(all, ["drivable_area_compliance", "ego_is_making_progress"]);
    }

    #[test]
    fn a_missing_metric_is_an_error() {
        let missing = &results(MetricList::ClosedLoop, [1.0; 8])[1..];
        let error = Score::from_results(MetricList::ClosedLoop, &METRICS, missing);
        assert_eq!(
            error,
            Err(MetricError::NoScore("no_ego_at_fault_collisions"))
        );
    }
}
