//! Seeded draws that do not depend on any library's sampling code.

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;

/// A stream of draws; the same seed gives the same stream everywhere.
///
/// Draws are of two sorts. Those of the *situation* say what a drive is about; all others are *luck*. Dice that are dealt
/// [among other traffic](Self::among_other_traffic) repeat the situation and have luck of their own.
#[derive(Debug, Clone)]
pub(crate) struct SeededRng {
    source: Pcg64,
    situation: Situation,
}

/// The draws of the situation: the stream as it was before each.
#[derive(Debug, Clone)]
enum Situation {
    /// They are made and noted.
    Noted(Vec<Pcg64>),
    /// They are those that were noted; so many have been asked for.
    Repeated(Vec<Pcg64>, usize),
}

/// A draw of luck that was made early, together with the situation: what it gave, and its bounds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct EarlyDraw {
    drawn: f64,
    bounds: [f64; 2],
}

impl SeededRng {
    /// The stream of `seed` for one purpose; streams of different purposes are unrelated.
    pub(crate) fn new(seed: u64, purpose: u64) -> Self {
        let source = Pcg64::seed_from_u64(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ purpose.rotate_left(48));
        Self { source, situation: Situation::Noted(Vec::new()) }
    }

    /// Dice with the luck of `self` and the situation that `drawn` have noted.
    pub(crate) fn among_other_traffic(self, drawn: &Self) -> Self {
        let (Situation::Noted(noted) | Situation::Repeated(noted, _)) = &drawn.situation;
        Self { source: self.source, situation: Situation::Repeated(noted.clone(), 0) }
    }

    /// A draw of the situation.
    pub(crate) fn situation<T>(&mut self, draw: impl FnOnce(&mut Self) -> T) -> T {
        let then = match &mut self.situation {
            Situation::Noted(noted) => {
                noted.push(self.source.clone());
                None
            }
            Situation::Repeated(noted, asked) => {
                *asked += 1;
                noted.get(*asked - 1).cloned()
            }
        };
        match then {
            None => draw(self),
            Some(source) => draw(&mut Self { source, situation: Situation::Noted(Vec::new()) }),
        }
    }

    /// Whether the situation came about as it was noted: not one draw of it more or less.
    pub(crate) fn kept_situation(&self) -> bool {
        match &self.situation {
            Situation::Noted(_) => true,
            Situation::Repeated(noted, asked) => noted.len() == *asked,
        }
    }

    /// Luck that is drawn early, in [low, high).
    pub(crate) fn early_draw(&mut self, low: f64, high: f64) -> EarlyDraw {
        EarlyDraw { drawn: self.uniform(low, high), bounds: [low, high] }
    }

    /// What an early draw gave; drawn anew among other traffic.
    pub(crate) fn value_of(&mut self, early: EarlyDraw) -> f64 {
        match self.situation {
            Situation::Noted(_) => early.drawn,
            Situation::Repeated(..) => self.uniform(early.bounds[0], early.bounds[1]),
        }
    }

    /// A number in [0, 1).
    pub(crate) fn unit(&mut self) -> f64 {
        const STEPS: f64 = (1u64 << 53) as f64;
        (self.next_u64() >> 11) as f64 / STEPS
    }

    /// Any whole number of 64 bits.
    pub(crate) fn next_u64(&mut self) -> u64 {
        self.source.next_u64()
    }

    /// A number in [low, high).
    pub(crate) fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// A whole number in [low, high], both ends included.
    pub(crate) fn range(&mut self, low: usize, high: usize) -> usize {
        low + (self.unit() * (high + 1 - low) as f64) as usize
    }

    /// True with the given probability.
    pub(crate) fn bool(&mut self, probability: f64) -> bool {
        self.unit() < probability
    }

    /// −1 or 1.
    pub(crate) fn sign(&mut self) -> f64 {
        if self.bool(0.5) { 1.0 } else { -1.0 }
    }

    /// One of several; the list must not be empty.
    pub(crate) fn choose<T: Copy>(&mut self, list: &[T]) -> T {
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
        assert_ne!(SeededRng::new(7, 1).unit().to_bits(), SeededRng::new(7, 2).unit().to_bits());
    }

    #[test]
    fn other_traffic_repeats_the_situation_alone() {
        let deal = |rng: &mut SeededRng| {
            let (luck, situation) = (rng.unit(), rng.situation(SeededRng::unit));
            let early = rng.situation(|rng| rng.early_draw(3.0, 4.0));
            [luck, situation, rng.value_of(early)].map(f64::to_bits)
        };
        let mut first = SeededRng::new(7, 1);
        let mut plain = first.clone();
        let own = deal(&mut first);
        assert_eq!(own, [plain.unit(), plain.unit(), plain.uniform(3.0, 4.0)].map(f64::to_bits));
        let mut other = SeededRng::new(8, 1).among_other_traffic(&first);
        assert!(!other.kept_situation());
        let other_draws = deal(&mut other);
        assert!(other_draws[0] != own[0] && other_draws[1] == own[1] && other_draws[2] != own[2]);
        assert!((3.0..4.0).contains(&f64::from_bits(other_draws[2])) && other.kept_situation());
        other.situation(SeededRng::unit);
        assert!(!other.kept_situation());
    }
}
