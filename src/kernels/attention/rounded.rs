//! Attention among the tokens of a picture in products of 16 bits: faster than in f32 where the CPU
//! has dot products of them, and with exact sums everywhere.
//!
//! Queries, keys, values and weights are rounded to integers whose sums of a block fit in i32. A
//! query has a scale of its own, the keys of a block share one, and the values of a block have one
//! for each channel (docs/decisions/134-attention-in-sixteen-bits.md).

use super::key_values::BLOCK_POSITIONS;
use super::projected::Projected;
use super::unit::{KEY_VECTORS, MIN_TILE_REGISTERS, PartialOutput, Scores, rows_at_once};
use super::{AttentionMask, KeyValues, Precision, attend, count, exact_tokens};
use crate::matrix::{Instructions, Kernel, LANES, Simd};
use crate::values::in_parts;
use candle_core::{Device, Tensor};
use rayon::prelude::*;
use std::ops::Range;

/// Largest weight: 2¹³ − 1, so that the smallest is an eight-thousandth of the largest.
const MAX_WEIGHT: i32 = (1 << 13) - 1;
/// Largest value: the sum of a block's values with the largest weights still fits in i32.
const MAX_VALUE: i32 = i32::MAX / (BLOCK_POSITIONS as i32 * MAX_WEIGHT);
/// Numbers from here on may have scores beyond f32.
const MAX_NUMBER: f32 = 1e15;
/// Two weights of 1: a product with them sums weights.
const ONES: i32 = 1 | 1 << 16;

/// Rounded keys and values of a head at some positions, at most a block.
#[derive(Debug)]
struct RoundedBlock {
    positions: usize,
    /// (pairs of channels, vectors of positions).
    keys: Vec<[i32; LANES]>,
    key_scale: f32,
    /// (pairs of positions, vectors of channels). The positions of a pair are [`LANES`] apart, so
    /// that two vectors of weights become pairs lane by lane.
    values: Vec<[i32; LANES]>,
    /// (vectors of channels).
    value_scales: Vec<[f32; LANES]>,
}

/// Rounded queries of a unit. A row is a token and query head; rows that are computed together
/// alternate pair by pair.
#[derive(Debug)]
struct RoundedQueries {
    pairs: Vec<i32>,
    /// Of each row, with 1/√width and the logarithm of two in it: scores count powers of two.
    scales: Vec<f32>,
}

/// The queries of some tokens and one key head.
struct RoundedUnit<'a> {
    rows: Projected<'a>,
    blocks: &'a [RoundedBlock],
    head: usize,
    tokens: Range<usize>,
}

struct RoundedKernel<'a> {
    unit: RoundedUnit<'a>,
    queries: RoundedQueries,
    partial: &'a mut PartialOutput,
}

/// Attends among all tokens, (tokens, query heads · head width). Where a number is not finite, or so
/// large that scores may not be, all attend in f32, which passes on what is not finite.
///
/// # Errors
/// When the tensor cannot be made.
pub fn attend_rounded(rows: &Projected<'_>) -> candle_core::Result<Tensor> {
    let (tokens, shape) = (rows.tokens(), rows.shape());
    if !rows.are_below(MAX_NUMBER) {
        let mut held = KeyValues::new(shape, Precision::Single);
        held.write(rows, 0)?;
        return attend(rows, &held, AttentionMask::All { positions: tokens });
    }
    count(shape, size_of::<i16>(), (0..tokens).map(|_| 0..tokens));
    let out = mix_rounded(rows, Instructions::best());
    Tensor::from_vec(out, (tokens, shape.query_heads * shape.width), &Device::Cpu)
}

/// The result of [`attend_rounded`], computed with any instructions.
pub(super) fn mix_rounded(rows: &Projected<'_>, instructions: Instructions) -> Vec<f32> {
    let (tokens, shape) = (rows.tokens(), rows.shape());
    let heads: Vec<Vec<RoundedBlock>> = (0..shape.key_heads)
        .into_par_iter()
        .map(|head| RoundedBlock::of_head(rows, head, instructions))
        .collect();
    let (width, step) = (shape.query_heads * shape.width, exact_tokens(shape));
    in_parts(tokens * width, step * width, |index, out| {
        let tokens = index * step..tokens.min((index + 1) * step);
        let unit = |(head, blocks): (usize, &Vec<RoundedBlock>)| {
            RoundedUnit {
                rows: *rows,
                blocks,
                head,
                tokens: tokens.clone(),
            }
            .run(instructions)
        };
        let parts: Vec<PartialOutput> = heads.par_iter().enumerate().map(unit).collect();
        for (head, part) in parts.iter().enumerate() {
            part.write(shape, head, out);
        }
    })
}

