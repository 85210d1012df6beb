//! The gated delta rule (Yang et al., arXiv:2412.06464), token by token: the state of a head is a
//! matrix that forgets, and learns what it does not predict.
#![allow(
    clippy::inline_always,
    reason = "kernels must be inlined into the functions that enable the instructions"
)]

use super::matrix::{Instructions, Kernel, LANES, Simd};
use super::pointwise::{exp_or_zero, sigmoid};
use rayon::prelude::*;

/// Added to the sum of squares of a query or key (`l2norm` in transformers).
const EPS: f32 = 1e-6;
/// Least multiplications for which other threads are worth waking.
const MIN_PARALLEL_PRODUCTS: usize = 1 << 20;

/// Tokens that a thread prepares at once.
const TASK_TOKENS: usize = 8;

/// The heads of a layer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DeltaHeads {
    /// Heads of queries and keys.
    pub keys: usize,
    /// Heads of values, a multiple of those of keys.
    pub values: usize,
    /// Numbers of a query or key.
    pub key_width: usize,
    /// Numbers of a value.
    pub value_width: usize,
    /// Whether the values of a key's heads lie apart, so that value head h has key head h mod
    /// (key heads). Otherwise they follow one another.
    pub tiled: bool,
}

impl DeltaHeads {
    /// Numbers of a token's queries, keys and values.
    pub fn channels(self) -> usize {
        2 * self.keys * self.key_width + self.values * self.value_width
    }

    fn key_of(self, value: usize) -> usize {
        if self.tiled {
            value % self.keys
        } else {
            value / (self.values / self.keys)
        }
    }
}

/// The rule of a layer.
#[derive(Debug)]
pub struct GatedDeltaRule {
    heads: DeltaHeads,
    /// For each value head: how fast its state is forgotten.
    decay: Vec<f32>,
    /// For each value head: added to what a token says of forgetting.
    bias: Vec<f32>,
}

impl GatedDeltaRule {
    /// Of heads, and a positive `decay` and a `bias` for each value head.
    pub fn new(heads: DeltaHeads, decay: Vec<f32>, bias: Vec<f32>) -> Self {
        Self { heads, decay, bias }
    }

    /// The heads.
    pub fn heads(&self) -> DeltaHeads {
        self.heads
    }

    /// Numbers of the state: (value heads, key width, value width).
    pub fn state(&self) -> usize {
        self.heads.values * self.heads.key_width * self.heads.value_width
    }

    /// Numbers of a token: queries, keys and values before their activation (SiLU), then for each
    /// value head how much of the token is learned, then how much is forgotten.
    pub fn row(&self) -> usize {
        self.heads.channels() + 2 * self.heads.values
    }

    /// Numbers that a token gives: (value heads, value width).
    pub fn out(&self) -> usize {
        self.heads.values * self.heads.value_width
    }

    /// Runs tokens through a state, in order. `rows` is overwritten. The bits are the same however
    /// the tokens are split, and at any thread count.
    pub fn run(&self, state: &mut [f32], rows: &mut [f32], out: &mut [f32]) {
        let DeltaHeads {
            key_width,
            value_width,
            ..
        } = self.heads;
        let tokens = rows.len() / self.row();
        let parallel = 4 * tokens * self.state() >= MIN_PARALLEL_PRODUCTS;
        let prepare = |rows: &mut [f32]| Instructions::best().run(Prepare { rule: self, rows });
        if parallel && tokens > TASK_TOKENS {
            let pieces = rows.par_chunks_mut(TASK_TOKENS * self.row());
            pieces.for_each(prepare);
        } else {
            prepare(rows);
        }
        let rows = &*rows;
        let one = |(value, state): (usize, &mut [f32])| {
            let mut found = vec![0.0; tokens * value_width];
            Instructions::best().run(Head {
                rule: self,
                value,
                state,
                rows,
                out: &mut found,
            });
            found
        };
        let width = key_width * value_width;
        let found: Vec<Vec<f32>> = if parallel {
            let heads = state.par_chunks_exact_mut(width).enumerate();
            heads.map(one).collect()
        } else {
            state.chunks_exact_mut(width).enumerate().map(one).collect()
        };
        // Heads lie side by side in a token's row, so each writes apart and is copied here.
        for (value, found) in found.iter().enumerate() {
            let places = out.chunks_exact_mut(value_width);
            let places = places.skip(value).step_by(self.heads.values);
            for (out, found) in places.zip(found.chunks_exact(value_width)) {
                out.copy_from_slice(found);
            }
        }
    }
}

