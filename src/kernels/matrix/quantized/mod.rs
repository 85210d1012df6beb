//! Products of quantized weights: byte products, summed in integers within a scale's range.
//!
//! Activations are quantized to eight bits as ggml does it: with one scale a span for k-quants
//! (`block_q8_K`), with one scale a run for the others (`block_q8_0`, `block_q8_1`).

mod k_quants;
mod runs_of_32;
mod tables;

pub(super) use k_quants::{Q3K, Q4K, Q5K, Q6K};
pub(super) use runs_of_32::{Q4_0, Q4_1, Q5_0, Q5_1, Q8_0};
pub(super) use tables::{Iq4Nl, Iq4Xs, Mxfp4};

use super::format::{Format, PackedSpan, TILES, TileSums, prefetch_part, take_all_tiles};
use super::line::{CacheLine, LANES};
use super::simd::Simd;
use rayon::prelude::*;

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
    fn pack<S: Simd>(_: S, values: &[f32], words: &mut [i32]) {
        let (packed, rest) = words.split_at_mut(STEPS);
        let (sum_words, scales) = rest.split_at_mut(Q::SUM_WORDS);
        let mut numbers = [0; SPAN];
        let parts = numbers
            .chunks_exact_mut(Q::SCALED)
            .zip(values.chunks_exact(Q::SCALED));
        for (scale, (numbers, values)) in scales.iter_mut().zip(parts) {
            *scale = quantize_activations(values, numbers)
                .to_bits()
                .cast_signed();
        }
        let mut sums = [0; SPAN / SUMMED];
        for (sum, numbers) in sums.iter_mut().zip(numbers.as_chunks::<SUMMED>().0) {
            *sum = numbers.iter().map(|number| i32::from(*number)).sum();
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
        let runs = inputs.div_ceil(Q::RUN);
        add_products::<Q, S, Unpacked<'_>, ROWS>(
            simd,
            blocks.each_ref().map(|block| &block.scales),
            &Unpacked(blocks),
            words,
            runs,
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
        let runs = inputs.div_ceil(Q::RUN);
        if tiles[0].len().min(tiles[1].len()) == Self::LINES && runs == SPAN / Q::RUN {
            // The compiler then knows the lengths, and tests no bounds below.
            let tiles = [&tiles[0][..Self::LINES], &tiles[1][..Self::LINES]];
            let packed = PackedSpan { tiles, ahead };
            multiply_lines::<Q, S, ROWS>(simd, packed, scales, words, SPAN / Q::RUN, sums);
        } else {
            multiply_lines::<Q, S, ROWS>(simd, span, scales, words, runs, sums);
        }
    }
}

/// Adds the products of the first `runs` of a span, as it is stored, to the sums of the rows.
#[inline(always)]
fn multiply_lines<Q: Quantized, S: Simd, const ROWS: usize>(
    simd: S,
    span: PackedSpan<'_>,
    scales: &mut [Scales; TILES],
    words: &[i32],
    runs: usize,
    sums: &mut [TileSums; ROWS],
) {
    for (lines, scales) in span.tiles.into_iter().zip(&mut *scales) {
        Q::unpack_scales(simd, lines, scales);
    }
    let [first, second] = scales;
    add_products::<Q, S, PackedSpan<'_>, ROWS>(simd, [first, second], &span, words, runs, sums);
}

/// Where the numbers of a span come from. A trait and not closures. A closure that is not inlined
/// is compiled without the vector instructions of its caller, which made decoding five times
/// slower. For the same reason vectors are never mapped as arrays.
trait Numbers<Q: Quantized> {
    /// Called before each run of numbers that share a scale.
    fn begin<S: Simd>(&self, simd: S, run: usize);
    /// The numbers of a step of a tile.
    fn step<S: Simd>(&self, simd: S, tile: usize, step: usize) -> S::Bytes;
}

/// Blocks that were unpacked before, for many rows.
struct Unpacked<'a>(&'a [Block; TILES]);

impl<Q: Quantized> Numbers<Q> for Unpacked<'_> {
    #[inline(always)]
    fn begin<S: Simd>(&self, _: S, _: usize) {}

    #[inline(always)]
    fn step<S: Simd>(&self, simd: S, tile: usize, step: usize) -> S::Bytes {
        simd.bytes(&self.0[tile].numbers[step])
    }
}

impl<Q: Quantized> Numbers<Q> for PackedSpan<'_> {
    #[inline(always)]
    fn begin<S: Simd>(&self, simd: S, run: usize) {
        prefetch_part(simd, self.ahead, Q::LINES, run, SPAN / Q::RUN);
    }

    #[inline(always)]
    fn step<S: Simd>(&self, simd: S, tile: usize, step: usize) -> S::Bytes {
        Q::numbers(simd, self.tiles[tile], step)
    }
}