impl RoundedBlock {
    /// All blocks of a head.
    fn of_head(rows: &Projected<'_>, head: usize, instructions: Instructions) -> Vec<Self> {
        (0..rows.tokens())
            .step_by(BLOCK_POSITIONS)
            .map(|base| {
                let tokens = base..rows.tokens().min(base + BLOCK_POSITIONS);
                Self::round(rows, head, tokens, instructions)
            })
            .collect()
    }

    fn round(
        rows: &Projected<'_>,
        head: usize,
        tokens: Range<usize>,
        instructions: Instructions,
    ) -> Self {
        let shape = rows.shape();
        let vectors = shape.padded() / LANES;
        let mut block = Self {
            positions: tokens.len(),
            keys: vec![[0; LANES]; shape.width.div_ceil(2) * KEY_VECTORS],
            key_scale: 0.0,
            values: vec![[0; LANES]; BLOCK_POSITIONS / 2 * vectors],
            value_scales: vec![[0.0; LANES]; vectors],
        };
        instructions.run(RoundingKernel {
            rows,
            head,
            tokens,
            block: &mut block,
        });
        block
    }
}

/// Fills a block.
struct RoundingKernel<'a> {
    rows: &'a Projected<'a>,
    head: usize,
    tokens: Range<usize>,
    block: &'a mut RoundedBlock,
}

impl Kernel for RoundingKernel<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self {
            rows,
            head,
            tokens,
            block,
        } = self;
        let (width, vectors) = (rows.shape().width, block.value_scales.len());
        let mut numbers = vec![[0f32; LANES]; tokens.len() * vectors];
        for (token, key) in tokens.clone().zip(numbers.chunks_exact_mut(vectors)) {
            let key = &mut key.as_flattened_mut()[..width];
            rows.rotated(token, rows.key(token, head), 1.0, key);
        }
        round_keys(simd, &numbers, width, block);
        for (token, value) in tokens.zip(numbers.chunks_exact_mut(vectors)) {
            value.as_flattened_mut()[..width].copy_from_slice(rows.value(token, head));
        }
        round_values(simd, &numbers, block);
    }
}

/// Rounds keys, (positions, vectors of channels).
#[inline(always)]
fn round_keys<S: Simd>(simd: S, keys: &[[f32; LANES]], width: usize, block: &mut RoundedBlock) {
    let vectors = block.value_scales.len();
    let (scale, inverse) = scales(largest(simd, keys), max_factor(width));
    block.key_scale = scale;
    let mut rounded = vec![[0i32; LANES]; vectors];
    for (position, key) in keys.chunks_exact(vectors).enumerate() {
        round(simd, key, inverse, &mut rounded);
        let columns = block.keys.chunks_exact_mut(KEY_VECTORS);
        for (column, pair) in columns.zip(rounded.as_flattened().as_chunks::<2>().0) {
            column[position / LANES][position % LANES] = pair_of(*pair);
        }
    }
}

/// Rounds values, (positions, vectors of channels).
#[inline(always)]
fn round_values<S: Simd>(simd: S, values: &[[f32; LANES]], block: &mut RoundedBlock) {
    let vectors = block.value_scales.len();
    let zero = [0.0; LANES];
    for column in 0..vectors {
        let column_of = |position: usize| values.get(position * vectors + column).unwrap_or(&zero);
        let mut most = simd.floats(0.0);
        for position in 0..block.positions {
            most = simd.max(most, magnitude(simd, column_of(position)));
        }
        let mut largest = [0.0; LANES];
        simd.store(most, &mut largest);
        let both = largest.map(|largest| scales(largest, MAX_VALUE));
        block.value_scales[column] = both.map(|(scale, _)| scale);
        let inverses = simd.load(&both.map(|(_, inverse)| inverse));
        for pair in 0..BLOCK_POSITIONS / 2 {
            let first = pair / LANES * 2 * LANES + pair % LANES;
            let low = simd.mul(simd.load(column_of(first)), inverses);
            let high = simd.mul(simd.load(column_of(first + LANES)), inverses);
            let pairs = simd.pair(simd.to_ints(low), simd.to_ints(high));
            simd.store_ints(pairs, &mut block.values[pair * vectors + column]);
        }
    }
}

