//! Whether the numbers of weights are finite.

use half::f16;
use planagent_kernels::matrix::WeightFormat;

/// The first element of the first block with a number that is not finite, and that number. Of a
/// quantized block the scale decides.
pub(super) fn first_not_finite(format: WeightFormat, bytes: &[u8]) -> Option<(usize, f32)> {
    let worst = |block: &[u8]| match format {
        WeightFormat::F32 => block.first_chunk().map(|value| f32::from_le_bytes(*value)),
        _ => format
            .halves()
            .iter()
            .filter_map(|at| half_at(block, *at))
            .find(|half| !half.is_finite()),
    };
    let mut blocks = bytes.chunks_exact(format.block_bytes()).enumerate();
    blocks.find_map(|(index, block)| {
        let value = worst(block).filter(|value| !value.is_finite())?;
        Some((index * format.block(), value))
    })
}

/// The half-precision number at a byte of a block.
fn half_at(block: &[u8], at: usize) -> Option<f32> {
    block
        .get(at..)?
        .first_chunk()
        .map(|bytes| f16::from_le_bytes(*bytes).to_f32())
}
