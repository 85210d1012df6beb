//! Products of f16 weights with f32 activations, summed in f32.

use super::format::{Format, TILES, TileSums, prefetch_part};
use super::line::{CacheLine, LANES};
use super::simd::Simd;

/// Numbers in a span: the unpacked spans of two tiles fill half of a 32 KiB first-level cache.
const SPAN: usize = 128;

/// IEEE half precision; a cache line holds two numbers of each output.
#[derive(Debug, Clone, Copy)]
pub(super) struct F16;

impl Format for F16 {
    const SPAN: usize = SPAN;
    const LINES: usize = SPAN / 2;
    const WORDS: usize = SPAN;
    type Block = [[f32; LANES]; SPAN];

    fn zeros() -> Self::Block {
        [[0.0; LANES]; SPAN]
    }

    #[inline(always)]
    fn pack<S: Simd>(_: S, values: &[f32], words: &mut [i32]) {
        for (word, value) in words.iter_mut().zip(values) {
            *word = value.to_bits().cast_signed();
        }
    }

    #[inline(always)]
    fn unpack<S: Simd>(simd: S, lines: &[CacheLine], block: &mut Self::Block) {
        let (pairs, _) = block.as_chunks_mut::<2>();
        for (numbers, line) in pairs.iter_mut().zip(lines) {
            for (half, numbers) in numbers.iter_mut().enumerate() {
                simd.store(simd.load_half(&line.halves(half)), numbers);
            }
        }
        // Past the end of a row the activations are zero, but values left from an earlier row may be infinite.
        for numbers in &mut pairs[lines.len()..] {
            *numbers = [[0.0; LANES]; 2];
        }
    }

    #[inline(always)]
    fn multiply<S: Simd, const ROWS: usize>(
        simd: S,
        blocks: &[Self::Block; TILES],
        words: &[i32],
        sums: &mut [TileSums; ROWS],
    ) {
        let mut totals = [[simd.floats(0.0); TILES]; ROWS];
        for (totals, sums) in totals.iter_mut().zip(&*sums) {
            for (total, sum) in totals.iter_mut().zip(sums) {
                *total = simd.load(sum);
            }
        }
        for ((activations, first), second) in words.as_chunks::<ROWS>().0.iter().zip(&blocks[0]).zip(&blocks[1]) {
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
                simd.store(total, sum);
            }
        }
    }

    #[inline(always)]
    fn multiply_row<S: Simd>(
        simd: S,
        tiles: [&[CacheLine]; TILES],
        ahead: [*const CacheLine; TILES],
        _: &mut [Self::Block; TILES],
        words: &[i32],
        sums: &mut TileSums,
    ) {
        let mut totals = [simd.load(&sums[0]), simd.load(&sums[1])];
        let pairs = words.as_chunks::<2>().0.iter().zip(tiles[0]).zip(tiles[1]);
        for (index, ((activations, first), second)) in pairs.enumerate() {
            prefetch_part(simd, ahead, Self::LINES, index, Self::LINES);
            for (half, activation) in activations.iter().enumerate() {
                let activation = simd.floats(f32::from_bits(activation.cast_unsigned()));
                for (total, line) in totals.iter_mut().zip([first, second]) {
                    *total = simd.mul_add(activation, simd.load_half(&line.halves(half)), *total);
                }
            }
        }
        for (sum, total) in sums.iter_mut().zip(totals) {
            simd.store(total, sum);
        }
    }
}
