//! A work unit: the part of an attention that one thread computes.

use super::key_values::{BLOCK_POSITIONS, Block, StoredFloat};
use super::mask::AttentionMask;
use super::projected::{HeadShape, Projected};
use crate::matrix::{Instructions, Kernel, LANES, Simd};
use std::ops::Range;
use std::sync::Arc;

/// Minimum rows for which one conversion of an f16 block is cheaper than a conversion for every few
/// rows.
const MIN_WIDENED_ROWS: usize = 16;
/// Minimum registers for the sums of six rows and four vectors, their factors, and a spare.
pub(super) const MIN_TILE_REGISTERS: usize = 32;
/// Key vectors of a block and channel.
pub(super) const KEY_VECTORS: usize = BLOCK_POSITIONS / LANES;

/// The queries of some tokens and one key head, and some of the positions.
#[derive(Debug)]
pub(super) struct WorkUnit<'a, N> {
    pub(super) rows: Projected<'a>,
    /// The keys and values of all positions.
    pub(super) blocks: &'a [Arc<Block<N>>],
    pub(super) mask: AttentionMask<'a>,
    pub(super) head: usize,
    pub(super) tokens: Range<usize>,
    pub(super) positions: Range<usize>,
}

/// Result of a unit. A row is a token and query head; it has the sum of its weights e^(score −
/// maximum score), and the sum of the values with these weights.
#[derive(Debug)]
pub(super) struct PartialOutput {
    pub(super) max_score: Vec<f32>,
    pub(super) weight_sum: Vec<f32>,
    /// (rows, padded head width)
    pub(super) values: Vec<[f32; LANES]>,
}

/// Keys of a head in a block, (head width, vectors of positions), and its values, (positions,
/// vectors of channels).
#[derive(Clone, Copy)]
struct HeadBlock<'a, N> {
    keys: &'a [[N; LANES]],
    values: &'a [[N; LANES]],
    /// Position of the first entry.
    base: usize,
}

/// Scores of rows in a block, later their weights.
pub(super) type Scores<const R: usize> = [[[f32; LANES]; KEY_VECTORS]; R];

struct WorkUnitKernel<'a, N> {
    unit: &'a WorkUnit<'a, N>,
    queries: &'a [f32],
    partial: &'a mut PartialOutput,
}

impl<N: StoredFloat> Kernel for WorkUnitKernel<'_, N> {
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self {
            unit,
            queries,
            partial,
        } = self;
        let shape = unit.rows.shape();
        // The number type is known at compile time, so f32 blocks keep none of the code that
        // widens.
        let widen = partial.max_score.len() >= MIN_WIDENED_ROWS && !N::IS_F32;
        let (mut keys, mut values) = (Vec::new(), Vec::new());
        for index in
            unit.positions.start / BLOCK_POSITIONS..unit.positions.end.div_ceil(BLOCK_POSITIONS)
        {
            let Some(block) = unit.blocks.get(index) else {
                break;
            };
            let base = index * BLOCK_POSITIONS;
            let held = HeadBlock {
                keys: block.keys(shape, unit.head),
                values: block.values(shape, unit.head),
                base,
            };
            if widen {
                widen_all(simd, held.keys, &mut keys);
                widen_all(simd, held.values, &mut values);
                unit.attend(
                    simd,
                    HeadBlock {
                        keys: &keys,
                        values: &values,
                        base,
                    },
                    queries,
                    partial,
                );
            } else {
                unit.attend(simd, held, queries, partial);
            }
        }
    }
}

