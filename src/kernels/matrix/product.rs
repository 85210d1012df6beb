//! The product of row-major activations with packed tiles, over threads and instruction sets.
#![allow(unsafe_code, reason = "threads write disjoint columns of one result")]

use super::float::{Float, Half, Single};
use super::format::{COLUMNS, Format, MAX_BATCH, PackedSpan, TILES, TileSums, prefetch_part};
use super::line::{CacheLine, LANES};
use super::packed_tiles::PackedTiles;
use super::quantized::{
    Iq4Nl, Iq4Xs, Mxfp4, Q3K, Q4_0, Q4_1, Q4K, Q5_0, Q5_1, Q5K, Q6K, Q8_0, Q8Of256,
};
use super::results::Columns;
use super::simd::{Instructions, Kernel, Simd};
use super::weight_format::WeightFormat;
use crate::Awake;
use crate::read_ahead;
use crate::values::{clamp, in_parts};
use rayon::prelude::*;
use std::marker::PhantomData;
use std::ops::Range;

/// Maximum bytes of packed activations that one pass over the weights multiplies. Half of it was up
/// to a fourteenth slower on Zen 5, and twice of it no faster.
const MAX_PACKED_BYTES: usize = 2 << 20;

/// Maximum bytes of unpacked weights that many rows are multiplied with, one batch after the other:
/// half of a first-level cache of 48 KiB, which two quantized spans fill, or one of floats.
const MAX_UNPACKED_BYTES: usize = 24 << 10;

/// Numbers of rows that have code of their own. Each takes seconds to compile, in every format and for
/// every instruction set.
const ROWS_AT_ONCE: [usize; 4] = [1, 2, 4, MAX_BATCH];

/// Maximum rows that are multiplied with weights as they are stored: four batches.
/// Why: docs/decisions/141-few-rows-as-stored.md.
const MAX_PACKED_ROWS: usize = 24;

/// Minimum multiplications for which other threads are worth waking: about 20 µs of one core.
const MIN_PARALLEL_PRODUCTS: usize = 1 << 20;
/// The same where a thread is awake: a few µs.
const MIN_AWAKE_PRODUCTS: usize = 1 << 17;

/// Bytes of weights between those that a single row is multiplied with and those that are
/// prefetched. Half and twice of it were slower on Zen 5.
const PREFETCH_BYTES: usize = 8 << 10;

/// Pieces of work for each thread; a slower core takes fewer of them.
const PIECES_PER_THREAD: usize = 4;

/// Writes the products of row-major activations, clamped to bounds, with tiles to columns.
pub(super) fn multiply(
    tiles: &PackedTiles,
    x: &[f32],
    bounds: Option<[f32; 2]>,
    out: &Columns<'_>,
    instructions: Instructions,
) {
    match tiles.weight_format() {
        WeightFormat::F32 => multiply_as::<Float<Single>>(tiles, x, bounds, out, instructions),
        WeightFormat::F16 => multiply_as::<Float<Half>>(tiles, x, bounds, out, instructions),
        WeightFormat::Q8_0 => multiply_as::<Q8_0>(tiles, x, bounds, out, instructions),
        WeightFormat::Q8Of256 => multiply_as::<Q8Of256>(tiles, x, bounds, out, instructions),
        WeightFormat::Q6K => multiply_as::<Q6K>(tiles, x, bounds, out, instructions),
        WeightFormat::Q5_1 => multiply_as::<Q5_1>(tiles, x, bounds, out, instructions),
        WeightFormat::Q5K => multiply_as::<Q5K>(tiles, x, bounds, out, instructions),
        WeightFormat::Q5_0 => multiply_as::<Q5_0>(tiles, x, bounds, out, instructions),
        WeightFormat::Q4_1 => multiply_as::<Q4_1>(tiles, x, bounds, out, instructions),
        WeightFormat::Q4K => multiply_as::<Q4K>(tiles, x, bounds, out, instructions),
        WeightFormat::Iq4Nl => multiply_as::<Iq4Nl>(tiles, x, bounds, out, instructions),
        WeightFormat::Iq4Xs => multiply_as::<Iq4Xs>(tiles, x, bounds, out, instructions),
        WeightFormat::Mxfp4 => multiply_as::<Mxfp4>(tiles, x, bounds, out, instructions),
        WeightFormat::Q4_0 => multiply_as::<Q4_0>(tiles, x, bounds, out, instructions),
        WeightFormat::Q3K => multiply_as::<Q3K>(tiles, x, bounds, out, instructions),
    }
}