/// Applies the activation, normalizes queries and keys, and makes factors of what tokens say of
/// learning and forgetting.
struct Prepare<'a> {
    rule: &'a GatedDeltaRule,
    rows: &'a mut [f32],
}

impl Kernel for Prepare<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        let heads = self.rule.heads;
        let keys = heads.keys * heads.key_width;
        let scale = 1.0 / (heads.key_width as f32).sqrt();
        for row in self.rows.chunks_exact_mut(self.rule.row()) {
            let (channels, factors) = row.split_at_mut(heads.channels());
            for value in channels.iter_mut() {
                *value *= sigmoid(*value);
            }
            let (queries, others) = channels.split_at_mut(keys);
            let (keys, _) = others.split_at_mut(keys);
            for head in queries.chunks_exact_mut(heads.key_width) {
                normalize(head, scale);
            }
            for head in keys.chunks_exact_mut(heads.key_width) {
                normalize(head, 1.0);
            }
            let (learned, forgotten) = factors.split_at_mut(heads.values);
            for value in learned {
                *value = sigmoid(*value);
            }
            let settings = self.rule.decay.iter().zip(&self.rule.bias);
            for (value, (decay, bias)) in forgotten.iter_mut().zip(settings) {
                *value = exp_or_zero(-decay * softplus(*value + bias));
            }
        }
    }
}

/// Divides a head by its length, and multiplies it.
#[inline(always)]
fn normalize(head: &mut [f32], scale: f32) {
    let (whole, rest) = head.as_chunks::<LANES>();
    let mut squares = [0f32; LANES];
    for values in whole {
        for (square, value) in squares.iter_mut().zip(values) {
            *square += value * value;
        }
    }
    let sum = squares.iter().sum::<f32>() + rest.iter().map(|value| value * value).sum::<f32>();
    let factor = scale / (sum + EPS).sqrt();
    for value in head {
        *value *= factor;
    }
}

/// ln (1 + eˣ).
fn softplus(x: f32) -> f32 {
    if x > 20.0 { x } else { x.exp().ln_1p() }
}

/// The tokens of one value head.
struct Head<'a> {
    rule: &'a GatedDeltaRule,
    value: usize,
    /// (key width, value width)
    state: &'a mut [f32],
    rows: &'a [f32],
    /// (tokens, value width), zeros
    out: &'a mut [f32],
}

