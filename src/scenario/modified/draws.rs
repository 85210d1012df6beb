//! The random draws of a modified scene.

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;

/// A stream of draws; the same scenario, modification and seed give the same stream everywhere.
#[derive(Debug, Clone)]
pub(super) struct Draws {
    source: Pcg64,
    seed: u64,
}

impl Draws {
    /// The stream of a scenario under a modification.
    pub(super) fn new(scenario: &str, modification: &str, seeds: [u64; 2]) -> Self {
        let mut hasher = blake3::Hasher::new();
        for text in [scenario, modification] {
            hasher.update(text.as_bytes()).update(b"\n");
        }
        for seed in seeds {
            hasher.update(&seed.to_le_bytes());
        }
        let digest = hasher.finalize();
        let seed = digest
            .as_bytes()
            .iter()
            .take(8)
            .fold(0, |seed, &byte| seed << 8 | u64::from(byte));
        Self {
            source: Pcg64::seed_from_u64(seed),
            seed,
        }
    }

    /// The seed of the stream.
    pub(super) fn seed(&self) -> u64 {
        self.seed
    }

    /// A number in [0, 1).
    fn unit(&mut self) -> f64 {
        /// Numbers in [0, 1) that the 53 bits of an f64 tell apart.
        const STEPS: f64 = (1u64 << 53) as f64;
        (self.source.next_u64() >> 11) as f64 / STEPS
    }

    /// A number in [low, high).
    pub(super) fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// A whole number from `low` to `high`, both included.
    pub(super) fn whole(&mut self, low: i32, high: i32) -> i32 {
        low + (self.unit() * f64::from(high - low + 1)) as i32
    }

    /// A number of a normal distribution (Box and Muller).
    pub(super) fn normal(&mut self, mean: f64, deviation: f64) -> f64 {
        let radius = (-2.0 * (1.0 - self.unit()).ln()).sqrt();
        mean + deviation * radius * (std::f64::consts::TAU * self.unit()).cos()
    }
}
