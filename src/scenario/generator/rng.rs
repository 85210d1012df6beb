//! Seeded random numbers that do not depend on a library's sampling code.

use super::ranges::Ranges;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;

/// A stream of random draws; the same seed gives the same stream everywhere.
///
/// Some draws determine the *situation*: what the scenario is about. With a traffic seed, the
/// situation of the seed [is repeated](Self::with_situation_of) and all other draws change.
#[derive(Debug, Clone)]
pub struct SeededRng {
    source: Pcg64,
    situation: Situation,
    ranges: Ranges,
}

/// The state of the stream before each draw of the situation.
#[derive(Debug, Clone)]
enum Situation {
    Recorded(Vec<Pcg64>),
    /// With the number of draws so far.
    Repeated(Vec<Pcg64>, usize),
}

/// A draw that is made with the situation but does not belong to it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct EarlyDraw {
    value: f64,
    bounds: [f64; 2],
}

impl SeededRng {
    /// The stream of `seed` for one purpose; streams of different purposes are unrelated.
    pub(crate) fn new(seed: u64, purpose: u64) -> Self {
        let source = Pcg64::seed_from_u64(
            seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ purpose.rotate_left(48),
        );
        Self {
            source,
            situation: Situation::Recorded(Vec::new()),
            ranges: Ranges::First,
        }
    }

    /// This stream for draws from these ranges.
    pub(crate) fn drawn_from(self, ranges: Ranges) -> Self {
        Self { ranges, ..self }
    }

    /// True if ranges are the wider ones, also if they are still wider.
    pub(crate) fn is_wide(&self) -> bool {
        self.ranges != Ranges::First
    }

    /// True if ranges are the still wider ones.
    pub(crate) fn is_wider(&self) -> bool {
        self.ranges == Ranges::Wider
    }

    /// This stream, with the situation that `drawn` recorded.
    pub(crate) fn with_situation_of(self, drawn: &Self) -> Self {
        let (Situation::Recorded(recorded) | Situation::Repeated(recorded, _)) = &drawn.situation;
        Self {
            situation: Situation::Repeated(recorded.clone(), 0),
            ..self
        }
    }

    /// A draw of the situation.
    pub(crate) fn situation<T>(&mut self, draw: impl FnOnce(&mut Self) -> T) -> T {
        let then = match &mut self.situation {
            Situation::Recorded(recorded) => {
                recorded.push(self.source.clone());
                None
            }
            Situation::Repeated(recorded, used) => {
                *used += 1;
                recorded.get(*used - 1).cloned()
            }
        };
        match then {
            None => draw(self),
            Some(source) => draw(&mut Self {
                source,
                situation: Situation::Recorded(Vec::new()),
                ranges: self.ranges,
            }),
        }
    }

    /// True if exactly the recorded draws of the situation were repeated.
    pub(crate) fn kept_situation(&self) -> bool {
        match &self.situation {
            Situation::Recorded(_) => true,
            Situation::Repeated(recorded, used) => recorded.len() == *used,
        }
    }

    /// A draw in [low, high) that is used later by [`Self::value_of`].
    pub(crate) fn early_draw(&mut self, low: f64, high: f64) -> EarlyDraw {
        EarlyDraw {
            value: self.uniform(low, high),
            bounds: [low, high],
        }
    }

    /// The value of an early draw; with a traffic seed, a new one.
    pub(crate) fn value_of(&mut self, early: EarlyDraw) -> f64 {
        match self.situation {
            Situation::Recorded(_) => early.value,
            Situation::Repeated(..) => self.uniform(early.bounds[0], early.bounds[1]),
        }
    }

    /// A number in [0, 1).
    pub fn unit(&mut self) -> f64 {
        /// Numbers in [0, 1) that the 53 bits of an f64 tell apart.
        const STEPS: f64 = (1u64 << 53) as f64;
        (self.next_u64() >> 11) as f64 / STEPS
    }

    pub(crate) fn next_u64(&mut self) -> u64 {
        self.source.next_u64()
    }

    /// A number in [low, high).
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// An integer from `low` to `high`, both included.
    pub fn range(&mut self, low: usize, high: usize) -> usize {
        low + (self.unit() * (high + 1 - low) as f64) as usize
    }

    /// True with this probability.
    pub fn bool(&mut self, probability: f64) -> bool {
        self.unit() < probability
    }

    /// −1 or 1.
    pub fn sign(&mut self) -> f64 {
        if self.bool(0.5) { 1.0 } else { -1.0 }
    }

    /// An element of a list, which must not be empty.
    pub fn choose<T: Copy>(&mut self, list: &[T]) -> T {
        list[self.range(0, list.len() - 1)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn draws_stay_in_range_and_repeat() {
        let (mut a, mut b) = (SeededRng::new(7, 1), SeededRng::new(7, 1));
        for _ in 0..1000 {
            let x = a.uniform(2.0, 3.0);
            assert!((2.0..3.0).contains(&x) && x.to_bits() == b.uniform(2.0, 3.0).to_bits());
            let n = a.range(1, 4);
            assert!((1..=4).contains(&n) && n == b.range(1, 4));
        }
        assert_ne!(
            SeededRng::new(7, 1).unit().to_bits(),
            SeededRng::new(7, 2).unit().to_bits()
        );
    }

    #[test]
    fn a_repeated_situation_leaves_the_other_draws_free() {
        let deal = |rng: &mut SeededRng| {
            let (luck, situation) = (rng.unit(), rng.situation(SeededRng::unit));
            let early = rng.situation(|rng| rng.early_draw(3.0, 4.0));
            [luck, situation, rng.value_of(early)].map(f64::to_bits)
        };
        let mut first = SeededRng::new(7, 1);
        let mut plain = first.clone();
        let own = deal(&mut first);
        assert_eq!(
            own,
            [plain.unit(), plain.unit(), plain.uniform(3.0, 4.0)].map(f64::to_bits)
        );
        let mut other = SeededRng::new(8, 1).with_situation_of(&first);
        assert!(!other.kept_situation());
        let other_draws = deal(&mut other);
        assert!(other_draws[0] != own[0] && other_draws[1] == own[1] && other_draws[2] != own[2]);
        assert!((3.0..4.0).contains(&f64::from_bits(other_draws[2])) && other.kept_situation());
        other.situation(SeededRng::unit);
        assert!(!other.kept_situation());
    }
}
