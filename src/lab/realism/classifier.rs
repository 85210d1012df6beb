//! A logistic regression that tells scenes of two sets apart, and how often it is right about
//! unseen scenes.

use super::distribution::{distribution, mean};
use nalgebra::{DMatrix, DVector};
use planagent_runs::worker::statistics::{Bootstrap, PairedDifference};
use serde::Serialize;
use std::collections::BTreeMap;

/// Parts of the cross-validation.
pub(crate) const FOLDS: usize = 10;
/// Weight of the squared coefficients against the log loss: as strong as one scene. scikit-learn's
/// default.
const RIDGE: f64 = 1.0;
/// Newton steps; the loss is convex, and a dozen steps reach the last digits.
const STEPS: usize = 30;

/// A scene of A or B.
pub(super) struct Sample {
    /// Scenes of one group are in one fold.
    pub(super) group: String,
    pub(super) values: Vec<Option<f64>>,
    pub(super) is_a: bool,
}

/// How often the classifier is right, in shares of 1. Both sets count equally, so 0.5 is chance.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Accuracy {
    pub mean: f64,
    /// Ends of the 95 % interval of a bootstrap over recordings. The folds are fixed.
    pub low: f64,
    pub high: f64,
    /// Share of the scenes of A that are recognized.
    pub of_a: f64,
    /// Share of the scenes of B that are recognized.
    pub of_b: f64,
    /// True if a constant would do as well: the interval holds 0.5.
    pub chance: bool,
}

/// A fitted classifier.
pub(super) struct Classifier {
    means: Vec<f64>,
    deviations: Vec<f64>,
    intercept: f64,
    /// For a standard deviation of each feature.
    pub(super) coefficients: Vec<f64>,
}

/// Whether each sample is recognized by a classifier that was fitted without its fold; `None` with
/// fewer groups than folds in a set.
pub(super) fn cross_validated(samples: &[Sample]) -> Option<Accuracy> {
    let folds = folds(samples)?;
    let mut right: [BTreeMap<&str, Vec<f64>>; 2] = Default::default();
    for fold in 0..FOLDS {
        let (test, train): (Vec<usize>, Vec<usize>) =
            (0..samples.len()).partition(|&place| folds[place] == fold);
        let classifier = fitted(
            &train
                .iter()
                .map(|&place| &samples[place])
                .collect::<Vec<_>>(),
        );
        for sample in test.into_iter().map(|place| &samples[place]) {
            let is_right = (classifier.log_odds(&sample.values) > 0.0) == sample.is_a;
            let of_set = &mut right[usize::from(!sample.is_a)];
            of_set
                .entry(&sample.group)
                .or_default()
                .push(f64::from(u8::from(is_right)));
        }
    }
    let clusters = right.map(|groups| groups.into_values().collect::<Vec<_>>());
    let share = |set: &[Vec<f64>]| mean(set.iter().flatten().copied());
    // Balanced: naming the larger set each time must not be right more often than half.
    let PairedDifference {
        mean, low, high, ..
    } = Bootstrap::default().balanced(&clusters)?;
    let chance = low <= 0.5;
    Some(Accuracy {
        mean,
        low,
        high,
        of_a: share(&clusters[0])?,
        of_b: share(&clusters[1])?,
        chance,
    })
}

/// The fold of each sample: the groups of each set in turn.
fn folds(samples: &[Sample]) -> Option<Vec<usize>> {
    let mut places: [BTreeMap<&str, usize>; 2] = Default::default();
    let of = samples.iter().map(|sample| {
        let known = &mut places[usize::from(!sample.is_a)];
        let next = known.len();
        *known.entry(&sample.group).or_insert(next) % FOLDS
    });
    let of: Vec<usize> = of.collect();
    places
        .iter()
        .all(|groups| groups.len() >= FOLDS)
        .then_some(of)
}

