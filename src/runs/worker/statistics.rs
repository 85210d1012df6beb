//! Paired differences between two planners on the same scenes, with bootstrap intervals.

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde::Serialize;

/// Settings of the percentile bootstrap over scenes (Efron and Tibshirani, *An Introduction to the
/// Bootstrap*, section 13.3).
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Bootstrap {
    /// Number of resamples, with replacement.
    pub resamples: usize,
    /// Share of the means within the interval.
    pub level: f64,
    pub seed: u64,
}

impl Default for Bootstrap {
    fn default() -> Self {
        Self {
            resamples: 10_000,
            level: 0.95,
            seed: 0,
        }
    }
}

/// Wilson's 95 % interval of the share of successes among trials. The whole range without trials.
pub fn wilson(successes: usize, trials: usize) -> [f64; 2] {
    /// Of the normal distribution, 95 % within.
    const Z: f64 = 1.959_963_984_540_054;
    if trials == 0 {
        return [0.0, 1.0];
    }
    let (n, share) = (trials as f64, successes as f64 / trials as f64);
    let middle = share + Z * Z / (2.0 * n);
    let half = Z * (share * (1.0 - share) / n + Z * Z / (4.0 * n * n)).sqrt();
    [middle - half, middle + half].map(|bound| (bound / (1.0 + Z * Z / n)).clamp(0.0, 1.0))
}

/// Mean of paired differences with its interval, in the unit of the differences.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PairedDifference {
    pub mean: f64,
    pub low: f64,
    pub high: f64,
    pub pairs: usize,
    /// Clusters that were drawn; of several sets, those of the largest.
    #[serde(skip)]
    pub clusters: usize,
}

impl PairedDifference {
    /// Both ends in words. A single cluster has no spread, so its interval is a dash.
    pub fn interval(&self, number: impl Fn(f64) -> String) -> String {
        if self.clusters > 1 {
            format!("{} to {}", number(self.low), number(self.high))
        } else {
            "-".to_owned()
        }
    }
}

impl Bootstrap {
    /// The mean of differences, one a scene, with its interval; `None` without a scene. Equal
    /// differences in equal order give the same interval on every machine.
    pub fn difference(&self, differences: &[f64]) -> Option<PairedDifference> {
        let single: Vec<&[f64]> = differences.chunks(1).collect();
        self.clustered(&single)
    }

    /// As [`Self::difference`] for clusters of differences that are drawn together: scenes of one
    /// recording are alike. All differences count equally in the mean.
    pub fn clustered(&self, clusters: &[impl AsRef<[f64]>]) -> Option<PairedDifference> {
        let sums: Vec<(f64, usize)> = clusters
            .iter()
            .map(|cluster| (cluster.as_ref().iter().sum(), cluster.as_ref().len()))
            .filter(|&(_, count)| count > 0)
            .collect();
        let pairs: usize = sums.iter().map(|(_, count)| count).sum();
        if pairs == 0 {
            return None;
        }
        let mut random = Pcg64Mcg::seed_from_u64(self.seed);
        let mut mean_of_draws = || {
            let drawn = (0..sums.len()).filter_map(|_| sums.get(below(&mut random, sums.len())));
            let (sum, count) = drawn.fold((0.0, 0), |(sum, count), &(own, size)| {
                (sum + own, count + size)
            });
            sum / count as f64
        };
        let mut means: Vec<f64> = (0..self.resamples).map(|_| mean_of_draws()).collect();
        means.sort_by(f64::total_cmp);
        let outside = (1.0 - self.level) / 2.0;
        Some(PairedDifference {
            mean: sums.iter().map(|(sum, _)| sum).sum::<f64>() / pairs as f64,
            low: quantile(&means, outside)?,
            high: quantile(&means, 1.0 - outside)?,
            pairs,
            clusters: sums.len(),
        })
    }
}

