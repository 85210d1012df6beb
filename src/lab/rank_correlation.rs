//! How far two orderings of planners agree: Kendall's tau with a bootstrap interval over scenes.

use planagent_runs::worker::statistics::{Bootstrap, below, quantile};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use serde::Serialize;

/// Kendall's tau-b with its interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct RankCorrelation {
    pub tau: f64,
    pub low: f64,
    pub high: f64,
    /// Scenes that all planners have a score of.
    pub scenes: usize,
}

/// Tau-b of two lists of equal length: 1 for the same order, -1 for the opposite one. Pairs that
/// are equal in a list count in neither direction. `None` where all are equal in a list (Kendall,
/// *The treatment of ties in ranking problems*, 1945).
pub(crate) fn tau_b(a: &[f64], b: &[f64]) -> Option<f64> {
    let sign = |x: f64, y: f64| {
        if x > y {
            1.0
        } else {
            f64::from(-i8::from(x < y))
        }
    };
    let (mut agreed, mut of_a, mut of_b) = (0.0, 0.0, 0.0);
    for i in 0..a.len().min(b.len()) {
        for j in 0..i {
            let (x, y) = (sign(a[i], a[j]), sign(b[i], b[j]));
            agreed += x * y;
            of_a += x * x;
            of_b += y * y;
        }
    }
    let pairs: f64 = of_a * of_b;
    (pairs > 0.0).then(|| agreed / pairs.sqrt())
}

/// Tau-b of the mean scores of planners (one list of scores a planner, of the same scenes) and of
/// `other`, one value a planner. The interval is that of draws of scenes. `None` with fewer than
/// three planners or without a scene.
pub(crate) fn rank_correlation(
    bootstrap: &Bootstrap,
    scores: &[Vec<f64>],
    other: &[f64],
) -> Option<RankCorrelation> {
    let scenes = scores.iter().map(Vec::len).min()?;
    if scores.len() < 3 || scenes == 0 {
        return None;
    }
    let tau_of = |drawn: &[usize]| {
        // Sums rank as means do, since all planners have the same scenes.
        let mean = |own: &Vec<f64>| {
            drawn
                .iter()
                .filter_map(|&scene| own.get(scene))
                .sum::<f64>()
        };
        tau_b(&scores.iter().map(mean).collect::<Vec<f64>>(), other)
    };
    let tau = tau_of(&(0..scenes).collect::<Vec<usize>>())?;
    let mut random = Pcg64Mcg::seed_from_u64(bootstrap.seed);
    let mut drawn: Vec<f64> = (0..bootstrap.resamples)
        .filter_map(|_| {
            tau_of(
                &(0..scenes)
                    .map(|_| below(&mut random, scenes))
                    .collect::<Vec<usize>>(),
            )
        })
        .collect();
    drawn.sort_by(f64::total_cmp);
    let outside = (1.0 - bootstrap.level) / 2.0;
    Some(RankCorrelation {
        tau,
        low: quantile(&drawn, outside)?,
        high: quantile(&drawn, 1.0 - outside)?,
        scenes,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tau_counts_pairs_in_order() {
        let up = [1.0, 2.0, 3.0, 4.0];
        assert_eq!(tau_b(&up, &[10.0, 20.0, 30.0, 40.0]), Some(1.0));
        assert_eq!(tau_b(&up, &[4.0, 3.0, 2.0, 1.0]), Some(-1.0));
        // Five of six pairs agree.
        assert!((tau_b(&up, &[1.0, 2.0, 4.0, 3.0]).unwrap() - 4.0 / 6.0).abs() < 1e-12);
        // scipy.stats.kendalltau([1, 2, 3, 4], [1, 2, 2, 3]): 0.912871.
        assert!((tau_b(&up, &[1.0, 2.0, 2.0, 3.0]).unwrap() - 0.912_870_929).abs() < 1e-8);
        assert_eq!(tau_b(&up, &[1.0; 4]), None);
    }

    #[test]
    fn the_interval_says_how_sure_the_order_is() {
        let clear: Vec<Vec<f64>> = [0.2, 0.5, 0.9].map(|level| vec![level; 10]).to_vec();
        let found = rank_correlation(&Bootstrap::default(), &clear, &[1.0, 2.0, 3.0]).unwrap();
        assert_eq!(
            (found.tau, found.low, found.high, found.scenes),
            (1.0, 1.0, 1.0, 10)
        );
        // The second and third planner win half of the scenes each.
        let close: Vec<Vec<f64>> = vec![
            vec![0.0; 10],
            (0..10).map(|scene| f64::from(scene % 2)).collect(),
            (0..10)
                .map(|scene| 1.01 * f64::from((scene + 1) % 2))
                .collect(),
        ];
        let found = rank_correlation(&Bootstrap::default(), &close, &[1.0, 2.0, 3.0]).unwrap();
        assert!(
            found.tau > 0.999 && found.low < 0.5 && found.high > 0.999,
            "{found:?}"
        );
        assert_eq!(
            rank_correlation(&Bootstrap::default(), &clear[..2], &[1.0, 2.0]),
            None
        );
    }
}