impl Kernel for Head<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        let Self {
            rule,
            value,
            state,
            rows,
            out,
        } = self;
        let heads = rule.heads;
        let (wide, deep) = (heads.value_width, heads.key_width);
        let mut change = vec![0.0; wide];
        let (place, keys) = (heads.key_of(value) * deep, heads.keys * deep);
        let tokens = rows.chunks_exact(rule.row());
        for (out, row) in out.chunks_exact_mut(wide).zip(tokens) {
            let (channels, factors) = row.split_at(heads.channels());
            let (learned, decay) = (factors[value], factors[heads.values + value]);
            let query = &channels[place..place + deep];
            let key = &channels[keys + place..keys + place + deep];
            let values = &channels[2 * keys + value * wide..2 * keys + (value + 1) * wide];
            // What the state says of the key, after it has forgotten.
            change.fill(0.0);
            for (row, key) in state.chunks_exact_mut(wide).zip(key) {
                for (said, number) in change.iter_mut().zip(row) {
                    *number *= decay;
                    *said += *number * key;
                }
            }
            for (change, value) in change.iter_mut().zip(values) {
                *change = learned * (value - *change);
            }
            let both = key.iter().zip(query);
            for (row, (key, query)) in state.chunks_exact_mut(wide).zip(both) {
                for ((out, number), change) in out.iter_mut().zip(row).zip(&change) {
                    *number += key * change;
                    *out += *number * query;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEADS: DeltaHeads = DeltaHeads {
        keys: 2,
        values: 6,
        key_width: 5,
        value_width: 19,
        tiled: false,
    };

    fn rule(heads: DeltaHeads) -> GatedDeltaRule {
        let numbers = |step: f32| (0..heads.values).map(move |head| 0.3 + head as f32 * step);
        GatedDeltaRule::new(heads, numbers(0.2).collect(), numbers(-0.1).collect())
    }

    fn tokens(rule: &GatedDeltaRule, count: usize) -> Vec<f32> {
        let numbers = 0..count * rule.row();
        numbers.map(|number| (number as f32 * 0.7).sin()).collect()
    }

    /// The rule in f64, as its paper writes it: S = S (g (I - b k kT)) + b v kT.
    fn expected(rule: &GatedDeltaRule, rows: &[f32]) -> Vec<f64> {
        let heads = rule.heads();
        let silu = |x: f64| x / (1.0 + (-x).exp());
        let normal = |part: &[f64], scale: f64| -> Vec<f64> {
            let sum: f64 = part.iter().map(|value| value * value).sum();
            part.iter()
                .map(|x| x * scale / (sum + 1e-6).sqrt())
                .collect()
        };
        let mut out = vec![0.0; rows.len() / rule.row() * rule.out()];
        for head in 0..heads.values {
            let (deep, wide) = (heads.key_width, heads.value_width);
            let own = if heads.tiled {
                head % heads.keys
            } else {
                head / (heads.values / heads.keys)
            };
            let mut state = vec![vec![0.0; deep]; wide];
            for (token, row) in rows.chunks(rule.row()).enumerate() {
                let row: Vec<f64> = row.iter().map(|value| f64::from(*value)).collect();
                let (channels, factors) = row.split_at(heads.channels());
                let active: Vec<f64> = channels.iter().map(|x| silu(*x)).collect();
                let keys = heads.keys * deep;
                let query = normal(&active[own * deep..][..deep], (deep as f64).powf(-0.5));
                let key = normal(&active[keys + own * deep..][..deep], 1.0);
                let value = &active[2 * keys + head * wide..][..wide];
                let b = 1.0 / (1.0 + (-factors[head]).exp());
                let x = factors[heads.values + head] + f64::from(rule.bias[head]);
                let g = (-f64::from(rule.decay[head]) * (1.0 + x.exp()).ln()).exp();
                for (row, value) in state.iter_mut().zip(value) {
                    let said: f64 = row.iter().zip(&key).map(|(s, k)| g * s * k).sum();
                    for (s, k) in row.iter_mut().zip(&key) {
                        *s = g * *s + b * (value - said) * k;
                    }
                }
                for (index, row) in state.iter().enumerate() {
                    let place = (token * heads.values + head) * wide + index;
                    out[place] = row.iter().zip(&query).map(|(s, q)| s * q).sum();
                }
            }
        }
        out
    }

    #[test]
    fn tokens_give_what_the_rule_says() {
        for tiled in [false, true] {
            let rule = rule(DeltaHeads { tiled, ..HEADS });
            let rows = tokens(&rule, 40);
            let expected = expected(&rule, &rows);
            let (mut state, mut out) = (vec![0.0; rule.state()], vec![0.0; expected.len()]);
            rule.run(&mut state, &mut rows.clone(), &mut out);
            for (found, expected) in out.iter().zip(expected) {
                assert!(
                    (f64::from(*found) - expected).abs() < 1e-5,
                    "{found} {expected}"
                );
            }
        }
    }

    #[test]
    fn the_bits_are_the_same_in_any_parts_and_at_any_thread_count() {
        let rule = rule(DeltaHeads {
            key_width: 64,
            value_width: 80,
            ..HEADS
        });
        let rows = tokens(&rule, 48);
        let run = |part: usize| {
            let (mut state, mut all) = (vec![0.0; rule.state()], Vec::new());
            for rows in rows.chunks(part * rule.row()) {
                let mut out = vec![0.0; rows.len() / rule.row() * rule.out()];
                rule.run(&mut state, &mut rows.to_vec(), &mut out);
                all.extend(out.iter().map(|value| value.to_bits()));
            }
            all
        };
        // 48 tokens are shared among threads, single ones not.
        assert_eq!(run(48), run(1));
        assert_eq!(run(48), run(7));
    }

    #[test]
    fn a_state_that_forgets_all_gives_no_subnormal_numbers() {
        let heads = DeltaHeads {
            keys: 1,
            values: 1,
            key_width: 2,
            value_width: 2,
            tiled: false,
        };
        let rule = GatedDeltaRule::new(heads, vec![1e6], vec![30.0]);
        let (mut state, mut out) = (vec![1.0; 4], [0.0; 2]);
        rule.run(&mut state, &mut [0.0; 8], &mut out);
        assert_eq!((state, out), (vec![0.0; 4], [0.0; 2]));
    }
}