fn multiply_as<F: Format>(
    tiles: &PackedTiles,
    x: &[f32],
    bounds: Option<[f32; 2]>,
    out: &Columns<'_>,
    instructions: Instructions,
) {
    let inputs = tiles.inputs();
    let row_words = F::row_words(inputs);
    let batch_rows = instructions.batch();
    let chunk = (MAX_PACKED_BYTES / size_of::<i32>() / row_words / batch_rows).max(1) * batch_rows;
    let threads = rayon::current_num_threads();
    if Awake::is_one_pass() {
        read_ahead::multiplied(tiles.lines(), prefetch);
    }
    // The outer loop is over activations that fit the cache: weights are streamed from memory once
    // a chunk.
    for (index, rows) in x.chunks(chunk * inputs).enumerate() {
        let count = rows.len() / inputs;
        let enough = if Awake::is_anybody() {
            MIN_AWAKE_PRODUCTS
        } else {
            MIN_PARALLEL_PRODUCTS
        };
        let parallel = threads > 1 && count * inputs * tiles.outputs() >= enough;
        let room = with_padding(count, batch_rows) * row_words;
        let pack = |batch: usize, words: &mut [i32]| {
            let first = batch * batch_rows * inputs;
            instructions.run(Pack::<F> {
                inputs,
                rows: &rows[first..rows.len().min(first + batch_rows * inputs)],
                words,
                bounds,
                format: PhantomData,
            });
        };
        let words = if parallel && count > batch_rows {
            in_parts(room, batch_rows * row_words, pack)
        } else {
            let mut words = vec![0; room];
            let batches = words.chunks_mut(batch_rows * row_words).enumerate();
            batches.for_each(|(batch, words)| pack(batch, words));
            words
        };
        let product = |first: usize, lines: &[CacheLine]| {
            instructions.run(Product::<F> {
                inputs,
                lines,
                tile_lines: tiles.tile_lines(),
                words: &words,
                row_words,
                row: index * chunk,
                rows: count,
                first,
                out,
                format: PhantomData,
            });
        };
        let pair = TILES * tiles.tile_lines();
        if parallel {
            let pairs = tiles.lines().len().div_ceil(pair);
            let piece = pairs.div_ceil(threads * PIECES_PER_THREAD);
            let pieces = tiles.lines().par_chunks(piece * pair).enumerate();
            pieces.for_each(|(index, lines)| product(index * piece * COLUMNS, lines));
        } else {
            product(0, tiles.lines());
        }
    }
}

/// Starts to read the cache lines at a range of addresses.
fn prefetch(addresses: Range<usize>) {
    Instructions::best().run(Prefetch(addresses));
}

struct Prefetch(Range<usize>);

impl Kernel for Prefetch {
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        for address in self.0.step_by(size_of::<CacheLine>()) {
            simd.prefetch(std::ptr::without_provenance(address));
        }
    }
}

/// Rows of whole batches. Rows of zeros fill the last one up to a number that has code of its own.
fn with_padding(rows: usize, batch_rows: usize) -> usize {
    let last = rows % batch_rows;
    let filled = ROWS_AT_ONCE.into_iter().find(|at_once| *at_once >= last);
    match last {
        0 => rows,
        last => rows - last + filled.unwrap_or(batch_rows),
    }
}

/// Packs the rows of a batch. The words of rows that are missing are zeros and stay so.
struct Pack<'a, F> {
    inputs: usize,
    rows: &'a [f32],
    words: &'a mut [i32],
    bounds: Option<[f32; 2]>,
    format: PhantomData<F>,
}

impl<F: Format> Kernel for Pack<'_, F> {
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let count = self.rows.len() / self.inputs;
        let filled = self.words.len() / F::row_words(self.inputs);
        let mut padded = vec![0.0; F::SPAN];
        let mut packed = vec![0; filled * F::WORDS];
        // Span by span, since the words of all rows alternate within one.
        let spans = self.words.chunks_mut(filled * F::WORDS).enumerate();
        for (span, words) in spans {
            for (row, packed) in packed.chunks_exact_mut(F::WORDS).enumerate().take(count) {
                let values = &self.rows[row * self.inputs + span * F::SPAN..];
                // The piece that is packed next lies elsewhere.
                let next = if row + 1 < count {
                    values.as_ptr().wrapping_add(self.inputs)
                } else {
                    self.rows.as_ptr().wrapping_add((span + 1) * F::SPAN)
                };
                for line in (0..F::SPAN).step_by(LANES) {
                    simd.prefetch(next.wrapping_add(line).cast());
                }
                let values = &values[..F::SPAN.min(self.inputs - span * F::SPAN)];
                if values.len() == F::SPAN && self.bounds.is_none() {
                    F::pack(simd, values, packed);
                } else {
                    padded[..values.len()].copy_from_slice(values);
                    padded[values.len()..].fill(0.0);
                    if let Some(bounds) = self.bounds {
                        clamp(&mut padded[..values.len()], bounds);
                    }
                    F::pack(simd, &padded, packed);
                }
            }
            if filled == MAX_BATCH {
                alternate::<MAX_BATCH>(&packed, F::WORDS, words);
            } else {
                for (row, packed) in packed.chunks_exact(F::WORDS).enumerate() {
                    for (word, packed) in words[row..].iter_mut().step_by(filled).zip(packed) {
                        *word = *packed;
                    }
                }
            }
        }
    }
}

