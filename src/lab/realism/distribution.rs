//! Distributions of the values of a feature, and the area in which scenes are measured.

use serde::Serialize;

/// Distance from the ego within which roads and agents count, meters. Recordings are complete that
/// far.
pub(super) const REACH: f64 = 50.0;

/// Distribution of a feature over the scenes of a set that have it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Distribution {
    pub scenes: usize,
    pub mean: f64,
    /// Standard deviation.
    pub deviation: f64,
    /// The 10th, 25th, 50th, 75th and 90th percentile.
    pub percentiles: [f64; 5],
}

pub(super) fn distribution(values: &[f64]) -> Option<Distribution> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let count = sorted.len() as f64;
    let last = sorted.len().checked_sub(1)?;
    let mean = sorted.iter().sum::<f64>() / count;
    let deviation = (sorted
        .iter()
        .map(|value| (value - mean).powi(2))
        .sum::<f64>()
        / count)
        .sqrt();
    let percentiles = [0.1, 0.25, 0.5, 0.75, 0.9].map(|share| {
        let place = share * last as f64;
        let low = sorted[place.floor() as usize];
        low + (sorted[place.ceil() as usize] - low) * place.fract()
    });
    Some(Distribution {
        scenes: sorted.len(),
        mean,
        deviation,
        percentiles,
    })
}

/// Mean of the values that exist.
pub(super) fn mean(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values
        .into_iter()
        .fold((0.0, 0_usize), |(sum, count), value| {
            (sum + value, count + 1)
        });
    (count > 0).then(|| sum / count as f64)
}

/// Standard deviation of at least two values.
pub(super) fn spread(values: &[f64]) -> Option<f64> {
    (values.len() >= 2)
        .then(|| distribution(values).map(|found| found.deviation))
        .flatten()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distributions_are_those_of_the_values() {
        let found = distribution(&[4.0, 0.0, 2.0]).unwrap();
        assert_eq!(
            (found.scenes, found.mean, found.percentiles[2]),
            (3, 2.0, 2.0)
        );
        assert!((found.deviation - (8.0f64 / 3.0).sqrt()).abs() < 1e-12);
        assert_eq!(distribution(&[]), None);
    }
}
