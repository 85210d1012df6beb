//! Decodes ggml's blocks number by number: to read rows of an embedding, and as the reference of the kernels' tests.
//!
//! Formats: ggml, `ggml-common.h` and `ggml-quants.c`.

use half::f16;

use super::weight_format::WeightFormat;

/// Decodes the blocks of a row until `out` is full.
pub(super) fn decode_row(weight_format: WeightFormat, bytes: &[u8], out: &mut [f32]) {
    let blocks = bytes.chunks_exact(weight_format.block_bytes());
    match weight_format {
        WeightFormat::F32 => {
            for (value, bytes) in out.iter_mut().zip(bytes.as_chunks::<4>().0) {
                *value = f32::from_le_bytes(*bytes);
            }
        }
        WeightFormat::F16 => {
            for (value, bytes) in out.iter_mut().zip(bytes.as_chunks::<2>().0) {
                *value = f16::from_le_bytes(*bytes).to_f32();
            }
        }
        WeightFormat::Q8_0 => blocks.zip(out.chunks_exact_mut(32)).for_each(|(block, out)| q8_0(block, out)),
        WeightFormat::Q6K => blocks.zip(out.chunks_exact_mut(256)).for_each(|(block, out)| q6_k(block, out)),
        WeightFormat::Q4K => blocks.zip(out.chunks_exact_mut(256)).for_each(|(block, out)| q4_k(block, out)),
    }
}

fn half(bytes: &[u8]) -> f32 {
    bytes.first_chunk().map_or(0.0, |bytes| f16::from_le_bytes(*bytes).to_f32())
}

/// Scale, then 32 signed bytes.
fn q8_0(block: &[u8], out: &mut [f32]) {
    let (scale, numbers) = block.split_at(2);
    let scale = half(scale);
    for (value, number) in out.iter_mut().zip(numbers) {
        *value = scale * f32::from(number.cast_signed());
    }
}

/// 128 bytes of low four bits, 64 bytes of high two bits, 16 signed scales, then the scale of the scales. Each half of the
/// numbers takes 64 and 32 of these bytes for four runs of 32 numbers.
fn q6_k(block: &[u8], out: &mut [f32]) {
    let (low, rest) = block.split_at(128);
    let (high, rest) = rest.split_at(64);
    let (scales, scale) = rest.split_at(16);
    let scale = half(scale);
    for (index, value) in out.iter_mut().enumerate() {
        let (part, run, lane) = (index / 128, index / 32 % 4, index % 32);
        let low = low[64 * part + 32 * (run % 2) + lane] >> (4 * (run / 2)) & 15;
        let high = high[32 * part + lane] >> (2 * run) & 3;
        let number = i16::from(low | high << 4) - 32;
        *value = scale * f32::from(scales[index / 16].cast_signed()) * f32::from(number);
    }
}

/// Scale of the scales, scale of the minima, 12 bytes with eight scales and minima of six bits, then 128 bytes of two
/// numbers each. Every 32 of those bytes hold a run of 32 numbers in their low halves and the next run in their high halves.
fn q4_k(block: &[u8], out: &mut [f32]) {
    let (head, numbers) = block.split_at(16);
    let (scale, minimum, packed) = (half(head), half(&head[2..]), &head[4..]);
    for (run, out) in out.chunks_exact_mut(32).enumerate() {
        let (factor, offset) = scale_and_minimum(packed, run);
        let (scale, minimum) = (scale * f32::from(factor), minimum * f32::from(offset));
        for (value, byte) in out.iter_mut().zip(&numbers[32 * (run / 2)..]) {
            *value = scale * f32::from(byte >> (4 * (run % 2)) & 15) - minimum;
        }
    }
}

/// The six-bit scale and minimum of a run of 32 (`get_scale_min_k4`).
fn scale_and_minimum(packed: &[u8], run: usize) -> (u8, u8) {
    if run < 4 {
        return (packed[run] & 63, packed[run + 4] & 63);
    }
    let scale = packed[run + 4] & 15 | packed[run - 4] >> 6 << 4;
    let minimum = packed[run + 4] >> 4 | packed[run] >> 6 << 4;
    (scale, minimum)
}

#[cfg(test)]
mod tests {
    use std::borrow::Cow;

    use candle_core::Device;
    use candle_core::quantized::{QStorage, QTensor};
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn blocks_are_read_as_candle_reads_them(bytes in proptest::collection::vec(any::<u8>(), 3 * 210)) {
            for weight_format in [WeightFormat::Q8_0, WeightFormat::Q6K, WeightFormat::Q4K] {
                let count = 3 * weight_format.block();
                let bytes = &bytes[..3 * weight_format.block_bytes()];
                let quantized = QStorage::from_data(Cow::Borrowed(bytes), &Device::Cpu, weight_format.ggml()).unwrap();
                let expected: Vec<f32> =
                    QTensor::new(quantized, count).unwrap().dequantize(&Device::Cpu).unwrap().to_vec1().unwrap();
                let mut found = vec![0.0; count];
                decode_row(weight_format, bytes, &mut found);
                for (found, expected) in found.into_iter().zip(expected) {
                    let same = (found.is_nan() && expected.is_nan()) || found.total_cmp(&expected).is_eq();
                    prop_assert!(same || (found - expected).abs() <= expected.abs() * 1e-6, "{found} {expected}");
                }
            }
        }
    }
}