/// Writes `ROWS` rows of `width` words word by word in turn; the last words of a row may be left
/// out. `ROWS` is a constant, so the compiler moves several words at once.
#[inline(always)]
fn alternate<const ROWS: usize>(rows: &[i32], width: usize, words: &mut [i32]) {
    let mut sources = [&rows[..0]; ROWS];
    for (source, row) in sources.iter_mut().zip(rows.chunks_exact(width)) {
        *source = row;
    }
    for (index, words) in words.as_chunks_mut::<ROWS>().0.iter_mut().enumerate() {
        for (word, source) in words.iter_mut().zip(sources) {
            *word = source[index];
        }
    }
}

/// Multiplies packed rows with consecutive tiles.
struct Product<'a, F> {
    inputs: usize,
    lines: &'a [CacheLine],
    tile_lines: usize,
    words: &'a [i32],
    row_words: usize,
    /// Index of the first row in the result.
    row: usize,
    /// Rows without those that fill the last batch.
    rows: usize,
    /// Column of the first tile in the result.
    first: usize,
    out: &'a Columns<'a>,
    format: PhantomData<F>,
}

impl<F: Format> Product<'_, F> {
    /// Unpacks a span of a pair of tiles.
    #[inline(always)]
    fn unpack<S: Simd>(
        &self,
        simd: S,
        pair: &[CacheLine],
        span: usize,
        blocks: &mut [F::Block; TILES],
    ) {
        for (tile, block) in pair.chunks_exact(self.tile_lines).zip(blocks) {
            let end = self.tile_lines.min((span + 1) * F::LINES);
            F::unpack(simd, &tile[span * F::LINES..end], block);
        }
    }

    /// Multiplies straight from the tiles, batch by batch.
    #[inline(always)]
    fn run_packed<S: Simd>(&self, simd: S) {
        let mut scales = [F::no_scales(), F::no_scales()];
        let scales = &mut scales;
        for (index, pair) in self.lines.chunks(TILES * self.tile_lines).enumerate() {
            let batches = self.words.chunks(S::BATCH * self.row_words).enumerate();
            for (batch, words) in batches {
                let place = (self.row + batch * S::BATCH, self.first + index * COLUMNS);
                if S::BATCH == 1 {
                    self.multiply_pair::<S, 1>(simd, pair, words, scales, place);
                    continue;
                }
                match words.len() / self.row_words {
                    1 => self.multiply_pair::<S, 1>(simd, pair, words, scales, place),
                    2 => self.multiply_pair::<S, 2>(simd, pair, words, scales, place),
                    4 => self.multiply_pair::<S, 4>(simd, pair, words, scales, place),
                    _ => self.multiply_pair::<S, MAX_BATCH>(simd, pair, words, scales, place),
                }
            }
        }
    }

    /// Multiplies a batch with a pair of tiles, and writes the products from a row and column on.
    #[inline(always)]
    fn multiply_pair<S: Simd, const ROWS: usize>(
        &self,
        simd: S,
        pair: &[CacheLine],
        words: &[i32],
        scales: &mut [F::Scales; TILES],
        (row, column): (usize, usize),
    ) {
        let mut sums = [[[0.0; LANES]; TILES]; ROWS];
        let (first, second) = pair.split_at(self.tile_lines);
        // Where the last tile has no other beside it, nobody reads the second sums.
        let second = if second.is_empty() { first } else { second };
        let distance = PREFETCH_BYTES.div_ceil(TILES * F::LINES * size_of::<CacheLine>());
        let whole = self.tile_lines / F::LINES;
        let words = words.chunks(ROWS * F::WORDS).enumerate();
        let lines = first.chunks(F::LINES).zip(second.chunks(F::LINES));
        for ((span, words), lines) in words.zip(lines) {
            // Past the end of a tile, its successor in the next pair follows one tile later.
            let beyond = if span + distance < whole {
                0
            } else {
                self.tile_lines
            };
            let next = distance * F::LINES + beyond;
            let packed = PackedSpan {
                tiles: [lines.0, lines.1],
                ahead: [
                    lines.0.as_ptr().wrapping_add(next),
                    lines.1.as_ptr().wrapping_add(next),
                ],
            };
            let inputs = F::SPAN.min(self.inputs - span * F::SPAN);
            F::multiply_packed(simd, packed, scales, words, inputs, &mut sums);
        }
        let rows = ROWS.min(self.row + self.rows - row);
        // SAFETY: only this thread writes the outputs of these tiles.
        unsafe { self.out.write(simd, row, column, &mut sums[..rows]) };
    }

    /// Multiplies several batches, which share unpacked weights. Beside the products it prefetches what
    /// is unpacked next. Why: docs/decisions/142-weights-of-the-next-group.md.
    #[inline(always)]
    fn run_unpacked<S: Simd>(&self, simd: S) {
        let spans = self.inputs.div_ceil(F::SPAN);
        let step = (MAX_UNPACKED_BYTES / size_of::<[F::Block; TILES]>()).clamp(1, spans);
        let mut blocks = vec![[F::zeros(), F::zeros()]; step];
        let mut sums = vec![[[0.0; LANES]; TILES]; self.words.len() / self.row_words];
        for (index, pair) in self.lines.chunks(TILES * self.tile_lines).enumerate() {
            sums.fill([[0.0; LANES]; TILES]);
            let column = self.first + index * COLUMNS;
            for first in (0..spans).step_by(step) {
                let group = first..spans.min(first + step);
                for (span, blocks) in group.clone().zip(&mut *blocks) {
                    self.unpack(simd, pair, span, blocks);
                }
                // The next group of this pair, or the first of the next pair.
                let next = if group.end < spans {
                    group.end * F::LINES
                } else {
                    TILES * self.tile_lines
                };
                let ahead = pair.as_ptr().wrapping_add(next);
                let ahead = [ahead, ahead.wrapping_add(self.tile_lines)];
                let batches = self.words.chunks(S::BATCH * self.row_words);
                let count = batches.len();
                let batches = batches.zip(sums.chunks_mut(S::BATCH));
                for (batch, (words, sums)) in batches.enumerate() {
                    prefetch_part(simd, ahead, step * F::LINES, batch, count);
                    // Sums and activations of a batch stay in the first-level cache.
                    for (span, blocks) in group.clone().zip(&*blocks) {
                        let start = span * sums.len() * F::WORDS;
                        let end = words.len().min(start + sums.len() * F::WORDS);
                        let inputs = F::SPAN.min(self.inputs - span * F::SPAN);
                        multiply_batch::<F, S>(simd, blocks, &words[start..end], inputs, sums);
                    }
                    if group.end == spans {
                        let row = batch * S::BATCH;
                        let rows = sums.len().min(self.rows - row);
                        // Written here, so that the stores overlap with the next batch.
                        // SAFETY: only this thread writes the outputs of these tiles.
                        unsafe {
                            self.out
                                .write(simd, self.row + row, column, &mut sums[..rows]);
                        }
                    }
                }
            }
        }
    }
}