/// The classifier of samples. Features are standardized; one that a scene lacks counts as the mean.
pub(super) fn fitted<S: std::borrow::Borrow<Sample>>(samples: &[S]) -> Classifier {
    let width = samples
        .first()
        .map_or(0, |sample| sample.borrow().values.len());
    let count = samples.len();
    let (mut means, mut deviations) = (Vec::with_capacity(width), Vec::with_capacity(width));
    for feature in 0..width {
        let known: Vec<f64> = samples
            .iter()
            .filter_map(|sample| sample.borrow().values[feature])
            .collect();
        let found = distribution(&known);
        means.push(found.map_or(0.0, |found| found.mean));
        deviations.push(
            found
                .map(|found| found.deviation)
                .filter(|deviation| *deviation > 1e-9)
                .unwrap_or(1.0),
        );
    }
    let mut classifier = Classifier {
        means,
        deviations,
        intercept: 0.0,
        coefficients: vec![0.0; width],
    };
    let in_a = samples.iter().filter(|sample| sample.borrow().is_a).count();
    // Both sets weigh the same.
    let weight = |is_a: bool| count as f64 / 2.0 / (if is_a { in_a } else { count - in_a }) as f64;
    let rows = DMatrix::from_fn(count, width + 1, |row, column| match column {
        0 => 1.0,
        _ => classifier.standardized(column - 1, samples[row].borrow().values[column - 1]),
    });
    let wanted: Vec<f64> = samples
        .iter()
        .map(|sample| f64::from(u8::from(sample.borrow().is_a)))
        .collect();
    let weights: Vec<f64> = samples
        .iter()
        .map(|sample| weight(sample.borrow().is_a))
        .collect();
    let mut beta = DVector::zeros(width + 1);
    for _ in 0..STEPS {
        let odds = &rows * &beta;
        let chances: Vec<f64> = odds
            .iter()
            .map(|odds| 1.0 / (1.0 + (-odds).exp()))
            .collect();
        let residuals =
            DVector::from_fn(count, |row, _| weights[row] * (wanted[row] - chances[row]));
        let mut scaled = rows.clone();
        for (row, mut values) in scaled.row_iter_mut().enumerate() {
            values *= weights[row] * chances[row] * (1.0 - chances[row]);
        }
        let mut curvature = rows.transpose() * scaled;
        let mut slope = rows.transpose() * residuals;
        for feature in 1..=width {
            curvature[(feature, feature)] += RIDGE;
            slope[feature] -= RIDGE * beta[feature];
        }
        // Without it, samples that are certain would leave the intercept undetermined.
        curvature[(0, 0)] += 1e-9;
        let Some(inverse) = curvature.cholesky() else {
            break;
        };
        beta += inverse.solve(&slope);
    }
    classifier.intercept = beta[0];
    classifier.coefficients = beta.iter().skip(1).copied().collect();
    classifier
}

impl Classifier {
    fn standardized(&self, feature: usize, value: Option<f64>) -> f64 {
        value.map_or(0.0, |value| {
            (value - self.means[feature]) / self.deviations[feature]
        })
    }

    /// Positive for A.
    fn log_odds(&self, values: &[Option<f64>]) -> f64 {
        let terms = self.coefficients.iter().zip(values).enumerate();
        self.intercept
            + terms
                .map(|(i, (weight, &value))| weight * self.standardized(i, value))
                .sum::<f64>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    /// Scenes with three features: the first is shifted by `shift` standard deviations of an even
    /// distribution in A.
    fn samples(count: usize, shift: f64) -> Vec<Sample> {
        let mut random = Pcg64Mcg::seed_from_u64(7);
        let mut even = || f64::from(random.next_u32()) / f64::from(u32::MAX) * 12f64.sqrt();
        let sample = |place: usize| {
            let is_a = place.is_multiple_of(3);
            let first = even() + if is_a { shift } else { 0.0 };
            let values = vec![
                Some(first),
                Some(even()),
                (!place.is_multiple_of(4)).then(&mut even),
            ];
            Sample {
                group: place.to_string(),
                values,
                is_a,
            }
        };
        (0..count).map(sample).collect()
    }

    #[test]
    fn equal_sets_are_told_apart_by_chance() {
        let found = cross_validated(&samples(300, 0.0)).unwrap();
        assert!(found.chance && (found.mean - 0.5).abs() < 0.1, "{found:?}");
    }

    #[test]
    fn a_shift_is_found_as_far_as_sets_overlap() {
        // Even distributions of width 3.46, apart by 1.73: the best threshold is right in three of
        // four cases.
        let found = cross_validated(&samples(600, 3f64.sqrt())).unwrap();
        assert!((found.mean - 0.75).abs() < 0.05, "{found:?}");
        assert!(found.low < found.mean && found.mean < found.high && !found.chance);
        let all = fitted(&samples(600, 3f64.sqrt()));
        assert!(all.coefficients[0] > 1.0, "{:?}", all.coefficients);
        assert!(
            all.coefficients[1].abs() < 0.3 && all.coefficients[2].abs() < 0.3,
            "{:?}",
            all.coefficients
        );
        let apart = cross_validated(&samples(300, 10.0)).unwrap();
        assert_eq!((apart.mean, apart.of_a, apart.of_b), (1.0, 1.0, 1.0));
    }

    #[test]
    fn groups_stay_in_one_fold_and_few_give_no_answer() {
        let mut list = samples(90, 1.0);
        for sample in &mut list {
            let number: usize = sample.group.parse().unwrap();
            sample.group = (number / 2).to_string();
        }
        let folds = folds(&list).unwrap();
        for (a, x) in list.iter().enumerate() {
            for (b, y) in list.iter().enumerate().filter(|(_, y)| y.is_a == x.is_a) {
                assert!(
                    x.group != y.group || folds[a] == folds[b],
                    "{} {}",
                    x.group,
                    y.group
                );
            }
        }
        assert_eq!(cross_validated(&samples(20, 1.0)), None);
    }
}
