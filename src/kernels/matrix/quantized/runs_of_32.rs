//! ggml's blocks of 32 numbers, each with a scale of 16 bits.

use super::super::line::CacheLine;
use super::super::simd::Simd;
use super::{
    LARGEST_BIASED, Minima, Quantized, SPAN, SUMMED, Scales, correction, float, run_sum,
    with_fifth_bit,
};

/// ggml's `q8_0`: w = scale · number, with a scale for every 32.
#[derive(Debug, Clone, Copy)]
pub(in crate::matrix) struct Q8_0;

impl Quantized for Q8_0 {
    /// Four groups of two blocks of eight lines and one with their scales.
    const LINES: usize = 4 * 17;
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
        simd.bytes(
            lines
                .get(step / 16 * 17 + step % 16)
                .unwrap_or(&CacheLine::ZERO),
        )
    }

    #[inline(always)]
    fn unpack_scales<S: Simd>(simd: S, lines: &[CacheLine], unpacked: &mut Scales) {
        for run in 0..8 {
            let scales = lines.get(run / 2 * 17 + 16).unwrap_or(&CacheLine::ZERO);
            simd.store(
                simd.load_half(&scales.halves(run % 2)),
                &mut unpacked.runs[run],
            );
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

/// Four or five bits a number, `FIFTH` of them in a line of their own. w = scale · (number − half
/// of their range), or, with a `MINIMUM`, w = scale · number + minimum.
#[derive(Debug, Clone, Copy)]
pub(in crate::matrix) struct FewBits<const FIFTH: usize, const MINIMUM: bool>;

pub(in crate::matrix) type Q4_0 = FewBits<0, false>;
pub(in crate::matrix) type Q4_1 = FewBits<0, true>;
pub(in crate::matrix) type Q5_0 = FewBits<1, false>;
pub(in crate::matrix) type Q5_1 = FewBits<1, true>;

impl<const FIFTH: usize, const MINIMUM: bool> FewBits<FIFTH, MINIMUM> {
    /// Runs in a group: scales of two runs fill a cache line, as do a scale and a minimum of one.
    const GROUP: usize = if MINIMUM { 1 } else { 2 };
    /// Cache lines of a group: numbers, their fifth bits, scales and minima.
    const GROUP_LINES: usize = Self::GROUP * (4 + FIFTH) + 1;

    /// Line `index` of a run's group; zeros behind the end.
    #[inline(always)]
    fn line(lines: &[CacheLine], run: usize, index: usize) -> &CacheLine {
        lines
            .get(run / Self::GROUP * Self::GROUP_LINES + index)
            .unwrap_or(&CacheLine::ZERO)
    }
}

impl<const FIFTH: usize, const MINIMUM: bool> Quantized for FewBits<FIFTH, MINIMUM> {
    const LINES: usize = 8 / Self::GROUP * Self::GROUP_LINES;
    const RUN: usize = 32;
    const SUM_WORDS: usize = 8;
    const MINIMA: Minima = if MINIMUM {
        Minima::Floats
    } else {
        Minima::None
    };
    const SCALED: usize = 32;
    const LARGEST: i32 = (16 << FIFTH) - 1;

    #[inline(always)]
    fn sum_word(sums: &[i32; SPAN / SUMMED], scales: &[i32], index: usize) -> i32 {
        let sum = run_sum(sums, index);
        if MINIMUM {
            (sum as f32 * float(scales[index])).to_bits().cast_signed()
        } else {
            -(8 << FIFTH) * sum
        }
    }

    /// The low halves of 16 bytes hold the first numbers of a run, the high halves the others.
    #[inline(always)]
    fn numbers<S: Simd>(simd: S, lines: &[CacheLine], step: usize) -> S::Bytes {
        let (run, step) = (step / 8, step % 8);
        let place = run % Self::GROUP;
        let both = simd.bytes(Self::line(lines, run, 4 * place + step % 4));
        let four = if step < 4 {
            simd.low(both)
        } else {
            simd.high(both)
        };
        if FIFTH == 0 {
            return four;
        }
        with_fifth_bit(
            simd,
            four,
            simd.bytes(Self::line(lines, run, 4 * Self::GROUP + place)),
            step,
        )
    }

    #[inline(always)]
    fn unpack_scales<S: Simd>(simd: S, lines: &[CacheLine], unpacked: &mut Scales) {
        for run in 0..8 {
            let halves = Self::line(lines, run, Self::GROUP_LINES - 1);
            simd.store(
                simd.load_half(&halves.halves(run % Self::GROUP)),
                &mut unpacked.runs[run],
            );
            if MINIMUM {
                simd.store(
                    simd.load_half(&halves.halves(1)),
                    &mut unpacked.float_minima[run],
                );
            }
        }
    }
}
