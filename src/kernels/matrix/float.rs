//! Products of f16 and f32 weights with f32 activations, summed in f32.

use super::format::{Format, PackedSpan, TILES, TileSums, prefetch_part};
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
        let mut totals = [[simd.floats(0.0); TILES]; ROWS];
        let rows = words.as_chunks::<ROWS>().0.iter().take(inputs);
        for ((activations, first), second) in rows.zip(&blocks[0]).zip(&blocks[1]) {
            let weights = [simd.load(first), simd.load(second)];
            for (totals, activation) in totals.iter_mut().zip(activations) {
                let activation = simd.floats(f32::from_bits(activation.cast_unsigned()));
                for (total, weights) in totals.iter_mut().zip(weights) {
                    *total = simd.mul_add(activation, weights, *total);
                }
            }
        }
        for (sums, totals) in sums.iter_mut().zip(totals) {
            for (sum, total) in sums.iter_mut().zip(totals) {
                simd.store(simd.add(simd.load(sum), total), sum);
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
        let mut totals = [[simd.floats(0.0); TILES]; ROWS];
        let rows = words.as_chunks::<ROWS>().0;
        let lines = span.tiles[0].iter().zip(span.tiles[1]);
        for (part, (rows, lines)) in rows.chunks(W::NUMBERS).zip(lines).enumerate() {
            prefetch_part(simd, span.ahead, Self::LINES, part, Self::LINES);
            for (index, activations) in rows.iter().enumerate() {
                let weights = [W::load(simd, lines.0, index), W::load(simd, lines.1, index)];
                // By index: with iterators, five rows and more would not stay in registers.
                for row in 0..ROWS {
                    let activation = simd.floats(f32::from_bits(activations[row].cast_unsigned()));
                    for tile in 0..TILES {
                        totals[row][tile] =
                            simd.mul_add(activation, weights[tile], totals[row][tile]);
                    }
                }
            }
        }
        for (sums, totals) in sums.iter_mut().zip(totals) {
            for (sum, total) in sums.iter_mut().zip(totals) {
                simd.store(simd.add(simd.load(sum), total), sum);
            }
        }
    }
}