impl Bootstrap {
    /// The mean of the means of several sets of clusters, each drawn for itself: every set counts
    /// equally, whatever its size.
    pub fn balanced(&self, sets: &[Vec<Vec<f64>>]) -> Option<PairedDifference> {
        let mut random = Pcg64Mcg::seed_from_u64(self.seed);
        let mean = |clusters: &mut dyn Iterator<Item = &Vec<f64>>| {
            let (sum, count) = clusters.fold((0.0, 0_usize), |(sum, count), own| {
                (sum + own.iter().sum::<f64>(), count + own.len())
            });
            (count > 0).then(|| sum / count as f64)
        };
        let own: Option<Vec<f64>> = sets.iter().map(|set| mean(&mut set.iter())).collect();
        let own = own.filter(|means| !means.is_empty())?;
        let mut means = Vec::with_capacity(self.resamples);
        for _ in 0..self.resamples {
            // A draw from all clusters would give the larger set more weight.
            let drawn = sets.iter().map(|set| {
                let places: Vec<usize> = (0..set.len())
                    .map(|_| below(&mut random, set.len()))
                    .collect();
                mean(&mut places.iter().filter_map(|&place| set.get(place)))
            });
            let drawn: Option<Vec<f64>> = drawn.collect();
            means.push(drawn?.iter().sum::<f64>() / sets.len() as f64);
        }
        means.sort_by(f64::total_cmp);
        let outside = (1.0 - self.level) / 2.0;
        Some(PairedDifference {
            mean: own.iter().sum::<f64>() / own.len() as f64,
            low: quantile(&means, outside)?,
            high: quantile(&means, 1.0 - outside)?,
            pairs: sets.iter().flatten().map(Vec::len).sum(),
            clusters: sets.iter().map(Vec::len).max()?,
        })
    }
}

/// A number below `end`, by multiplication with a fraction of 32 bits. The sampling code of a
/// library may change.
pub fn below(random: &mut Pcg64Mcg, end: usize) -> usize {
    ((u64::from(random.next_u32()) * end as u64) >> 32) as usize
}

