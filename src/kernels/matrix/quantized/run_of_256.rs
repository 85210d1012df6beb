//! 8 bits a number with one scale a span: a product converts and scales its sums once a span.

use super::super::line::CacheLine;
use super::super::simd::Simd;
use super::{LARGEST_BIASED, Minima, Quantized, SPAN, STEPS, SUMMED, Scales};

/// w = scale · number, with a scale for every 256.
/// Why: docs/decisions/151-one-scale-for-256.md.
#[derive(Debug, Clone, Copy)]
pub(in crate::matrix) struct Q8Of256;

impl Quantized for Q8Of256 {
    /// Numbers, and half a line of scales.
    const LINES: usize = STEPS + 1;
    const RUN: usize = SPAN;
    const SUM_WORDS: usize = 1;
    const MINIMA: Minima = Minima::None;
    const SCALED: usize = SPAN;
    const LARGEST: i32 = LARGEST_BIASED;

    /// Corrects for weights that are 128 too large.
    #[inline(always)]
    fn sum_word(sums: &[i32; SPAN / SUMMED], _: &[i32], _: usize) -> i32 {
        -128 * sums.iter().sum::<i32>()
    }

    #[inline(always)]
    fn numbers<S: Simd>(simd: S, lines: &[CacheLine], step: usize) -> S::Bytes {
        simd.bytes(lines.get(step).unwrap_or(&CacheLine::ZERO))
    }

    #[inline(always)]
    fn unpack_scales<S: Simd>(simd: S, lines: &[CacheLine], unpacked: &mut Scales) {
        let scales = lines.get(STEPS).unwrap_or(&CacheLine::ZERO);
        simd.store(simd.load_half(&scales.halves(0)), &mut unpacked.runs[0]);
    }

    #[inline(always)]
    fn start<S: Simd>(simd: S, word: i32) -> S::Ints {
        simd.biased_start(word)
    }

    #[inline(always)]
    fn dot<S: Simd>(simd: S, sum: S::ByteSums, weights: S::Bytes, activations: i32) -> S::ByteSums {
        simd.dot_biased(sum, weights, activations)
    }
}