impl RoundedUnit<'_> {
    fn run(self, instructions: Instructions) -> PartialOutput {
        let shape = self.rows.shape();
        let rows = self.tokens.len() * shape.group();
        let mut partial = PartialOutput::new(rows, shape.padded() / LANES);
        instructions.run(RoundedKernel {
            queries: RoundedQueries {
                pairs: vec![0; rows * shape.width.div_ceil(2)],
                scales: vec![0.0; rows],
            },
            unit: self,
            partial: &mut partial,
        });
        partial
    }

    #[inline(always)]
    fn round_queries<S: Simd>(&self, simd: S, queries: &mut RoundedQueries) {
        let shape = self.rows.shape();
        let (width, group) = (shape.width, shape.group());
        let to_score = std::f32::consts::LOG2_E / (width as f32).sqrt();
        let mut turned = vec![[0f32; LANES]; shape.padded() / LANES];
        let mut rounded = vec![[0i32; LANES]; turned.len()];
        let (rows, pairs) = (queries.scales.len(), width.div_ceil(2));
        let mut row = 0;
        while row < rows {
            let rows_at_once = rows_at_once(rows - row);
            let out = &mut queries.pairs[row * pairs..(row + rows_at_once) * pairs];
            for r in 0..rows_at_once {
                let (token, head) = (self.tokens.start + (row + r) / group, (row + r) % group);
                let query = &self.rows.queries(token, self.head)[head * width..(head + 1) * width];
                let place = &mut turned.as_flattened_mut()[..width];
                self.rows.rotated(token, query, 1.0, place);
                let (scale, inverse) = scales(largest(simd, &turned), max_factor(width));
                queries.scales[row + r] = scale * to_score;
                round(simd, &turned, inverse, &mut rounded);
                let places = out[r..].iter_mut().step_by(rows_at_once);
                for (out, pair) in places.zip(rounded.as_flattened().as_chunks::<2>().0) {
                    *out = pair_of(*pair);
                }
            }
            row += rows_at_once;
        }
    }
}

/// Largest magnitude of queries and keys whose products still sum in i32.
fn max_factor(width: usize) -> i32 {
    let width = i32::try_from(width.max(1)).unwrap_or(i32::MAX);
    (i32::MAX / width).isqrt().min(i32::from(i16::MAX))
}

#[inline(always)]
fn magnitude<S: Simd>(simd: S, numbers: &[f32; LANES]) -> S::Floats {
    let numbers = simd.load(numbers);
    simd.max(numbers, simd.mul(numbers, simd.floats(-1.0)))
}

#[inline(always)]
fn largest<S: Simd>(simd: S, numbers: &[[f32; LANES]]) -> f32 {
    let mut most = simd.floats(0.0);
    for numbers in numbers {
        most = simd.max(most, magnitude(simd, numbers));
    }
    simd.max_lane(most)
}

#[inline(always)]
fn round<S: Simd>(simd: S, numbers: &[[f32; LANES]], inverse: f32, out: &mut [[i32; LANES]]) {
    let inverse = simd.floats(inverse);
    for (numbers, out) in numbers.iter().zip(out) {
        simd.store_ints(simd.to_ints(simd.mul(simd.load(numbers), inverse)), out);
    }
}

/// The step of integers up to `max` that reach `largest`, and its inverse.
fn scales(largest: f32, max: i32) -> (f32, f32) {
    let inverse = max as f32 / largest;
    if inverse.is_finite() {
        (largest / max as f32, inverse)
    } else {
        // Numbers this small are zeros beside any other.
        (0.0, 0.0)
    }
}

/// Two integers of 16 bits.
fn pair_of([low, high]: [i32; 2]) -> i32 {
    low & 0xffff | high << 16
}

impl Kernel for RoundedKernel<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let mut kernel = self;
        kernel.unit.round_queries(simd, &mut kernel.queries);
        let rows = kernel.queries.scales.len();
        let at_once = rows_at_once(rows) * KEY_VECTORS;
        let mut scores = vec![[0f32; LANES]; kernel.unit.blocks.len() * at_once];
        let mut row = 0;
        while row < rows {
            let scores = scores.as_mut_slice();
            row += match rows_at_once(rows - row) {
                6 => kernel.attend_from::<S, 6>(simd, row, scores),
                4 => kernel.attend_from::<S, 4>(simd, row, scores),
                3 => kernel.attend_from::<S, 3>(simd, row, scores),
                2 => kernel.attend_from::<S, 2>(simd, row, scores),
                _ => kernel.attend_from::<S, 1>(simd, row, scores),
            };
        }
    }
}

