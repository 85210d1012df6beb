//! Seeded draws that do not depend on any library's sampling code.

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;

/// A stream of draws; the same seed gives the same stream everywhere.
#[derive(Debug, Clone)]
pub(crate) struct Dice {
    source: Pcg64,
}

impl Dice {
    /// The stream of `seed` for one purpose; streams of different purposes are unrelated.
    pub(crate) fn new(seed: u64, purpose: u64) -> Self {
        Self { source: Pcg64::seed_from_u64(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ purpose.rotate_left(48)) }
    }

    /// A number in [0, 1).
    pub(crate) fn unit(&mut self) -> f64 {
        const STEPS: f64 = (1u64 << 53) as f64;
        (self.source.next_u64() >> 11) as f64 / STEPS
    }

    /// A number in [low, high).
    pub(crate) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// A whole number in [low, high], both ends included.
    pub(crate) fn whole(&mut self, low: usize, high: usize) -> usize {
        low + (self.unit() * (high + 1 - low) as f64) as usize
    }

    /// True with the given probability.
    pub(crate) fn chance(&mut self, probability: f64) -> bool {
        self.unit() < probability
    }

    /// −1 or 1.
    pub(crate) fn sign(&mut self) -> f64 {
        if self.chance(0.5) { 1.0 } else { -1.0 }
    }

    /// One of several; the list must not be empty.
    pub(crate) fn pick<T: Copy>(&mut self, list: &[T]) -> T {
        list[self.whole(0, list.len() - 1)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn draws_stay_in_range_and_repeat() {
        let (mut a, mut b) = (Dice::new(7, 1), Dice::new(7, 1));
        for _ in 0..1000 {
            let x = a.between(2.0, 3.0);
            assert!((2.0..3.0).contains(&x) && x.to_bits() == b.between(2.0, 3.0).to_bits());
            let n = a.whole(1, 4);
            assert!((1..=4).contains(&n) && n == b.whole(1, 4));
        }
        assert_ne!(Dice::new(7, 1).unit().to_bits(), Dice::new(7, 2).unit().to_bits());
    }
}