impl<F: Format> Kernel for Product<'_, F> {
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        if self.rows <= MAX_PACKED_ROWS {
            self.run_packed(simd);
        } else {
            self.run_unpacked(simd);
        }
    }
}

/// Multiplies a batch with a span of `inputs` inputs; `sums` has one entry a row.
#[inline(always)]
fn multiply_batch<F: Format, S: Simd>(
    simd: S,
    blocks: &[F::Block; TILES],
    words: &[i32],
    inputs: usize,
    sums: &mut [TileSums],
) {
    if S::BATCH == 1 {
        for sums in sums.as_chunks_mut::<1>().0 {
            F::multiply(simd, blocks, words, inputs, sums);
        }
    } else if let Ok(sums) = <&mut [TileSums; MAX_BATCH]>::try_from(&mut *sums) {
        F::multiply(simd, blocks, words, inputs, sums);
    } else if let Ok(sums) = <&mut [TileSums; 4]>::try_from(&mut *sums) {
        F::multiply(simd, blocks, words, inputs, sums);
    } else if let Ok(sums) = <&mut [TileSums; 2]>::try_from(&mut *sums) {
        F::multiply(simd, blocks, words, inputs, sums);
    } else if let Ok(sums) = <&mut [TileSums; 1]>::try_from(&mut *sums) {
        F::multiply(simd, blocks, words, inputs, sums);
    }
}