impl RoundedKernel<'_> {
    /// Attends from `R` rows, beginning with `row`, to all blocks; returns `R`. `scores` has room for
    /// their scores: the maximum of a row is known before its first weight, so that no weight is
    /// rescaled.
    #[inline(always)]
    fn attend_from<S: Simd, const R: usize>(
        &mut self,
        simd: S,
        row: usize,
        scores: &mut [[f32; LANES]],
    ) -> usize {
        let (scores, _) = scores.as_chunks_mut::<KEY_VECTORS>();
        let (scores, _) = scores.as_chunks_mut::<R>();
        let tops = self.score_all(simd, row, scores);
        let out = &mut *self.partial;
        let vectors = out.values.len() / out.weight_sum.len();
        let values = &mut out.values[row * vectors..(row + R) * vectors];
        let mut sums = [simd.ints(0); R];
        for (block, scores) in self.unit.blocks.iter().zip(scores) {
            let weights = weigh(simd, scores, &tops, &mut sums);
            // As many sums at once as the registers hold.
            let mut column = 0;
            while column < vectors {
                column += match vectors - column {
                    4.. if S::REGISTERS >= MIN_TILE_REGISTERS => {
                        mix::<S, R, 4>(simd, &weights, block, column, values)
                    }
                    2.. if S::REGISTERS >= MIN_TILE_REGISTERS => {
                        mix::<S, R, 2>(simd, &weights, block, column, values)
                    }
                    _ => mix::<S, R, 1>(simd, &weights, block, column, values),
                };
            }
        }
        for (out, sum) in out.weight_sum[row..row + R].iter_mut().zip(sums) {
            *out = simd.sum(simd.to_floats(sum));
        }
        R
    }

    /// The scores of `R` rows with all blocks; returns the highest of each row.
    #[inline(always)]
    fn score_all<S: Simd, const R: usize>(
        &self,
        simd: S,
        row: usize,
        scores: &mut [Scores<R>],
    ) -> [f32; R] {
        let pairs = self.unit.rows.shape().width.div_ceil(2);
        let rows = self.queries.pairs[row * pairs..(row + R) * pairs]
            .as_chunks::<R>()
            .0;
        let mut most = [simd.floats(f32::NEG_INFINITY); R];
        for (block, scores) in self.unit.blocks.iter().zip(scores) {
            let factors: [f32; R] =
                std::array::from_fn(|r| self.queries.scales[row + r] * block.key_scale);
            // As many sums at once as the registers hold.
            let mut column = 0;
            while column < KEY_VECTORS {
                column += if S::REGISTERS >= MIN_TILE_REGISTERS {
                    score::<S, R, KEY_VECTORS>(simd, rows, block, column, &factors, scores)
                } else {
                    score::<S, R, 1>(simd, rows, block, column, &factors, scores)
                };
            }
            for (most, scores) in most.iter_mut().zip(scores) {
                if block.positions < BLOCK_POSITIONS {
                    scores.as_flattened_mut()[block.positions..].fill(f32::NEG_INFINITY);
                }
                for vector in scores {
                    *most = simd.max(*most, simd.load(vector));
                }
            }
        }
        let mut tops = [0.0; R];
        for (top, most) in tops.iter_mut().zip(most) {
            *top = simd.max_lane(most);
        }
        tops
    }
}

/// A·B of pairs. `columns` are the columns of A; B has rows of `stride` vectors, of which the first
/// `C` count.
#[inline(always)]
fn product<S: Simd, const R: usize, const C: usize>(
    simd: S,
    columns: impl Iterator<Item = [i32; R]>,
    b: &[[i32; LANES]],
    stride: usize,
) -> [[S::Ints; C]; R] {
    let mut sums = [[simd.ints(0); C]; R];
    for (factors, row) in columns.zip(b.chunks(stride)) {
        let Some(row) = row.first_chunk::<C>() else {
            break;
        };
        let mut vectors = [simd.ints(0); C];
        for c in 0..C {
            vectors[c] = simd.load_ints(&row[c]);
        }
        for r in 0..R {
            for c in 0..C {
                sums[r][c] = simd.dot_pairs(sums[r][c], vectors[c], factors[r]);
            }
        }
    }
    sums
}