/// Adds the products of the first `runs` of a span with `ROWS` rows to their sums.
#[inline(always)]
fn add_products<Q: Quantized, S: Simd, N: Numbers<Q>, const ROWS: usize>(
    simd: S,
    unpacked: [&Scales; TILES],
    numbers: &N,
    words: &[i32],
    runs: usize,
    sums: &mut [TileSums; ROWS],
) {
    let (rows, _) = words.as_chunks::<ROWS>();
    let (activations, rest) = rows.split_at(STEPS);
    let (run_sums, scales) = rest.split_at(Q::SUM_WORDS);
    // One function, so that these sums stay in registers over all runs. What depends on `Q` and `S`
    // is decided at compile time.
    let mut spans = [[simd.floats(0.0); TILES]; ROWS];
    let steps = Q::RUN / 4;
    for (index, activations) in activations.chunks_exact(steps).enumerate().take(runs) {
        numbers.begin(simd, index);
        let run = Run {
            index,
            activations,
            sums: run_sums,
            scales,
        };
        if const { take_all_tiles::<S, ROWS>() } {
            add_run::<Q, S, N, ROWS, TILES>(simd, unpacked, numbers, &run, 0, &mut spans);
        } else {
            for tile in 0..TILES {
                add_run::<Q, S, N, ROWS, 1>(simd, unpacked, numbers, &run, tile, &mut spans);
            }
        }
    }
    if Q::MINIMA == Minima::Scaled {
        let mut products = [[simd.ints(0); TILES]; ROWS];
        for (pair, sums) in run_sums.iter().enumerate() {
            let mut minima = [simd.ints(0); TILES];
            for (minima, unpacked) in minima.iter_mut().zip(unpacked) {
                *minima = simd.load_ints(&unpacked.minima[pair]);
            }
            for (products, sum) in products.iter_mut().zip(sums) {
                for (product, minima) in products.iter_mut().zip(minima) {
                    *product = simd.dot_pairs(*product, minima, *sum);
                }
            }
        }
        let mut scales = [simd.floats(0.0); TILES];
        for (scale, unpacked) in scales.iter_mut().zip(unpacked) {
            *scale = simd.load(&unpacked.minimum_scale);
        }
        for (span, products) in spans.iter_mut().zip(products) {
            for ((span, product), scale) in span.iter_mut().zip(products).zip(scales) {
                *span = simd.mul_sub_from(simd.to_floats(product), scale, *span);
            }
        }
    }
    for (row, (sums, span)) in sums.iter_mut().zip(spans).enumerate() {
        let scale = simd.floats(if Q::SCALED == SPAN {
            float(scales[0][row])
        } else {
            1.0
        });
        for (sum, span) in sums.iter_mut().zip(span) {
            simd.store(simd.mul_add(span, scale, simd.load(sum)), sum);
        }
    }
}

/// Numbers that share a scale, with all rows.
struct Run<'a, const ROWS: usize> {
    index: usize,
    /// Of this run alone, one word of each row a step.
    activations: &'a [[i32; ROWS]],
    /// Words of activation sums, of the whole span.
    sums: &'a [[i32; ROWS]],
    /// Scales of the activations, of the whole span.
    scales: &'a [[i32; ROWS]],
}

impl<const ROWS: usize> Run<'_, ROWS> {
    /// What the products of part `part` are added to.
    #[inline(always)]
    fn before<Q: Quantized, S: Simd>(
        &self,
        simd: S,
        part: usize,
        row: usize,
        products: S::Ints,
    ) -> S::Ints {
        if part == 0 && Q::MINIMA == Minima::None {
            Q::start(simd, self.sums[self.index][row])
        } else {
            products
        }
    }
}

/// Steps whose products fit in a sum of bytes.
const fn steps_at_once<Q: Quantized, S: Simd>() -> usize {
    let of_a_step = 2 * Q::LARGEST * MAX_MAGNITUDE as i32;
    let (fitting, steps) = ((S::LARGEST_SUM / of_a_step) as usize, Q::RUN / 4);
    if fitting < steps { fitting } else { steps }
}

