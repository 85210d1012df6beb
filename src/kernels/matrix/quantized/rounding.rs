//! Activations in eight bits.

use super::super::line::LANES;
use super::{MAX_MAGNITUDE, SPAN};
use rayon::prelude::*;

/// Rounds activations to multiples of a scale and returns the scale. Their number is a multiple of
/// sixteen. A NaN or an infinity makes the scale NaN, so that the result shows it.
#[inline(always)]
pub(super) fn quantize_activations(values: &[f32], numbers: &mut [i8]) -> f32 {
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
pub(in crate::matrix) fn lost_by_rounding(rows: &[f32], inputs: usize, scaled: usize) -> Vec<f32> {
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
