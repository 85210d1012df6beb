//! ggml's k-quants: blocks of 256 numbers, whose runs have scales of few bits.

use super::super::line::CacheLine;
use super::super::simd::Simd;
use super::{Minima, Quantized, SPAN, SUMMED, Scales, run_sum, with_fifth_bit};

/// ggml's `q6_k`: w = d · scale · (number − 32), with a scale for every 16.
#[derive(Debug, Clone, Copy)]
pub(in crate::matrix) struct Q6K;

impl Quantized for Q6K {
    /// Low bits, high bits, scales, d.
    const LINES: usize = 32 + 16 + 4 + 1;
    const RUN: usize = 16;
    const SUM_WORDS: usize = 16;
    const MINIMA: Minima = Minima::None;
    const SCALED: usize = SPAN;
    const LARGEST: i32 = 63;

    #[inline(always)]
    fn sum_word(sums: &[i32; SPAN / SUMMED], _: &[i32], index: usize) -> i32 {
        -32 * sums[index]
    }

    #[inline(always)]
    fn numbers<S: Simd>(simd: S, lines: &[CacheLine], step: usize) -> S::Bytes {
        let Some(lines) = lines.first_chunk::<53>() else {
            return simd.bytes(&CacheLine::ZERO);
        };
        let (part, run, step) = (step / 32, step / 8 % 4, step % 8);
        let high = simd.bytes(&lines[32 + 8 * part + step]);
        let low = simd.bytes(&lines[16 * part + run % 2 * 8 + step]);
        match run {
            0 => simd.with_high_bits::<0, 0x30>(simd.low(low), high),
            1 => simd.with_high_bits::<2, 0x30>(simd.low(low), high),
            2 => simd.with_high_bits::<4, 0x30>(simd.high(low), high),
            _ => simd.with_high_bits::<6, 0x30>(simd.high(low), high),
        }
    }

    #[inline(always)]
    fn unpack_scales<S: Simd>(simd: S, lines: &[CacheLine], unpacked: &mut Scales) {
        let Some(lines) = lines.first_chunk::<53>() else {
            return;
        };
        let scale = simd.load_half(&lines[52].halves(0));
        for (run, scales) in unpacked.runs.iter_mut().enumerate() {
            simd.store(
                simd.mul(
                    scale,
                    simd.load_signed(&lines[48 + run / 4].quarter(run % 4)),
                ),
                scales,
            );
        }
    }
}

/// ggml's `q5_k`: as [`Q4K`], with five bits.
#[derive(Debug, Clone, Copy)]
pub(in crate::matrix) struct Q5K;

impl Quantized for Q5K {
    /// Low bits, high bits, d and dmin, scales and minima of six bits.
    const LINES: usize = 32 + 8 + 1 + 3;
    const RUN: usize = 32;
    const SUM_WORDS: usize = 4;
    const MINIMA: Minima = Minima::Scaled;
    const SCALED: usize = SPAN;
    const LARGEST: i32 = 31;

    #[inline(always)]
    fn sum_word(sums: &[i32; SPAN / SUMMED], _: &[i32], index: usize) -> i32 {
        Q4K::sum_word(sums, &[], index)
    }

    #[inline(always)]
    fn numbers<S: Simd>(simd: S, lines: &[CacheLine], step: usize) -> S::Bytes {
        let Some(lines) = lines.first_chunk::<44>() else {
            return simd.bytes(&CacheLine::ZERO);
        };
        let both = simd.bytes(&lines[step / 16 * 8 + step % 8]);
        let high = simd.bytes(&lines[32 + step % 8]);
        let four = if (step / 8).is_multiple_of(2) {
            simd.low(both)
        } else {
            simd.high(both)
        };
        with_fifth_bit(simd, four, high, step / 8)
    }

    #[inline(always)]
    fn unpack_scales<S: Simd>(simd: S, lines: &[CacheLine], unpacked: &mut Scales) {
        let Some(lines) = lines.first_chunk::<44>() else {
            return;
        };
        unpack_six_bits(
            simd,
            [&lines[40], &lines[41], &lines[42], &lines[43]],
            unpacked,
        );
    }
}

/// ggml's `q4_k`: w = d · scale · number − dmin · minimum, with a scale and a minimum for every 32.
#[derive(Debug, Clone, Copy)]
pub(in crate::matrix) struct Q4K;

impl Quantized for Q4K {
    /// Numbers, d and dmin, scales and minima of six bits.
    const LINES: usize = 32 + 1 + 3;
    const RUN: usize = 32;
    const SUM_WORDS: usize = 4;
    const MINIMA: Minima = Minima::Scaled;
    const SCALED: usize = SPAN;
    const LARGEST: i32 = 15;

    #[inline(always)]
    fn sum_word(sums: &[i32; SPAN / SUMMED], _: &[i32], index: usize) -> i32 {
        run_sum(sums, 2 * index) & 0xffff | run_sum(sums, 2 * index + 1) << 16
    }

    #[inline(always)]
    fn numbers<S: Simd>(simd: S, lines: &[CacheLine], step: usize) -> S::Bytes {
        let Some(lines) = lines.first_chunk::<36>() else {
            return simd.bytes(&CacheLine::ZERO);
        };
        let both = simd.bytes(&lines[step / 16 * 8 + step % 8]);
        if (step / 8).is_multiple_of(2) {
            simd.low(both)
        } else {
            simd.high(both)
        }
    }

