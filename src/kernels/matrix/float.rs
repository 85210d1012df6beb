//! Products of f16 and f32 weights with f32 activations, summed in f32.

use super::format::{Format, PackedSpan, TILES, TileSums, prefetch_part, take_all_tiles};
use super::line::{CacheLine, LANES};
use super::simd::Simd;
use std::marker::PhantomData;

/// Numbers in a span: the unpacked spans of two tiles fill half of a 32 KiB first-level cache. Each
/// span has sums of its own, so that long rows round less.
/// Why: docs/decisions/120-f32-weights-in-tiles.md.
const SPAN: usize = 128;

/// The differences between the floating-point formats.
pub(super) trait Width {
    /// Numbers of each output in a cache line.
    const NUMBERS: usize;
    /// Number `index` of each output.
    fn load<S: Simd>(simd: S, line: &CacheLine, index: usize) -> S::Floats;
}

/// IEEE half precision.
#[derive(Debug, Clone, Copy)]
pub(super) struct Half;

impl Width for Half {
    const NUMBERS: usize = 2;

    #[inline(always)]
    fn load<S: Simd>(simd: S, line: &CacheLine, index: usize) -> S::Floats {
        simd.load_half(&line.halves(index))
    }
}

/// IEEE single precision.
#[derive(Debug, Clone, Copy)]
pub(super) struct Single;

impl Width for Single {
    const NUMBERS: usize = 1;

    #[inline(always)]
    fn load<S: Simd>(simd: S, line: &CacheLine, _: usize) -> S::Floats {
        simd.load(&line.singles())
    }
}

/// Floating-point weights of one width.
#[derive(Debug, Clone, Copy)]
pub(super) struct Float<W>(PhantomData<W>);

impl<W: Width> Format for Float<W> {
    const SPAN: usize = SPAN;
    const LINES: usize = SPAN / W::NUMBERS;
    const WORDS: usize = SPAN;
    type Block = [[f32; LANES]; SPAN];
    type Scales = ();

    fn row_words(inputs: usize) -> usize {
        inputs
    }

    fn zeros() -> Self::Block {
        [[0.0; LANES]; SPAN]
    }

    fn no_scales() {}

    #[inline(always)]
    fn pack<S: Simd>(_: S, values: &[f32], words: &mut [i32]) {
        for (word, value) in words.iter_mut().zip(values) {
            *word = value.to_bits().cast_signed();
        }
    }

    #[inline(always)]
    fn unpack<S: Simd>(simd: S, lines: &[CacheLine], block: &mut Self::Block) {
        for (numbers, line) in block.chunks_exact_mut(W::NUMBERS).zip(lines) {
            for (index, numbers) in numbers.iter_mut().enumerate() {
                simd.store(W::load(simd, line, index), numbers);
            }
        }
        // Past the end of a row the activations are zero, but values left from an earlier row may
        // be infinite.
        for numbers in block.iter_mut().skip(lines.len() * W::NUMBERS) {
            *numbers = [0.0; LANES];
        }
    }

    #[inline(always)]
    fn multiply<S: Simd, const ROWS: usize>(
        simd: S,
        blocks: &[Self::Block; TILES],
        words: &[i32],
        inputs: usize,
        sums: &mut [TileSums; ROWS],
    ) {
        let rows = &words.as_chunks::<ROWS>().0[..inputs];
        if const { take_all_tiles::<S, ROWS>() } {
            multiply_tiles::<S, ROWS, TILES>(simd, blocks, rows, 0, sums);
        } else {
            for tile in 0..TILES {
                multiply_tiles::<S, ROWS, 1>(simd, blocks, rows, tile, sums);
            }
        }
    }

    #[inline(always)]
    fn multiply_packed<S: Simd, const ROWS: usize>(
        simd: S,
        span: PackedSpan<'_>,
        _: &mut [(); TILES],
        words: &[i32],
        _: usize,
        sums: &mut [TileSums; ROWS],
    ) {
        let rows = words.as_chunks::<ROWS>().0;
        if const { take_all_tiles::<S, ROWS>() } {
            multiply_lines::<W, S, ROWS, TILES>(simd, span, rows, 0, sums);
        } else {
            for tile in 0..TILES {
                multiply_lines::<W, S, ROWS, 1>(simd, span, rows, tile, sums);
            }
        }
    }
}

/// Adds the products of a span with `AT_ONCE` tiles, from tile `first` on, to their sums.
#[inline(always)]
fn multiply_tiles<S: Simd, const ROWS: usize, const AT_ONCE: usize>(
    simd: S,
    blocks: &[[[f32; LANES]; SPAN]; TILES],
    rows: &[[i32; ROWS]],
    first: usize,
    sums: &mut [TileSums; ROWS],
) {
    let mut totals = [[simd.floats(0.0); AT_ONCE]; ROWS];
    // The first and the last tile, which may be the same.
    let numbers = blocks[first].iter().zip(&blocks[first + AT_ONCE - 1]);
    for (activations, numbers) in rows.iter().zip(numbers) {
        let mut weights = [simd.load(numbers.0); AT_ONCE];
        weights[AT_ONCE - 1] = simd.load(numbers.1);
        add_products(simd, &weights, activations, &mut totals);
    }
    add_totals(simd, &totals, first, sums);
}

/// As [`multiply_tiles`], straight from the packed lines.
#[inline(always)]
fn multiply_lines<W: Width, S: Simd, const ROWS: usize, const AT_ONCE: usize>(
    simd: S,
    span: PackedSpan<'_>,
    rows: &[[i32; ROWS]],
    first: usize,
    sums: &mut [TileSums; ROWS],
) {
    let mut totals = [[simd.floats(0.0); AT_ONCE]; ROWS];
    let parts = SPAN / W::NUMBERS;
    // The first and the last tile, which may be the same.
    let lines = span.tiles[first]
        .iter()
        .zip(span.tiles[first + AT_ONCE - 1]);
    for (part, (rows, lines)) in rows.chunks(W::NUMBERS).zip(lines).enumerate() {
        if first == 0 {
            prefetch_part(simd, span.ahead, parts, part, parts);
        }
        for (index, activations) in rows.iter().enumerate() {
            let mut weights = [W::load(simd, lines.0, index); AT_ONCE];
            weights[AT_ONCE - 1] = W::load(simd, lines.1, index);
            add_products(simd, &weights, activations, &mut totals);
        }
    }
    add_totals(simd, &totals, first, sums);
}

/// Adds the products of an input.
#[inline(always)]
fn add_products<S: Simd, const ROWS: usize, const AT_ONCE: usize>(
    simd: S,
    weights: &[S::Floats; AT_ONCE],
    activations: &[i32; ROWS],
    totals: &mut [[S::Floats; AT_ONCE]; ROWS],
) {
    // By index: with iterators, five rows and more would not stay in registers.
    for row in 0..ROWS {
        let activation = simd.floats(f32::from_bits(activations[row].cast_unsigned()));
        for tile in 0..AT_ONCE {
            totals[row][tile] = simd.mul_add(activation, weights[tile], totals[row][tile]);
        }
    }
}

/// Adds the totals of a span to the sums.
#[inline(always)]
fn add_totals<S: Simd, const ROWS: usize, const AT_ONCE: usize>(
    simd: S,
    totals: &[[S::Floats; AT_ONCE]; ROWS],
    first: usize,
    sums: &mut [TileSums; ROWS],
) {
    for (sums, totals) in sums.iter_mut().zip(totals) {
        for (sum, total) in sums[first..].iter_mut().zip(totals) {
            simd.store(simd.add(simd.load(sum), *total), sum);
        }
    }
}
