//! Activations in eight bits.

use super::super::line::LANES;
use super::super::simd::{Instructions, Kernel, Simd};
use super::{MAX_MAGNITUDE, SPAN, SUMMED};
use crate::values::clamp;
use rayon::prelude::*;

/// Rounds activations, whole vectors, to multiples of a scale. Writes the numbers and the sums of
/// every sixteen, and returns the scale. A NaN or an infinity makes the scale NaN, so that the result
/// shows it.
#[inline(always)]
pub(super) fn quantize_activations<S: Simd>(
    simd: S,
    values: &[f32],
    numbers: &mut [i8],
    sums: &mut [i32],
) -> f32 {
    const { assert!(SUMMED == LANES) };
    let (values, _) = values.as_chunks::<LANES>();
    let zero = simd.floats(0.0);
    let (mut largest, mut strange) = (zero, zero);
    for values in values {
        let values = simd.load(values);
        let negative = simd.mul(values, simd.floats(-1.0));
        largest = simd.max(largest, simd.max(values, negative));
        // NaN for NaN and infinity, which a maximum may lose.
        strange = simd.mul_add(values, zero, strange);
    }
    let largest = simd.max_lane(largest);
    let is_finite = simd.sum(strange).is_finite();
    let scale = if is_finite {
        largest / MAX_MAGNITUDE
    } else {
        f32::NAN
    };
    // Infinite for zeros, and for numbers that are zeros beside their scale.
    let inverse = Some(MAX_MAGNITUDE / largest).filter(|inverse| is_finite && inverse.is_finite());
    let inverse = simd.floats(inverse.unwrap_or(0.0));
    let numbers = numbers.as_chunks_mut().0.iter_mut();
    for ((values, numbers), sum) in values.iter().zip(numbers).zip(sums) {
        let rounded = simd.to_ints(simd.mul(simd.load(values), inverse));
        simd.store_low_bytes(rounded, numbers);
        *sum = simd.sum_ints(rounded);
    }
    scale
}

/// What rounding takes from rows of `inputs` activations, clamped to bounds, of which `scaled` share
/// a scale.
pub(in crate::matrix) fn lost_by_rounding(
    rows: &[f32],
    bounds: Option<[f32; 2]>,
    inputs: usize,
    scaled: usize,
) -> Vec<f32> {
    let mut lost = rows.to_vec();
    if let Some(bounds) = bounds {
        clamp(&mut lost, bounds);
    }
    let parts = lost
        .par_chunks_mut(inputs)
        .flat_map_iter(|row| row.chunks_mut(scaled));
    parts.for_each(|part| Instructions::best().run(Loss { part, scaled }));
    lost
}

/// Takes the rounded number from each number of a part.
struct Loss<'a> {
    part: &'a mut [f32],
    scaled: usize,
}

impl Kernel for Loss<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self { part, scaled } = self;
        // Zeros follow the end of a row, as in the product.
        let (mut filled, mut numbers) = ([0.0; SPAN], [0; SPAN]);
        let mut sums = [0; SPAN / SUMMED];
        filled[..part.len()].copy_from_slice(part);
        let (filled, rounded) = (&filled[..scaled], &mut numbers[..scaled]);
        let scale = quantize_activations(simd, filled, rounded, &mut sums);
        for (value, number) in part.iter_mut().zip(numbers) {
            *value -= f32::from(number) * scale;
        }
    }
}