    #[inline(always)]
    fn unpack_scales<S: Simd>(simd: S, lines: &[CacheLine], unpacked: &mut Scales) {
        let Some(lines) = lines.first_chunk::<36>() else {
            return;
        };
        unpack_six_bits(
            simd,
            [&lines[32], &lines[33], &lines[34], &lines[35]],
            unpacked,
        );
    }
}

/// ggml's `q3_k`: w = d · scale · (number − 4), with a scale of six bits for every 16.
#[derive(Debug, Clone, Copy)]
pub(in crate::matrix) struct Q3K;

impl Quantized for Q3K {
    /// Low two bits, third bits, scales, d.
    const LINES: usize = 16 + 8 + 3 + 1;
    const RUN: usize = 16;
    const SUM_WORDS: usize = 16;
    const MINIMA: Minima = Minima::None;
    const SCALED: usize = SPAN;
    const LARGEST: i32 = 28;

    #[inline(always)]
    fn sum_word(sums: &[i32; SPAN / SUMMED], _: &[i32], index: usize) -> i32 {
        -16 * sums[index]
    }

    /// Four times the numbers: their bits can be moved to there in one step.
    #[inline(always)]
    fn numbers<S: Simd>(simd: S, lines: &[CacheLine], step: usize) -> S::Bytes {
        let zeros = simd.bytes(&CacheLine::ZERO);
        let Some(lines) = lines.first_chunk::<28>() else {
            return zeros;
        };
        let (part, run, step) = (step / 32, step / 8, step % 8);
        let low = simd.bytes(&lines[8 * part + step]);
        let two = match run % 4 {
            0 => simd.with_high_bits::<2, 0x0c>(zeros, low),
            1 => simd.with_high_bits::<4, 0x0c>(zeros, low),
            2 => simd.with_high_bits::<6, 0x0c>(zeros, low),
            _ => simd.with_high_bits::<8, 0x0c>(zeros, low),
        };
        with_fifth_bit(simd, two, simd.bytes(&lines[16 + step]), run)
    }

    #[inline(always)]
    fn unpack_scales<S: Simd>(simd: S, lines: &[CacheLine], unpacked: &mut Scales) {
        let Some(lines) = lines.first_chunk::<28>() else {
            return;
        };
        let quarter = simd.mul(simd.load_half(&lines[27].halves(0)), simd.floats(0.25));
        let two = simd.bytes(&lines[26]);
        let [even, odd] = [simd.bytes(&lines[24]), simd.bytes(&lines[25])];
        let mut scales = [CacheLine::ZERO; 4];
        let [first, second, third, fourth] = &mut scales;
        simd.store_bytes(simd.with_high_bits::<0, 0x30>(simd.low(even), two), first);
        simd.store_bytes(simd.with_high_bits::<2, 0x30>(simd.low(odd), two), second);
        simd.store_bytes(simd.with_high_bits::<4, 0x30>(simd.high(even), two), third);
        simd.store_bytes(simd.with_high_bits::<6, 0x30>(simd.high(odd), two), fourth);
        for (run, out) in unpacked.runs.iter_mut().enumerate() {
            let scale = simd.to_floats(simd.load_unsigned(&scales[run / 4].quarter(run % 4)));
            let scale = simd.add(scale, simd.floats(-32.0));
            simd.store(simd.mul(quarter, scale), out);
        }
    }
}

/// Unpacks d, dmin, and the eight scales and minima of six bits.
#[inline(always)]
fn unpack_six_bits<S: Simd>(
    simd: S,
    [halves, first, second, third]: [&CacheLine; 4],
    unpacked: &mut Scales,
) {
    let (first, second, third) = (simd.bytes(first), simd.bytes(second), simd.bytes(third));
    // ggml's order: scales 4 to 7 keep their upper two bits in the spare bits of scales 0 to 3.
    let (mut scales, mut minima) = ([CacheLine::ZERO; 2], [CacheLine::ZERO; 2]);
    simd.store_bytes(
        simd.with_high_bits::<4, 0x30>(simd.low(first), first),
        &mut scales[0],
    );
    simd.store_bytes(
        simd.with_high_bits::<6, 0x30>(simd.low(third), first),
        &mut scales[1],
    );
    simd.store_bytes(
        simd.with_high_bits::<4, 0x30>(simd.low(second), second),
        &mut minima[0],
    );
    simd.store_bytes(
        simd.with_high_bits::<6, 0x30>(simd.high(third), second),
        &mut minima[1],
    );
    let scale = simd.load_half(&halves.halves(0));
    let of_run = |lines: &[CacheLine; 2], run: usize| lines[run / 4].quarter(run % 4);
    for (run, out) in unpacked.runs[..8].iter_mut().enumerate() {
        let scales = simd.to_floats(simd.load_unsigned(&of_run(&scales, run)));
        simd.store(simd.mul(scale, scales), out);
    }
    for (pair, out) in unpacked.minima.iter_mut().enumerate() {
        let [low, high] = [2 * pair, 2 * pair + 1].map(|run| of_run(&minima, run));
        simd.store_ints(
            simd.pair(simd.load_unsigned(&low), simd.load_unsigned(&high)),
            out,
        );
    }
    simd.store(
        simd.load_half(&halves.halves(1)),
        &mut unpacked.minimum_scale,
    );
}
