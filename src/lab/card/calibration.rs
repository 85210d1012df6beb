//! Whether probable codes are good ones: the probability that the model gave its code, against the
//! code's regret.

use super::outcome::{Part, Share};
use super::state_record::StateRecord;
use crate::dataset::twins::RIGHT_WITHIN;
use crate::rank_correlation::tau_b;
use planagent_runs::worker::statistics::{Bootstrap, PairedDifference};
use serde::Serialize;

/// Maximum number of bins.
const MAX_BINS: usize = 5;
/// Minimum number of answers in a bin.
const MIN_BIN: usize = 8;

/// Probabilities of codes against their regrets.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Calibration {
    /// Codes with a probability and a value.
    pub(super) codes: usize,
    /// Kendall's tau-b of probability and regret: below 0 where probable codes are better ones.
    pub(super) tau: Option<f64>,
    /// Bins of equal counts, by probability.
    pub(super) bins: Vec<Bin>,
    /// Each code, by probability.
    pub(super) points: Vec<Point>,
}

/// A code.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(super) struct Point {
    pub(super) probability: f64,
    /// In the search's value.
    pub(super) regret: f64,
}

/// Codes of like probability.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Bin {
    /// Lowest and highest probability.
    pub(super) from: f64,
    pub(super) to: f64,
    pub(super) mean_probability: f64,
    /// Codes that are as good as the best known one.
    pub(super) right: Share,
    /// Mean regret with its bootstrap interval.
    pub(super) regret: Option<PairedDifference>,
}

impl Calibration {
    /// The calibration of the answers at states; `unknown` says why they have no probabilities, if
    /// they have none.
    pub(super) fn new(records: &[StateRecord], unknown: &str) -> Part<Self> {
        let point = |record: &StateRecord| {
            Some(Point {
                probability: record.own.log_probability?.exp(),
                regret: record.regret(&record.own)?,
            })
        };
        let points: Vec<Point> = records.iter().filter_map(point).collect();
        if points.is_empty() {
            let has_some = records
                .iter()
                .any(|record| record.own.log_probability.is_some());
            return Part::missing(if has_some {
                "no code with a probability gives a plan"
            } else {
                unknown
            });
        }
        Part::Known(Self::from_points(points))
    }

    fn from_points(mut points: Vec<Point>) -> Self {
        points.sort_by(|a, b| {
            let by_regret = || a.regret.total_cmp(&b.regret);
            a.probability.total_cmp(&b.probability).then_with(by_regret)
        });
        let of = |value: fn(&Point) -> f64| points.iter().map(value).collect::<Vec<f64>>();
        let tau = tau_b(&of(|point| point.probability), &of(|point| point.regret));
        let count = (points.len() / MIN_BIN).clamp(1, MAX_BINS);
        let ends: Vec<usize> = (0..=count).map(|bin| bin * points.len() / count).collect();
        let bins = ends
            .windows(2)
            .filter_map(|ends| Bin::new(points.get(*ends.first()?..*ends.last()?)?));
        Self {
            codes: points.len(),
            tau,
            bins: bins.collect(),
            points,
        }
    }
}

impl Bin {
    fn new(points: &[Point]) -> Option<Self> {
        let regrets: Vec<f64> = points.iter().map(|point| point.regret).collect();
        let sum: f64 = points.iter().map(|point| point.probability).sum();
        Some(Self {
            from: points.first()?.probability,
            to: points.last()?.probability,
            mean_probability: sum / points.len() as f64,
            right: Share::counted(points, |point| point.regret <= RIGHT_WITHIN),
            regret: Bootstrap::default().difference(&regrets),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(count: usize, regret: impl Fn(usize) -> f64) -> Vec<Point> {
        let point = |i: usize| Point {
            probability: (i as f64 + 0.5) / count as f64,
            regret: regret(i),
        };
        // In another order than that of the probabilities.
        (0..count).rev().map(point).collect()
    }

    #[test]
    fn bins_have_equal_counts_in_the_order_of_probability() {
        let found = Calibration::from_points(points(43, |i| if i < 20 { 0.5 } else { 0.0 }));
        assert_eq!((found.codes, found.bins.len()), (43, 5));
        let counts: Vec<usize> = found.bins.iter().map(|bin| bin.right.of).collect();
        assert_eq!(counts, [8, 9, 8, 9, 9]);
        assert!(found.bins.is_sorted_by(|a, b| a.to < b.from));
        let shares: Vec<usize> = found.bins.iter().map(|bin| bin.right.count).collect();
        assert_eq!(shares, [0, 0, 5, 9, 9]);
        let first = found.bins[0].regret.unwrap();
        assert_eq!((first.mean, first.low, first.high), (0.5, 0.5, 0.5));
        assert!(found.tau.unwrap() < -0.5, "{:?}", found.tau);
    }

    #[test]
    fn few_codes_have_one_bin_and_equal_ones_no_order() {
        let found = Calibration::from_points(points(7, |_| 0.25));
        assert_eq!((found.bins.len(), found.tau), (1, None));
        assert!((found.bins[0].mean_probability - 0.5).abs() < 1e-12);
        assert_eq!(found.bins[0].right.percent, Some(0.0));
    }

    #[test]
    fn without_probabilities_there_is_a_reason_and_no_number() {
        let part = Calibration::new(&[], "the server does not say them");
        assert_eq!(
            part.why_not().unwrap(),
            "Not available: the server does not say them."
        );
        let json = serde_json::to_value(&part).unwrap();
        assert_eq!(json["not_available"], "the server does not say them");
    }
}