/// Linear between the two nearest of sorted values.
pub fn quantile(sorted: &[f64], share: f64) -> Option<f64> {
    let place = share * (sorted.len().checked_sub(1)?) as f64;
    let (below, within) = (place.floor() as usize, place.fract());
    let low = *sorted.get(below)?;
    let high = sorted.get(below + 1).copied().unwrap_or(low);
    Some(low + (high - low) * within)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn interval(differences: &[f64]) -> PairedDifference {
        Bootstrap::default().difference(differences).unwrap()
    }

    #[test]
    fn resampled_means_of_zeros_and_ones_are_binomial() {
        // Of 100 draws with probability 1/2, the binomial's 2.5 % and 97.5 % quantiles are 40 and
        // 60.
        let halves: Vec<f64> = (0..100).map(|i| f64::from(i % 2)).collect();
        let found = interval(&halves);
        assert_eq!(
            (found.mean, found.low, found.high, found.pairs),
            (0.5, 0.40, 0.60, 100)
        );
        // Of 10 with probability 0.3: 0 and 6 (distribution function 0.028 at 0, 0.953 at 5, 0.989
        // at 6).
        let few: Vec<f64> = (0..10).map(|i| f64::from(u8::from(i < 3))).collect();
        let found = interval(&few);
        assert_eq!((found.low, found.high), (0.0, 0.6));
    }

    #[test]
    fn the_normal_interval_is_met_by_many_scenes() {
        // Evenly spread over [0, 1]: mean 1/2, standard error sqrt(1/12/n).
        let n = 1000;
        let even: Vec<f64> = (0..n)
            .map(|i| (f64::from(i) + 0.5) / f64::from(n))
            .collect();
        let found = interval(&even);
        let half = 1.96 * (1.0 / 12.0 / f64::from(n)).sqrt();
        assert!(
            (found.low - (0.5 - half)).abs() < 0.05 * half,
            "{found:?}, half {half}"
        );
        assert!(
            (found.high - (0.5 + half)).abs() < 0.05 * half,
            "{found:?}, half {half}"
        );
    }

    #[test]
    fn one_value_leaves_no_doubt_and_none_gives_no_interval() {
        let same = interval(&[-2.5; 7]);
        assert_eq!((same.mean, same.low, same.high), (-2.5, -2.5, -2.5));
        assert_eq!(Bootstrap::default().difference(&[]), None);
        assert_eq!(
            interval(&[0.0, 1.0, 5.0]),
            interval(&[0.0, 1.0, 5.0]),
            "the same draws every time"
        );
        let other = Bootstrap {
            seed: 1,
            resamples: 20,
            ..Bootstrap::default()
        };
        assert_ne!(
            other.difference(&[0.0, 1.0, 5.0]),
            Some(interval(&[0.0, 1.0, 5.0]))
        );
    }

    #[test]
    fn one_cluster_has_no_interval_in_words() {
        let words = |clusters: &[&[f64]]| {
            let found = Bootstrap::default().clustered(clusters).unwrap();
            found.interval(|end| end.to_string())
        };
        assert_eq!(words(&[&[2.0]]), "-");
        assert_eq!(words(&[&[1.0, 2.0]]), "-");
        assert_eq!(words(&[&[2.0], &[2.0]]), "2 to 2");
    }

    #[test]
    fn clusters_are_drawn_as_a_whole() {
        // Two clusters of equal differences: a draw of two gives 0, 1/2 or 1, the extremes with
        // probability 1/4 each.
        let found = Bootstrap::default()
            .clustered(&[vec![0.0; 50], vec![1.0; 50]])
            .unwrap();
        assert_eq!(
            (found.mean, found.low, found.high, found.pairs),
            (0.5, 0.0, 1.0, 100)
        );
        let alone = interval(&[vec![0.0; 50], vec![1.0; 50]].concat());
        assert!(alone.low > 0.35 && alone.high < 0.65, "{alone:?}");
        // Differences count equally, however large their cluster is.
        let uneven = Bootstrap::default()
            .clustered(&[vec![1.0], vec![], vec![0.0, 0.0, 0.0]])
            .unwrap();
        assert_eq!((uneven.mean, uneven.pairs), (0.25, 4));
        assert_eq!(
            Bootstrap::default().clustered(&[Vec::new(), Vec::new()]),
            None
        );
    }

    #[test]
    fn sets_of_unequal_size_count_equally() {
        let sets = [vec![vec![1.0]; 9], vec![vec![0.0]; 3]];
        let found = Bootstrap::default().balanced(&sets).unwrap();
        assert_eq!(
            (found.mean, found.low, found.high, found.pairs),
            (0.5, 0.5, 0.5, 12)
        );
        // Each set alone is binomial; the second adds nothing.
        let mixed: Vec<Vec<f64>> = (0..100).map(|i| vec![f64::from(i % 2)]).collect();
        let found = Bootstrap::default()
            .balanced(&[mixed, vec![vec![1.0]; 5]])
            .unwrap();
        assert_eq!((found.mean, found.low, found.high), (0.75, 0.70, 0.80));
        assert_eq!(
            Bootstrap::default().balanced(&[vec![vec![1.0]], vec![]]),
            None
        );
    }

    #[test]
    fn quantiles_lie_between_neighbours() {
        let sorted = [1.0, 2.0, 4.0];
        let found = [0.0, 0.25, 0.75, 1.0].map(|share| quantile(&sorted, share).unwrap());
        assert!(
            found
                .iter()
                .zip([1.0, 1.5, 3.0, 4.0])
                .all(|(found, wanted)| (found - wanted).abs() < 1e-12),
            "{found:?}"
        );
        assert_eq!(quantile(&[], 0.5), None);
    }
}