/// Computes the scores of `C` key vectors; returns `C`.
#[inline(always)]
fn score<S: Simd, const R: usize, const C: usize>(
    simd: S,
    queries: &[[i32; R]],
    block: &RoundedBlock,
    column: usize,
    factors: &[f32; R],
    scores: &mut Scores<R>,
) -> usize {
    let columns = queries.iter().copied();
    let sums = product::<S, R, C>(simd, columns, &block.keys[column..], KEY_VECTORS);
    for r in 0..R {
        let factor = simd.floats(factors[r]);
        for c in 0..C {
            let score = simd.mul(simd.to_floats(sums[r][c]), factor);
            simd.store(score, &mut scores[r][column + c]);
        }
    }
    C
}

/// Pairs of weights of rows in a block.
type Weights<const R: usize> = [[[i32; LANES]; KEY_VECTORS / 2]; R];

/// Turns scores into weights 2^(score − maximum score), and adds them to the sums of the rows.
#[inline(always)]
fn weigh<S: Simd, const R: usize>(
    simd: S,
    scores: &Scores<R>,
    tops: &[f32; R],
    sums: &mut [S::Ints; R],
) -> Weights<R> {
    let mut weights = [[[0; LANES]; KEY_VECTORS / 2]; R];
    for r in 0..R {
        // Of the rounded weights, since these multiply the values.
        for (pairs, [low, high]) in weights[r].iter_mut().zip(scores[r].as_chunks::<2>().0) {
            let both = simd.pair(weight(simd, low, tops[r]), weight(simd, high, tops[r]));
            simd.store_ints(both, pairs);
            sums[r] = simd.dot_pairs(sums[r], both, ONES);
        }
    }
    weights
}

/// The weights of scores beside the highest.
#[inline(always)]
fn weight<S: Simd>(simd: S, scores: &[f32; LANES], top: f32) -> S::Ints {
    let below_top = simd.add(simd.load(scores), simd.floats(-top));
    simd.to_ints(power_of_two(simd, below_top))
}

/// [`MAX_WEIGHT`] · 2ˣ for x ≤ 0, to a twentieth of the steps of weights. 2ˣ = 2ⁿ 2ᶠ with
/// n = round(x), and 2ᶠ by its Taylor series.
#[inline(always)]
fn power_of_two<S: Simd>(simd: S, x: S::Floats) -> S::Floats {
    /// Below this, weights round to 0.
    const LEAST: f32 = -30.0;
    /// (ln 2)ᵏ / k! for k from 4 down to 0, times the largest weight.
    const SERIES: [f32; 5] = {
        const LN_2: f32 = std::f32::consts::LN_2;
        const MAX: f32 = MAX_WEIGHT as f32;
        [
            MAX * LN_2 * LN_2 * LN_2 * LN_2 / 24.0,
            MAX * LN_2 * LN_2 * LN_2 / 6.0,
            MAX * LN_2 * LN_2 / 2.0,
            MAX * LN_2,
            MAX,
        ]
    };
    let x = simd.max(simd.floats(LEAST), x);
    let n = simd.round(x);
    let f = simd.mul_sub_from(n, simd.floats(1.0), x);
    let mut series = simd.floats(SERIES[0]);
    for coefficient in &SERIES[1..] {
        series = simd.mul_add(series, f, simd.floats(*coefficient));
    }
    simd.mul(series, simd.two_to_the(n))
}

/// Adds the weighted values to `C` vectors of the rows' sums; returns `C`.
#[inline(always)]
fn mix<S: Simd, const R: usize, const C: usize>(
    simd: S,
    weights: &Weights<R>,
    block: &RoundedBlock,
    column: usize,
    out: &mut [[f32; LANES]],
) -> usize {
    let vectors = block.value_scales.len();
    let column_of = |k: usize| std::array::from_fn(|r| weights[r].as_flattened()[k]);
    let columns = (0..BLOCK_POSITIONS / 2).map(column_of);
    let sums = product::<S, R, C>(simd, columns, &block.values[column..], vectors);
    for r in 0..R {
        for c in 0..C {
            let place = &mut out[r * vectors + column + c];
            let scale = simd.load(&block.value_scales[column + c]);
            let sum = simd.mul_add(simd.to_floats(sums[r][c]), scale, simd.load(place));
            simd.store(sum, place);
        }
    }
    C
}
