//! Formats whose four bits choose from a table of signed bytes.

use super::super::line::{CacheLine, LANES};
use super::super::simd::Simd;
use super::super::stored_format::{IQ4, MXFP4, MXFP4_BIAS};
use super::{LARGEST_BIASED, Minima, Q4_0, Quantized, SPAN, SUMMED, Scales, correction};

/// A table for byte products, which take 128 more than a number.
const fn biased(table: &[i8; 16]) -> [u8; 16] {
    let mut biased = [0; 16];
    let mut index = 0;
    while index < 16 {
        biased[index] = table[index].cast_unsigned() ^ 0x80;
        index += 1;
    }
    biased
}

/// The tables of ggml's `iq4_nl` and of `mxfp4`, as the products take them.
const BIASED_IQ4: [u8; 16] = biased(&IQ4);
const BIASED_MXFP4: [u8; 16] = biased(&MXFP4);

/// ggml's `iq4_nl`: w = scale · table of the number, with a scale for every 32. Its bytes lie as
/// those of `q4_0`.
#[derive(Debug, Clone, Copy)]
pub(in crate::matrix) struct Iq4Nl;

impl Quantized for Iq4Nl {
    const LINES: usize = <Q4_0 as Quantized>::LINES;
    const RUN: usize = 32;
    const SUM_WORDS: usize = 8;
    const MINIMA: Minima = Minima::None;
    const SCALED: usize = 32;
    const LARGEST: i32 = LARGEST_BIASED;

    #[inline(always)]
    fn sum_word(sums: &[i32; SPAN / SUMMED], _: &[i32], index: usize) -> i32 {
        correction(sums, index)
    }

    #[inline(always)]
    fn numbers<S: Simd>(simd: S, lines: &[CacheLine], step: usize) -> S::Bytes {
        simd.lookup(<Q4_0 as Quantized>::numbers(simd, lines, step), &BIASED_IQ4)
    }

    #[inline(always)]
    fn unpack_scales<S: Simd>(simd: S, lines: &[CacheLine], unpacked: &mut Scales) {
        <Q4_0 as Quantized>::unpack_scales(simd, lines, unpacked);
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

/// ggml's `iq4_xs`: w = d · (scale − 32) · table of the number, with a scale for every 32.
#[derive(Debug, Clone, Copy)]
pub(in crate::matrix) struct Iq4Xs;

impl Iq4Xs {
    /// Lines of the numbers of a block.
    const NUMBERS: usize = 32;
}

impl Quantized for Iq4Xs {
    /// Numbers, d and the high bits of the scales, their low bits.
    const LINES: usize = Self::NUMBERS + 1 + 1;
    const RUN: usize = 32;
    const SUM_WORDS: usize = 8;
    const MINIMA: Minima = Minima::None;
    const SCALED: usize = SPAN;
    const LARGEST: i32 = LARGEST_BIASED;

    #[inline(always)]
    fn sum_word(sums: &[i32; SPAN / SUMMED], _: &[i32], index: usize) -> i32 {
        correction(sums, index)
    }

    #[inline(always)]
    fn numbers<S: Simd>(simd: S, lines: &[CacheLine], step: usize) -> S::Bytes {
        let line = lines.get(step / 8 * 4 + step % 4);
        let both = simd.bytes(line.unwrap_or(&CacheLine::ZERO));
        let four = if step % 8 < 4 {
            simd.low(both)
        } else {
            simd.high(both)
        };
        simd.lookup(four, &BIASED_IQ4)
    }

    #[inline(always)]
    fn unpack_scales<S: Simd>(simd: S, lines: &[CacheLine], unpacked: &mut Scales) {
        let Some(lines) = lines.first_chunk::<34>() else {
            return;
        };
        let [d, high] = [0, 1].map(|half| lines[Self::NUMBERS].halves(half));
        let d = simd.load_half(&d);
        for (run, scales) in unpacked.runs.iter_mut().take(8).enumerate() {
            let low = lines[Self::NUMBERS + 1].quarter(run / 2);
            let mut factors = [0.0; LANES];
            for ((factor, low), high) in factors.iter_mut().zip(low).zip(high) {
                let low = i32::from(low) >> (run % 2 * 4) & 15;
                *factor = (low | (i32::from(high) >> (2 * run) & 3) << 4) as f32 - 32.0;
            }
            simd.store(simd.mul(d, simd.load(&factors)), scales);
        }
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

/// ggml's `mxfp4`: w = 2ⁿ · table of the number, with a byte for n for every 32 (OCP Microscaling).
#[derive(Debug, Clone, Copy)]
pub(in crate::matrix) struct Mxfp4;

impl Mxfp4 {
    /// Lines of four runs: their numbers and their exponents.
    const GROUP_LINES: usize = 4 * 4 + 1;

    #[inline(always)]
    fn line(lines: &[CacheLine], run: usize, index: usize) -> &CacheLine {
        lines
            .get(run / 4 * Self::GROUP_LINES + index)
            .unwrap_or(&CacheLine::ZERO)
    }
}

impl Quantized for Mxfp4 {
    const LINES: usize = 2 * Self::GROUP_LINES;
    const RUN: usize = 32;
    const SUM_WORDS: usize = 8;
    const MINIMA: Minima = Minima::None;
    const SCALED: usize = 32;
    const LARGEST: i32 = LARGEST_BIASED;

    #[inline(always)]
    fn sum_word(sums: &[i32; SPAN / SUMMED], _: &[i32], index: usize) -> i32 {
        correction(sums, index)
    }

    #[inline(always)]
    fn numbers<S: Simd>(simd: S, lines: &[CacheLine], step: usize) -> S::Bytes {
        let (run, step) = (step / 8, step % 8);
        let both = simd.bytes(Self::line(lines, run, run % 4 * 4 + step % 4));
        let four = if step < 4 {
            simd.low(both)
        } else {
            simd.high(both)
        };
        simd.lookup(four, &BIASED_MXFP4)
    }

    /// Exponents below those of normal numbers become the smallest of them: the weights stay below
    /// 10⁻³⁶.
    #[inline(always)]
    fn unpack_scales<S: Simd>(simd: S, lines: &[CacheLine], unpacked: &mut Scales) {
        for (run, scales) in unpacked.runs.iter_mut().take(8).enumerate() {
            let exponents = Self::line(lines, run, Self::GROUP_LINES - 1).quarter(run % 4);
            let n = simd.to_floats(simd.load_unsigned(&exponents));
            let n = simd.add(n, simd.floats(-MXFP4_BIAS as f32));
            let n = simd.max(n, simd.floats(-126.0));
            simd.store(simd.two_to_the(n), scales);
        }
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
