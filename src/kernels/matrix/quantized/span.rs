//! The products of a span of quantized weights with a batch of rows, run by run.

use super::super::format::{PackedSpan, TILES, TileSums, prefetch_part, take_all_tiles};
use super::super::line::CacheLine;
use super::super::simd::Simd;
use super::{Block, MAX_MAGNITUDE, Minima, Quantized, SPAN, STEPS, Scales, float};
use std::hint::black_box;

/// Where the numbers of a span come from. A trait and not closures. A closure that is not inlined
/// is compiled without the vector instructions of its caller, which made decoding five times
/// slower. For the same reason vectors are never mapped as arrays.
pub(super) trait Numbers<Q: Quantized>: Sized {
    /// Whether they are unpacked in each step. Which bits a step takes is then decided by its run.
    const PACKED: bool;
    /// The same numbers at an address that the compiler does not know. Else it loads the lines that
    /// runs share before the first run, more than the registers hold.
    #[must_use]
    fn opaque(&self) -> Self;
    /// Called before each run of numbers that share a scale.
    fn begin<S: Simd>(&self, simd: S, run: usize);
    /// The numbers of a step of a tile.
    fn step<S: Simd>(&self, simd: S, tile: usize, step: usize) -> S::Bytes;
}

/// Blocks that were unpacked before, for many rows.
pub(super) struct Unpacked<'a>(pub(super) &'a [Block; TILES]);

impl<Q: Quantized> Numbers<Q> for Unpacked<'_> {
    const PACKED: bool = false;

    #[inline(always)]
    fn opaque(&self) -> Self {
        Self(black_box(self.0))
    }

    #[inline(always)]
    fn begin<S: Simd>(&self, _: S, _: usize) {}

    #[inline(always)]
    fn step<S: Simd>(&self, simd: S, tile: usize, step: usize) -> S::Bytes {
        simd.bytes(&self.0[tile].numbers[step])
    }
}

impl<Q: Quantized> Numbers<Q> for PackedSpan<'_> {
    const PACKED: bool = true;

    #[inline(always)]
    fn opaque(&self) -> Self {
        // Their number stays known.
        let [first, second] = self.tiles;
        let tiles = [
            &black_box(first)[..first.len()],
            &black_box(second)[..second.len()],
        ];
        Self { tiles, ..*self }
    }

    #[inline(always)]
    fn begin<S: Simd>(&self, simd: S, run: usize) {
        prefetch_part(simd, self.ahead, Q::LINES, run, SPAN / Q::RUN);
    }

    #[inline(always)]
    fn step<S: Simd>(&self, simd: S, tile: usize, step: usize) -> S::Bytes {
        Q::numbers(simd, self.tiles[tile], step)
    }
}

/// Adds the products of the first `inputs` of a span with `ROWS` rows to their sums.
#[inline(always)]
pub(super) fn add_products<Q: Quantized, S: Simd, N: Numbers<Q>, const ROWS: usize>(
    simd: S,
    unpacked: [&Scales; TILES],
    numbers: &N,
    words: &[i32],
    inputs: usize,
    sums: &mut [TileSums; ROWS],
) {
    let (rows, _) = words.as_chunks::<ROWS>();
    let (activations, rest) = rows.split_at(STEPS);
    let (run_sums, scales) = rest.split_at(Q::SUM_WORDS);
    // One function, so that these sums stay in registers over all runs. What depends on `Q` and `S`
    // is decided at compile time.
    let mut spans = [[simd.floats(0.0); TILES]; ROWS];
    let (steps, runs) = (Q::RUN / 4, inputs.div_ceil(Q::RUN));
    /// Adds a run.
    macro_rules! add {
        ($numbers:expr, $index:expr, $activations:expr) => {
            let numbers = $numbers;
            let run = Run {
                index: $index,
                activations: $activations,
                sums: run_sums,
                scales,
            };
            numbers.begin(simd, $index);
            if const { take_all_tiles::<S, ROWS>() } {
                add_run::<Q, S, N, ROWS, TILES>(simd, unpacked, numbers, &run, 0, &mut spans);
            } else {
                for tile in 0..TILES {
                    add_run::<Q, S, N, ROWS, 1>(simd, unpacked, numbers, &run, tile, &mut spans);
                }
            }
        };
    }
    /// Adds some runs one by one, so that the compiler knows the number of each, and with it the bits
    /// that it takes. Why: docs/decisions/150-runs-one-by-one.md.
    macro_rules! add_each {
        ($($index:literal)*) => {
            $(if $index < const { SPAN / Q::RUN } && $index < runs {
                add!(&numbers.opaque(), $index, &activations[$index * steps..][..steps]);
            })*
        };
    }
    if const { Q::RUN == SPAN } {
        add!(numbers, 0, &activations[..inputs.div_ceil(4).min(steps)]);
    } else if const { N::PACKED && ROWS == 1 && S::REGISTERS > 16 } {
        add_each!(0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15);
    } else {
        for (index, activations) in activations.chunks_exact(steps).enumerate().take(runs) {
            add!(numbers, index, activations);
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

/// Steps whose products fit in a sum of bytes, at least one.
const fn steps_at_once<Q: Quantized, S: Simd>() -> usize {
    let of_a_step = 2 * Q::LARGEST * MAX_MAGNITUDE as i32;
    let (fitting, steps) = ((S::LARGEST_SUM / of_a_step) as usize, Q::RUN / 4);
    assert!(fitting > 0);
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
            // A scale of the span is applied once, behind all runs.
            *span = if Q::SCALED < SPAN {
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