impl<N: StoredFloat> WorkUnit<'_, N> {
    pub(super) fn run(&self, instructions: Instructions) -> PartialOutput {
        let shape = self.rows.shape();
        let mut partial =
            PartialOutput::new(self.tokens.len() * shape.group(), shape.padded() / LANES);
        instructions.run(WorkUnitKernel {
            unit: self,
            queries: &self.queries(),
            partial: &mut partial,
        });
        partial
    }

    /// The queries, rotated and scaled by 1/√width. Rows that are computed together alternate
    /// channel by channel.
    fn queries(&self) -> Vec<f32> {
        let HeadShape { width, .. } = self.rows.shape();
        let group = self.rows.shape().group();
        let scale = 1.0 / (width as f32).sqrt();
        let mut turned = vec![0f32; width];
        let rows = self.tokens.len() * group;
        let mut queries = vec![0f32; rows * width];
        let mut row = 0;
        while row < rows {
            let rows_at_once = rows_at_once(rows - row);
            let out = &mut queries[row * width..(row + rows_at_once) * width];
            for r in 0..rows_at_once {
                let (token, head) = (self.tokens.start + (row + r) / group, (row + r) % group);
                let query = &self.rows.queries(token, self.head)[head * width..(head + 1) * width];
                self.rows.rotated(token, query, scale, &mut turned);
                for (out, value) in out[r..].iter_mut().step_by(rows_at_once).zip(&turned) {
                    *out = *value;
                }
            }
            row += rows_at_once;
        }
        queries
    }

    /// Attends from all rows to a block.
    #[inline(always)]
    fn attend<S: Simd, M: StoredFloat>(
        &self,
        simd: S,
        block: HeadBlock<'_, M>,
        queries: &[f32],
        partial: &mut PartialOutput,
    ) {
        let rows = partial.max_score.len();
        let mut row = 0;
        while row < rows {
            row += match rows_at_once(rows - row) {
                6 => self.attend_from::<S, M, 6>(simd, block, queries, row, partial),
                4 => self.attend_from::<S, M, 4>(simd, block, queries, row, partial),
                3 => self.attend_from::<S, M, 3>(simd, block, queries, row, partial),
                2 => self.attend_from::<S, M, 2>(simd, block, queries, row, partial),
                _ => self.attend_from::<S, M, 1>(simd, block, queries, row, partial),
            };
        }
    }

    /// Attends from `R` rows, beginning with `row`, to a block; returns `R`.
    #[inline(always)]
    fn attend_from<S: Simd, M: StoredFloat, const R: usize>(
        &self,
        simd: S,
        block: HeadBlock<'_, M>,
        queries: &[f32],
        row: usize,
        partial: &mut PartialOutput,
    ) -> usize {
        let shape = self.rows.shape();
        let seen: [Range<usize>; R] = std::array::from_fn(|r| self.seen(row + r, block.base));
        let depth = seen
            .iter()
            .map(|seen| seen.end)
            .max()
            .expect("a pass takes one row at least");
        if seen.iter().all(Range::is_empty) {
            return R;
        }
        let rows = queries[row * shape.width..(row + R) * shape.width]
            .as_chunks::<R>()
            .0;
        // A block is scored as a whole, even where rows see part of it: its vectors take the same
        // time. `weigh` leaves out what is not seen.
        let mut scores = [[[0f32; LANES]; KEY_VECTORS]; R];
        let mut column = 0;
        while column < KEY_VECTORS {
            column += if S::REGISTERS >= MIN_TILE_REGISTERS {
                score::<S, M, R, KEY_VECTORS>(simd, rows, block.keys, column, &mut scores)
            } else {
                score::<S, M, R, 1>(simd, rows, block.keys, column, &mut scores)
            };
        }
        let rescale = weigh(
            simd,
            &seen,
            &mut scores,
            &mut partial.max_score[row..row + R],
            &mut partial.weight_sum[row..row + R],
        );

        let vectors = shape.padded() / LANES;
        let out = &mut partial.values[row * vectors..(row + R) * vectors];
        let mut column = 0;
        while column < vectors {
            column += match vectors - column {
                4.. if S::REGISTERS >= MIN_TILE_REGISTERS => {
                    mix::<S, M, R, 4>(simd, &scores, depth, block.values, column, rescale, out)
                }
                2.. if S::REGISTERS >= MIN_TILE_REGISTERS => {
                    mix::<S, M, R, 2>(simd, &scores, depth, block.values, column, rescale, out)
                }
                _ => mix::<S, M, R, 1>(simd, &scores, depth, block.values, column, rescale, out),
            };
        }
        R
    }

    /// The positions that a row attends to in the block whose first position is `base`, relative to
    /// it.
    fn seen(&self, row: usize, base: usize) -> Range<usize> {
        let seen = self
            .mask
            .seen_by(self.tokens.start + row / self.rows.shape().group());
        let start = seen
            .start
            .max(self.positions.start)
            .saturating_sub(base)
            .min(BLOCK_POSITIONS);
        let end = seen
            .end
            .min(self.positions.end)
            .saturating_sub(base)
            .min(BLOCK_POSITIONS);
        start..end.max(start)
    }
}

