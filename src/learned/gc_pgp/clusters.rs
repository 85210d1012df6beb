//! Clusters of trajectories and their ranks (`pgp/utils.py`; scikit-learn's `KMeans`).

use rand::{Rng, RngExt};

/// Maximum number of rounds of the search.
const ROUNDS: usize = 100;
/// The search ends when the centers move by less than this share of the mean variance.
const TOLERANCE: f64 = 1e-4;

/// A partition of rows.
#[derive(Debug, Clone, PartialEq)]
pub struct Clusters {
    /// The cluster of each row.
    pub labels: Vec<usize>,
    /// The mean of each cluster's rows.
    pub centers: Vec<Vec<f64>>,
}

impl Clusters {
    /// Partitions rows into `count` clusters from centers that are random rows.
    pub fn from_rows(rows: &[Vec<f64>], count: usize, random: &mut impl Rng) -> Self {
        let mut places: Vec<usize> = (0..rows.len()).collect();
        let count = count.min(rows.len());
        for place in 0..count {
            let other = random.random_range(place..places.len());
            places.swap(place, other);
        }
        Self::from(
            rows,
            places
                .iter()
                .take(count)
                .map(|&place| rows[place].clone())
                .collect(),
        )
    }

    /// Partitions rows from these centers on (Lloyd's rounds).
    pub fn from(rows: &[Vec<f64>], mut centers: Vec<Vec<f64>>) -> Self {
        let tolerance = TOLERANCE * mean_variance(rows);
        let mut labels = assigned(rows, &centers);
        for _ in 0..ROUNDS {
            let next = means(rows, &labels, &centers);
            let moved: f64 = next.iter().zip(&centers).map(|(a, b)| squared(a, b)).sum();
            centers = next;
            let after = assigned(rows, &centers);
            let stable = after == labels;
            labels = after;
            if stable || moved <= tolerance {
                break;
            }
        }
        Self { labels, centers }
    }

    /// The number of rows in each cluster.
    pub fn counts(&self) -> Vec<usize> {
        let mut counts = vec![0; self.centers.len()];
        self.labels.iter().for_each(|&label| counts[label] += 1);
        counts
    }
}

fn squared(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum()
}

fn mean_variance(rows: &[Vec<f64>]) -> f64 {
    let Some(width) = rows.first().map(Vec::len).filter(|&width| width > 0) else {
        return 0.0;
    };
    let count = rows.len() as f64;
    let variance = |column: usize| {
        let mean = rows.iter().map(|row| row[column]).sum::<f64>() / count;
        rows.iter()
            .map(|row| (row[column] - mean).powi(2))
            .sum::<f64>()
            / count
    };
    (0..width).map(variance).sum::<f64>() / width as f64
}

/// The nearest center of each row.
fn assigned(rows: &[Vec<f64>], centers: &[Vec<f64>]) -> Vec<usize> {
    let nearest = |row: &Vec<f64>| {
        let distances = centers
            .iter()
            .map(|center| squared(row, center))
            .enumerate();
        distances
            .min_by(|a, b| a.1.total_cmp(&b.1))
            .expect("a partition has one center at least")
            .0
    };
    rows.iter().map(nearest).collect()
}

/// The mean of each cluster; an empty one moves to a row far from its center, as in scikit-learn.
fn means(rows: &[Vec<f64>], labels: &[usize], centers: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let width = rows.first().map_or(0, Vec::len);
    let mut sums = vec![(vec![0.0; width], 0usize); centers.len()];
    for (row, &label) in rows.iter().zip(labels) {
        let (sum, count) = &mut sums[label];
        sum.iter_mut()
            .zip(row)
            .for_each(|(sum, value)| *sum += value);
        *count += 1;
    }
    let mut far: Vec<usize> = (0..rows.len()).collect();
    far.sort_by(|&a, &b| {
        let distance = |i: usize| squared(&rows[i], &centers[labels[i]]);
        distance(a).total_cmp(&distance(b))
    });
    let empty: Vec<usize> = (0..sums.len())
        .filter(|&cluster| sums[cluster].1 == 0)
        .collect();
    // The row that moves also leaves the mean of the cluster that it was in.
    for cluster in empty {
        let Some(row) = far.pop() else { break };
        let (sum, count) = &mut sums[labels[row]];
        sum.iter_mut()
            .zip(&rows[row])
            .for_each(|(sum, value)| *sum -= value);
        *count -= 1;
        sums[cluster] = (rows[row].clone(), 1);
    }
    let mean = |((sum, count), center): (&(Vec<f64>, usize), &Vec<f64>)| match count {
        0 => center.clone(),
        &count => sum.iter().map(|sum| sum / count as f64).collect(),
    };
    sums.iter().zip(centers).map(mean).collect()
}

/// The rank of each cluster, 1 for the best. The two nearest by Ward's criterion are joined
/// repeatedly, and the smaller one gets the last free rank.
pub fn ranks(counts: &[usize], centers: &[Vec<f64>]) -> Vec<usize> {
    let mut left: Vec<(usize, f64, Vec<f64>)> = counts
        .iter()
        .zip(centers)
        .enumerate()
        .map(|(i, (&count, center))| (i, count as f64, center.clone()))
        .collect();
    let mut ranks = vec![1; left.len()];
    for rank in (2..=left.len()).rev() {
        let mut nearest = (f64::INFINITY, 0, 1);
        for a in 0..left.len() {
            // Both orders of a pair, as upstream: the order decides which of two equal clusters is
            // joined into the other.
            for b in (0..left.len()).filter(|&b| b != a) {
                let (n, m) = (left[a].1, left[b].1);
                let distance = n * m / (n + m) * squared(&left[a].2, &left[b].2).sqrt();
                if distance < nearest.0 {
                    nearest = (distance, a, b);
                }
            }
        }
        let (_, a, b) = nearest;
        let (small, large) = if left[a].1 <= left[b].1 {
            (a, b)
        } else {
            (b, a)
        };
        let (cluster, count, center) = left[small].clone();
        ranks[cluster] = rank;
        let (_, into, mean) = &mut left[large];
        mean.iter_mut()
            .zip(&center)
            .for_each(|(mean, value)| *mean = (*into * *mean + count * value) / (*into + count));
        *into += count;
        left.remove(small);
    }
    ranks
}

/// The scores of ranks: their reciprocals, divided by the sum.
pub fn scores(ranks: &[usize]) -> Vec<f64> {
    let sum: f64 = ranks.iter().map(|&rank| 1.0 / rank as f64).sum();
    ranks.iter().map(|&rank| 1.0 / rank as f64 / sum).collect()
}
