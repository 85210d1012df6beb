//! Products of quantized weights: byte products, summed in integers within a scale's range.
//!
//! Activations are quantized to eight bits as ggml does it: with one scale a span for k-quants
//! (`block_q8_K`), with one scale a run for the others (`block_q8_0`, `block_q8_1`).

mod k_quants;
mod rounding;
mod run_of_256;
mod runs_of_32;
mod span;
mod tables;

pub(super) use k_quants::{Q3K, Q4K, Q5K, Q6K};
pub(super) use rounding::lost_by_rounding;
pub(super) use run_of_256::Q8Of256;
pub(super) use runs_of_32::{Q4_0, Q4_1, Q5_0, Q5_1, Q8_0};
pub(super) use tables::{Iq4Nl, Iq4Xs, Mxfp4};

use super::format::{Format, PackedSpan, TILES, TileSums};
use super::line::{CacheLine, LANES};
use super::simd::Simd;
use rounding::quantize_activations;
use span::{Unpacked, add_products};

/// Numbers in a span: a block of the k-quants.
const SPAN: usize = 256;
/// Groups of four bytes in a span.
const STEPS: usize = SPAN / 4;
/// Activations in a partial sum: the length of the shortest run with its own scale.
const SUMMED: usize = 16;
/// Largest magnitude of a quantized activation.
const MAX_MAGNITUDE: f32 = 127.0;
/// Largest magnitude of a number that [`Simd::dot_biased`] multiplies.
const LARGEST_BIASED: i32 = 128;

/// Unpacked weights of sixteen outputs in a span.
#[derive(Debug, Clone)]
pub(super) struct Block {
    /// Unsigned bytes, four of each output a cache line.
    numbers: [CacheLine; STEPS],
    scales: Scales,
}

/// Unpacked scales and minima of sixteen outputs in a span.
#[derive(Debug, Clone)]
pub(super) struct Scales {
    /// Scale of each run.
    runs: [[f32; LANES]; SPAN / SUMMED],
    /// Minima of [`Minima::Scaled`]: that of each run, two runs in an `i32`.
    minima: [[i32; LANES]; 4],
    /// Their scale.
    minimum_scale: [f32; LANES],
    /// Minima of [`Minima::Floats`].
    float_minima: [[f32; LANES]; SPAN / 32],
}

/// What is added to the scaled numbers of a run.
#[derive(PartialEq, Eq)]
enum Minima {
    None,
    /// A whole number, times a scale of the span; it is subtracted. A word of activation sums has
    /// two runs.
    Scaled,
    /// A float. A word of activation sums is an f32, with the scale of its activations.
    Floats,
}

/// −128 times the sum of a run's activations: corrects for weights that are 128 too large
/// ([`Simd::biased_start`]).
fn correction(sums: &[i32; SPAN / SUMMED], run: usize) -> i32 {
    -128 * run_sum(sums, run)
}

/// The sum of the activations of a run of 32.
fn run_sum(sums: &[i32; SPAN / SUMMED], run: usize) -> i32 {
    sums[2 * run] + sums[2 * run + 1]
}

/// The differences between the quantized formats.
trait Quantized {
    /// Cache lines of a tile in a span.
    const LINES: usize;
    /// Numbers that share a scale.
    const RUN: usize;
    /// Words of activation sums in a span: one for each run, or for two runs with
    /// [`Minima::Scaled`].
    const SUM_WORDS: usize;
    const MINIMA: Minima;
    /// Activations that share a scale: a run, or the span.
    const SCALED: usize;
    /// Largest magnitude of a number in [`Self::dot`].
    const LARGEST: i32;

    /// Word `index` of the activation sums, from the sums of every [`SUMMED`] activations, and from
    /// the bits of their scales.
    fn sum_word(sums: &[i32; SPAN / SUMMED], scales: &[i32], index: usize) -> i32;
    /// The numbers of a step: four of each output, unsigned bytes. `lines` may end early: then
    /// zeros.
    fn numbers<S: Simd>(simd: S, lines: &[CacheLine], step: usize) -> S::Bytes;
    /// Unpacks scales and minima. `lines` may end early: then zeros.
    fn unpack_scales<S: Simd>(simd: S, lines: &[CacheLine], unpacked: &mut Scales);

    /// The value that the sum of a run without minima starts from; `word` is its word of activation
    /// sums.
    #[inline(always)]
    fn start<S: Simd>(simd: S, word: i32) -> S::Ints {
        simd.ints(word)
    }

    /// Adds the products of four numbers of each output.
    #[inline(always)]
    fn dot<S: Simd>(simd: S, sum: S::ByteSums, weights: S::Bytes, activations: i32) -> S::ByteSums {
        simd.dot(sum, weights, activations)
    }
}

impl<Q: Quantized> Format for Q {
    const SPAN: usize = SPAN;
    const LINES: usize = <Q as Quantized>::LINES;
    /// Numbers, sums, scales.
    const WORDS: usize = STEPS + Q::SUM_WORDS + SPAN / Q::SCALED;
    type Block = Block;
    type Scales = Scales;

