//! Random walks through the lane graph (`pgp_aggregator.py`).

use super::network::TRAVERSAL;
use rand::{Rng, RngExt};

/// Draws traversals of the lane graph by a policy.
#[derive(Debug, Clone, Copy)]
pub struct TraversalSampler<'a> {
    /// Probability of each edge of each node; the last is the goal.
    pub policy: &'a [Vec<f32>],
    /// Where each edge leads: a node, or the number of nodes and more for a goal, where a
    /// traversal stays.
    pub targets: &'a [Vec<f32>],
    /// Nodes where traversals begin, equally likely.
    pub initial: &'a [usize],
}

impl TraversalSampler<'_> {
    /// Draws traversals: the nodes of each, one a step.
    pub fn draw(&self, count: usize, random: &mut impl Rng) -> Vec<[u32; TRAVERSAL]> {
        (0..count).map(|_| self.one(random)).collect()
    }

    fn one(&self, random: &mut impl Rng) -> [u32; TRAVERSAL] {
        let first = match self.initial.len() {
            0 | 1 => self
                .initial
                .first()
                .copied()
                .expect("traversals begin at one node at least"),
            many => self
                .initial
                .get(random.random_range(0..many))
                .copied()
                .expect("the draw is below the count"),
        };
        let mut traversal = [first as u32; TRAVERSAL];
        for step in 1..TRAVERSAL {
            let node = traversal[step - 1];
            traversal[step] = match (
                self.policy.get(node as usize),
                self.targets.get(node as usize),
            ) {
                (Some(shares), Some(targets)) => targets
                    .get(chosen(shares, random.random::<f32>()))
                    .map_or(node, |&target| target as u32),
                _ => node,
            };
        }
        traversal
    }
}

/// The first place at which the sum of the shares exceeds a part of their whole.
fn chosen(shares: &[f32], part: f32) -> usize {
    let mut left = part * shares.iter().sum::<f32>();
    for (i, share) in shares.iter().enumerate() {
        if left < *share {
            return i;
        }
        left -= share;
    }
    shares
        .iter()
        .rposition(|&share| share > 0.0)
        .unwrap_or_default()
}

/// Normally distributed numbers (Box and Muller).
pub(super) fn normal(count: usize, random: &mut impl Rng) -> Vec<f32> {
    let draw = |_| {
        // 1 − u is never 0.
        let (u, v) = (1.0 - random.random::<f64>(), random.random::<f64>());
        ((-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()) as f32
    };
    (0..count).map(draw).collect()
}