/// How many of the remaining rows are computed together. A row alone would wait for its own sums.
pub(super) fn rows_at_once(rows: usize) -> usize {
    match rows {
        7 => 4,
        6.. => 6,
        5 => 3,
        _ => rows,
    }
}

#[inline(always)]
fn widen_all<S: Simd, N: StoredFloat>(simd: S, from: &[[N; LANES]], to: &mut Vec<[f32; LANES]>) {
    to.resize(from.len(), [0.0; LANES]);
    for (to, from) in to.iter_mut().zip(from) {
        simd.store(N::load(simd, from), to);
    }
}

/// Adds A·B to sums. `columns` are the columns of A; B has rows of `stride` vectors, of which the
/// first `C` count.
#[inline(always)]
pub(super) fn add_product<S: Simd, N: StoredFloat, const R: usize, const C: usize>(
    simd: S,
    columns: impl Iterator<Item = [f32; R]>,
    b: &[[N; LANES]],
    stride: usize,
    mut sums: [[S::Floats; C]; R],
) -> [[S::Floats; C]; R] {
    for (factors, row) in columns.zip(b.chunks(stride)) {
        let Some(row) = row.first_chunk::<C>() else {
            break;
        };
        let mut vectors = [simd.floats(0.0); C];
        for c in 0..C {
            vectors[c] = N::load(simd, &row[c]);
        }
        for r in 0..R {
            let factor = simd.floats(factors[r]);
            for c in 0..C {
                sums[r][c] = simd.mul_add(factor, vectors[c], sums[r][c]);
            }
        }
    }
    sums
}

/// Computes the scores of `C` key vectors; returns `C`.
#[inline(always)]
fn score<S: Simd, N: StoredFloat, const R: usize, const C: usize>(
    simd: S,
    queries: &[[f32; R]],
    keys: &[[N; LANES]],
    column: usize,
    scores: &mut Scores<R>,
) -> usize {
    let zero = [[simd.floats(0.0); C]; R];
    let sums = add_product(
        simd,
        queries.iter().copied(),
        &keys[column..],
        KEY_VECTORS,
        zero,
    );
    for r in 0..R {
        for c in 0..C {
            simd.store(sums[r][c], &mut scores[r][column + c]);
        }
    }
    C
}

/// Turns scores into weights e^(score − maximum score), 0 at masked positions, and adds them to the
/// weight sums. Returns the factor that rescales the rows' earlier weights to the new maximum.
#[inline(always)]
fn weigh<S: Simd, const R: usize>(
    simd: S,
    seen: &[Range<usize>; R],
    scores: &mut Scores<R>,
    max_score: &mut [f32],
    weight_sum: &mut [f32],
) -> [f32; LANES] {
    let mut growth = [0f32; LANES];
    let mut sums = [0f32; R];
    for r in 0..R {
        if seen[r] != (0..BLOCK_POSITIONS) {
            let scores = scores[r].as_flattened_mut();
            scores[..seen[r].start].fill(f32::NEG_INFINITY);
            scores[seen[r].end..].fill(f32::NEG_INFINITY);
        }
        let mut most = simd.load(&scores[r][0]);
        for vector in &scores[r][1..] {
            most = simd.max(most, simd.load(vector));
        }
        let top = max_score[r].max(simd.max_lane(most));
        // A row without any position so far has no weights to rescale.
        let shift = if top == f32::NEG_INFINITY { 0.0 } else { top };
        growth[r] = max_score[r] - shift;
        max_score[r] = top;
        let mut sum = simd.floats(0.0);
        for vector in &mut scores[r] {
            let weights = simd.exp(simd.add(simd.load(vector), simd.floats(-shift)));
            simd.store(weights, vector);
            sum = simd.add(sum, weights);
        }
        sums[r] = simd.sum(sum);
    }
    let mut rescale = [0f32; LANES];
    simd.store(simd.exp(simd.load(&growth)), &mut rescale);
    for r in 0..R {
        weight_sum[r] = weight_sum[r] * rescale[r] + sums[r];
    }
    rescale
}