/// Adds the products of a run with `AT_ONCE` tiles, from tile `first` on, to the sums of a span.
#[inline(always)]
fn add_run<Q: Quantized, S: Simd, N: Numbers<Q>, const ROWS: usize, const AT_ONCE: usize>(
    simd: S,
    unpacked: [&Scales; TILES],
    numbers: &N,
    run: &Run<'_, ROWS>,
    first: usize,
    spans: &mut [[S::Floats; TILES]; ROWS],
) {
    let mut products = [[simd.ints(0); AT_ONCE]; ROWS];
    let at_once = const { steps_at_once::<Q, S>() };
    let mut step = run.index * (Q::RUN / 4);
    for (part, activations) in run.activations.chunks(at_once).enumerate() {
        let mut sums = [[simd.begin_dots(simd.ints(0)); AT_ONCE]; ROWS];
        // What sums continue is found here and again at the end. Each instruction set needs it at
        // one of the two, so it takes no register between them.
        for (row, (sums, products)) in sums.iter_mut().zip(&products).enumerate() {
            for (sum, product) in sums.iter_mut().zip(products) {
                *sum = simd.begin_dots(run.before::<Q, S>(simd, part, row, *product));
            }
        }
        for activations in activations {
            let mut weights = [simd.bytes(&CacheLine::ZERO); AT_ONCE];
            for (tile, weights) in (first..).zip(&mut weights) {
                *weights = numbers.step(simd, tile, step);
            }
            for (sums, activations) in sums.iter_mut().zip(activations) {
                for (sum, weights) in sums.iter_mut().zip(weights) {
                    *sum = Q::dot(simd, *sum, weights, *activations);
                }
            }
            step += 1;
        }
        for (row, (products, sums)) in products.iter_mut().zip(sums).enumerate() {
            for (product, sum) in products.iter_mut().zip(sums) {
                *product = simd.end_dots(run.before::<Q, S>(simd, part, row, *product), sum);
            }
        }
    }
    let tiles = first..first + AT_ONCE;
    let mut weight_scales = [simd.floats(0.0); AT_ONCE];
    for (scale, unpacked) in weight_scales.iter_mut().zip(&unpacked[tiles.clone()]) {
        *scale = simd.load(&unpacked.runs[run.index]);
    }
    for (row, (spans, products)) in spans.iter_mut().zip(products).enumerate() {
        let spans = spans[tiles.clone()].iter_mut();
        for ((span, product), weight_scale) in spans.zip(products).zip(weight_scales) {
            let product = simd.to_floats(product);
            *span = if Q::SCALED == Q::RUN {
                let scale = simd.floats(float(run.scales[run.index][row]));
                simd.mul_add(simd.mul(product, scale), weight_scale, *span)
            } else {
                simd.mul_add(product, weight_scale, *span)
            };
        }
    }
    if Q::MINIMA == Minima::Floats {
        let mut minima = [simd.floats(0.0); AT_ONCE];
        for (minimum, unpacked) in minima.iter_mut().zip(&unpacked[tiles.clone()]) {
            *minimum = simd.load(&unpacked.float_minima[run.index]);
        }
        for (spans, sum) in spans.iter_mut().zip(&run.sums[run.index]) {
            let sum = simd.floats(float(*sum));
            for (span, minimum) in spans[tiles.clone()].iter_mut().zip(minima) {
                *span = simd.mul_add(minimum, sum, *span);
            }
        }
    }
}

/// The f32 whose bits a word holds.
#[inline(always)]
fn float(word: i32) -> f32 {
    f32::from_bits(word.cast_unsigned())
}

/// Rounds activations to multiples of a scale and returns the scale. Their number is a multiple of
/// sixteen. A NaN or an infinity makes the scale NaN, so that the result shows it.
#[inline(always)]
fn quantize_activations(values: &[f32], numbers: &mut [i8]) -> f32 {
    // The bits of magnitudes are in the order of the magnitudes, with infinity and NaN on top.
    const INFINITY: u32 = f32::INFINITY.to_bits();
    // Added to a small number, it leaves the nearest integer, ties to even, in the lowest bits.
    const ROUNDING: f32 = 1.5 * (1 << 23) as f32;
    let mut largest = [0; LANES];
    for values in values.as_chunks::<LANES>().0 {
        for (largest, value) in largest.iter_mut().zip(values) {
            *largest = value.abs().to_bits().max(*largest);
        }
    }
    let largest = largest.into_iter().fold(0, u32::max);
    let scale = if largest < INFINITY {
        f32::from_bits(largest) / MAX_MAGNITUDE
    } else {
        f32::NAN
    };
    let inverse = if largest > 0 {
        MAX_MAGNITUDE / f32::from_bits(largest)
    } else {
        0.0
    };
    for (numbers, values) in numbers
        .as_chunks_mut::<LANES>()
        .0
        .iter_mut()
        .zip(values.as_chunks::<LANES>().0)
    {
        // Two loops, because the compiler does not vectorize one.
        let mut rounded = [0; LANES];
        for (rounded, value) in rounded.iter_mut().zip(values) {
            *rounded = (value * inverse + ROUNDING).to_bits();
        }
        for (number, rounded) in numbers.iter_mut().zip(rounded) {
            *number = rounded as i8;
        }
    }
    scale
}

/// What rounding takes from rows of `inputs` activations, of which `scaled` share a scale.
pub(super) fn lost_by_rounding(rows: &[f32], inputs: usize, scaled: usize) -> Vec<f32> {
    let mut lost = rows.to_vec();
    let parts = lost
        .par_chunks_mut(inputs)
        .flat_map_iter(|row| row.chunks_mut(scaled));
    parts.for_each(|part| {
        // Zeros follow the end of a row, as in the product.
        let (mut filled, mut numbers) = ([0.0; SPAN], [0; SPAN]);
        filled[..part.len()].copy_from_slice(part);
        let scale = quantize_activations(&filled[..scaled], &mut numbers[..scaled]);
        for (value, number) in part.iter_mut().zip(numbers) {
            *value -= f32::from(number) * scale;
        }
    });
    lost
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
