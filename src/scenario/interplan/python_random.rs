//! Python's random numbers: the Mersenne Twister with CPython's seeding by texts and its derived
//! draws (CPython 3.11 `random.py`, `_randommodule.c`).

use sha2::{Digest, Sha512};
use std::f64::consts::TAU;

/// Words of the state, and the distance between two that are combined: n and m of MT19937.
const WORDS: usize = 624;
const SHIFT: usize = 397;

/// The generator that `random.seed(TEXT)` makes.
#[derive(Clone)]
pub(crate) struct PythonRandom {
    state: [u32; WORDS],
    next: usize,
    /// The second value of the last pair of normal draws.
    gauss: Option<f64>,
}

impl PythonRandom {
    /// `random.seed(text)`, version 2: the text and its SHA-512 as one large number.
    pub(crate) fn seeded(text: &str) -> Self {
        let mut bytes = text.as_bytes().to_vec();
        bytes.extend(Sha512::digest(text.as_bytes()));
        bytes.reverse();
        let mut key: Vec<u32> = bytes
            .chunks(4)
            .map(|word| {
                word.iter()
                    .rev()
                    .fold(0, |value, &byte| value << 8 | u32::from(byte))
            })
            .collect();
        while key.len() > 1 && key.last() == Some(&0) {
            key.pop();
        }
        Self::by_array(&key)
    }

    fn by_array(key: &[u32]) -> Self {
        let mut state = [0u32; WORDS];
        // The constants are those of `init_by_array` in Matsumoto and Nishimura's mt19937ar.c,
        // which CPython uses.
        state[0] = 19_650_218;
        for i in 1..WORDS {
            state[i] = 1_812_433_253u32
                .wrapping_mul(state[i - 1] ^ (state[i - 1] >> 30))
                .wrapping_add(i as u32);
        }
        let (mut i, mut j) = (1, 0);
        for _ in 0..WORDS.max(key.len()) {
            let mixed = (state[i - 1] ^ (state[i - 1] >> 30)).wrapping_mul(1_664_525);
            state[i] = (state[i] ^ mixed)
                .wrapping_add(key[j])
                .wrapping_add(j as u32);
            (i, j) = (i + 1, (j + 1) % key.len());
            if i >= WORDS {
                (state[0], i) = (state[WORDS - 1], 1);
            }
        }
        for _ in 0..WORDS - 1 {
            let mixed = (state[i - 1] ^ (state[i - 1] >> 30)).wrapping_mul(1_566_083_941);
            state[i] = (state[i] ^ mixed).wrapping_sub(i as u32);
            i += 1;
            if i >= WORDS {
                (state[0], i) = (state[WORDS - 1], 1);
            }
        }
        state[0] = 0x8000_0000;
        Self {
            state,
            next: WORDS,
            gauss: None,
        }
    }

    fn word(&mut self) -> u32 {
        if self.next >= WORDS {
            for i in 0..WORDS {
                let y = (self.state[i] & 0x8000_0000) | (self.state[(i + 1) % WORDS] & 0x7fff_ffff);
                let twist = if y & 1 == 0 { 0 } else { 0x9908_b0df };
                self.state[i] = self.state[(i + SHIFT) % WORDS] ^ (y >> 1) ^ twist;
            }
            self.next = 0;
        }
        let mut y = self.state[self.next];
        self.next += 1;
        y ^= y >> 11;
        y ^= (y << 7) & 0x9d2c_5680;
        y ^= (y << 15) & 0xefc6_0000;
        y ^ (y >> 18)
    }

    /// `getrandbits(bits)`, for 1 to 96 bits.
    pub(crate) fn bits(&mut self, bits: u32) -> u128 {
        let (mut value, mut left, mut at) = (0u128, bits, 0);
        while left > 0 {
            let word = if left < 32 {
                self.word() >> (32 - left)
            } else {
                self.word()
            };
            value |= u128::from(word) << at;
            (left, at) = (left.saturating_sub(32), at + 32);
        }
        value
    }

    /// `random()`: a number in [0, 1).
    pub(crate) fn unit(&mut self) -> f64 {
        let (a, b) = (self.word() >> 5, self.word() >> 6);
        (f64::from(a) * 67_108_864.0 + f64::from(b)) / 9_007_199_254_740_992.0
    }

    fn below(&mut self, count: u128) -> u128 {
        let bits = 128 - count.leading_zeros();
        loop {
            let value = self.bits(bits);
            if value < count {
                return value;
            }
        }
    }

    /// `randrange(low, high)`: `high` is excluded.
    pub(crate) fn range(&mut self, low: u64, high: u64) -> u64 {
        low + self.below(u128::from(high.saturating_sub(low).max(1))) as u64
    }

    /// `gauss(mean, deviation)`; the second value of a pair is kept for the next call.
    pub(crate) fn gauss(&mut self, mean: f64, deviation: f64) -> f64 {
        let z = self.gauss.take().unwrap_or_else(|| {
            let angle = self.unit() * TAU;
            let radius = (-2.0 * (1.0 - self.unit()).ln()).sqrt();
            self.gauss = Some(angle.sin() * radius);
            angle.cos() * radius
        });
        mean + z * deviation
    }

    /// `sample(range(count), count)`: a permutation.
    pub(crate) fn permutation(&mut self, count: usize) -> Vec<usize> {
        let mut pool: Vec<usize> = (0..count).collect();
        let draw = |i: usize| {
            let place = self.below((count - i) as u128) as usize;
            let taken = pool[place];
            pool[place] = pool[count - i - 1];
            taken
        };
        (0..count).map(draw).collect()
    }
}

impl std::fmt::Debug for PythonRandom {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("PythonRandom")
            .field("next", &self.next)
            .finish_non_exhaustive()
    }
}