/// Rescales `C` vectors of the rows' sums and adds the weighted values; returns `C`.
#[inline(always)]
fn mix<S: Simd, N: StoredFloat, const R: usize, const C: usize>(
    simd: S,
    weights: &Scores<R>,
    depth: usize,
    values: &[[N; LANES]],
    column: usize,
    rescale: [f32; LANES],
    out: &mut [[f32; LANES]],
) -> usize {
    let vectors = out.len() / R;
    // Old sums are rescaled as they are loaded; a pass of its own would read and write all of them
    // again.
    let mut sums = [[simd.floats(0.0); C]; R];
    for r in 0..R {
        for c in 0..C {
            sums[r][c] = simd.mul(
                simd.load(&out[r * vectors + column + c]),
                simd.floats(rescale[r]),
            );
        }
    }
    let column_of = |k: usize| std::array::from_fn(|r| weights[r].as_flattened()[k]);
    let sums = add_product(
        simd,
        (0..depth.min(BLOCK_POSITIONS)).map(column_of),
        &values[column..],
        vectors,
        sums,
    );
    for r in 0..R {
        for c in 0..C {
            simd.store(sums[r][c], &mut out[r * vectors + column + c]);
        }
    }
    C
}

impl PartialOutput {
    pub(super) fn new(rows: usize, vectors: usize) -> Self {
        Self {
            max_score: vec![f32::NEG_INFINITY; rows],
            weight_sum: vec![0.0; rows],
            values: vec![[0.0; LANES]; rows * vectors],
        }
    }

    /// Merges the results of units with the same rows and other positions, in order.
    pub(super) fn join(mut parts: impl Iterator<Item = Self>) -> Self {
        let mut joined = parts.next().unwrap_or_else(|| Self::new(0, 0));
        for part in parts {
            joined.add(&part);
        }
        joined
    }

    fn add(&mut self, other: &Self) {
        let rows = self.max_score.len();
        let vectors = self.values.len() / rows.max(1);
        for row in 0..rows {
            let top = self.max_score[row].max(other.max_score[row]);
            let shift = if top == f32::NEG_INFINITY { 0.0 } else { top };
            let (own, others) = (
                (self.max_score[row] - shift).exp(),
                (other.max_score[row] - shift).exp(),
            );
            self.max_score[row] = top;
            self.weight_sum[row] = self.weight_sum[row] * own + other.weight_sum[row] * others;
            let values = self.values[row * vectors..(row + 1) * vectors].as_flattened_mut();
            let added = other.values[row * vectors..(row + 1) * vectors].as_flattened();
            for (value, added) in values.iter_mut().zip(added) {
                *value = *value * own + added * others;
            }
        }
    }

    /// Writes the weighted means of the values to the query heads of a key head in (tokens, query
    /// heads · head width).
    pub(super) fn write(&self, shape: HeadShape, head: usize, out: &mut [f32]) {
        let group = shape.group() * shape.width;
        let tokens = out.chunks_exact_mut(shape.query_heads * shape.width);
        let places = tokens.flat_map(|token| {
            token[head * group..(head + 1) * group].chunks_exact_mut(shape.width)
        });
        let rows = self
            .values
            .chunks_exact(shape.padded() / LANES)
            .zip(&self.weight_sum);
        for (place, (values, weight_sum)) in places.zip(rows) {
            let scale = 1.0 / weight_sum;
            place
                .iter_mut()
                .zip(values.as_flattened())
                .for_each(|(out, value)| *out = value * scale);
        }
    }
}