    fn zeros() -> Block {
        Block {
            numbers: [CacheLine::ZERO; STEPS],
            scales: Self::no_scales(),
        }
    }

    fn no_scales() -> Scales {
        Scales {
            runs: [[0.0; LANES]; SPAN / SUMMED],
            minima: [[0; LANES]; 4],
            minimum_scale: [0.0; LANES],
            float_minima: [[0.0; LANES]; SPAN / 32],
        }
    }

    #[inline(always)]
    fn pack<S: Simd>(simd: S, values: &[f32], words: &mut [i32]) {
        let (packed, rest) = words.split_at_mut(STEPS);
        let (sum_words, scales) = rest.split_at_mut(Q::SUM_WORDS);
        let (mut numbers, mut sums) = ([0; SPAN], [0; SPAN / SUMMED]);
        let parts = numbers
            .chunks_exact_mut(Q::SCALED)
            .zip(sums.chunks_exact_mut(Q::SCALED / SUMMED))
            .zip(values.chunks_exact(Q::SCALED));
        for (scale, ((numbers, sums), values)) in scales.iter_mut().zip(parts) {
            *scale = quantize_activations(simd, values, numbers, sums)
                .to_bits()
                .cast_signed();
        }
        for (word, bytes) in packed.iter_mut().zip(numbers.as_chunks::<4>().0) {
            *word = i32::from_le_bytes(bytes.map(i8::cast_unsigned));
        }
        for (index, word) in sum_words.iter_mut().enumerate() {
            *word = Q::sum_word(&sums, scales, index);
        }
    }

    #[inline(always)]
    fn unpack<S: Simd>(simd: S, lines: &[CacheLine], block: &mut Block) {
        for (step, numbers) in block.numbers.iter_mut().enumerate() {
            simd.store_bytes(Q::numbers(simd, lines, step), numbers);
        }
        Q::unpack_scales(simd, lines, &mut block.scales);
    }

    #[inline(always)]
    fn multiply<S: Simd, const ROWS: usize>(
        simd: S,
        blocks: &[Block; TILES],
        words: &[i32],
        inputs: usize,
        sums: &mut [TileSums; ROWS],
    ) {
        add_products::<Q, S, Unpacked<'_>, ROWS>(
            simd,
            blocks.each_ref().map(|block| &block.scales),
            &Unpacked(blocks),
            words,
            inputs,
            sums,
        );
    }

    #[inline(always)]
    fn multiply_packed<S: Simd, const ROWS: usize>(
        simd: S,
        span: PackedSpan<'_>,
        scales: &mut [Scales; TILES],
        words: &[i32],
        inputs: usize,
        sums: &mut [TileSums; ROWS],
    ) {
        let PackedSpan { tiles, ahead } = span;
        if tiles[0].len().min(tiles[1].len()) == Self::LINES && inputs == SPAN {
            // The compiler then knows the lengths, and tests no bounds below.
            let tiles = [&tiles[0][..Self::LINES], &tiles[1][..Self::LINES]];
            let packed = PackedSpan { tiles, ahead };
            multiply_lines::<Q, S, ROWS>(simd, packed, scales, words, SPAN, sums);
        } else {
            multiply_lines::<Q, S, ROWS>(simd, span, scales, words, inputs, sums);
        }
    }
}

/// Adds the products of the first `inputs` of a span, as it is stored, to the sums of the rows.
#[inline(always)]
fn multiply_lines<Q: Quantized, S: Simd, const ROWS: usize>(
    simd: S,
    span: PackedSpan<'_>,
    scales: &mut [Scales; TILES],
    words: &[i32],
    inputs: usize,
    sums: &mut [TileSums; ROWS],
) {
    for (lines, scales) in span.tiles.into_iter().zip(&mut *scales) {
        Q::unpack_scales(simd, lines, scales);
    }
    let [first, second] = scales;
    add_products::<Q, S, PackedSpan<'_>, ROWS>(simd, [first, second], &span, words, inputs, sums);
}

/// The f32 whose bits a word holds.
#[inline(always)]
fn float(word: i32) -> f32 {
    f32::from_bits(word.cast_unsigned())
}

/// Adds bit `bit` of the bytes of `high` to four-bit numbers.
#[inline(always)]
fn with_fifth_bit<S: Simd>(simd: S, four: S::Bytes, high: S::Bytes, bit: usize) -> S::Bytes {
    match bit {
        0 => simd.with_high_bits::<0, 0x10>(four, high),
        1 => simd.with_high_bits::<1, 0x10>(four, high),
        2 => simd.with_high_bits::<2, 0x10>(four, high),
        3 => simd.with_high_bits::<3, 0x10>(four, high),
        4 => simd.with_high_bits::<4, 0x10>(four, high),
        5 => simd.with_high_bits::<5, 0x10>(four, high),
        6 => simd.with_high_bits::<6, 0x10>(four, high),
        _ => simd.with_high_bits::<7, 0x10>(four, high),
    }
}
