//! Decodes blocks of ggml's number formats.

use candle_core::quantized::GgmlDType;
use candle_core::{CpuStorage, Result, bail};
use half::{bf16, f16};

/// The values of whole blocks of any format that candle reads, as f32.
pub fn widen(format: GgmlDType, bytes: Vec<u8>) -> Result<Vec<f32>> {
    if !bytes.len().is_multiple_of(format.type_size()) {
        bail!("{} bytes are no whole blocks of {format:?}", bytes.len());
    }
    // candle casts bytes in place, which needs aligned memory. Plain numbers are converted one by
    // one and need none.
    Ok(match format {
        GgmlDType::F32 => bytes
            .as_chunks::<4>()
            .0
            .iter()
            .map(|bytes| f32::from_le_bytes(*bytes))
            .collect(),
        GgmlDType::F16 => bytes
            .as_chunks::<2>()
            .0
            .iter()
            .map(|bytes| f16::from_le_bytes(*bytes).to_f32())
            .collect(),
        GgmlDType::BF16 => bytes
            .as_chunks::<2>()
            .0
            .iter()
            .map(|bytes| bf16::from_le_bytes(*bytes).to_f32())
            .collect(),
        blocks => {
            let count = bytes.len() / blocks.type_size() * blocks.block_size();
            match blocks.from_data(bytes.into()).dequantize(count)? {
                CpuStorage::F32(values) => values,
                _ => bail!("{format:?} is not widened to f32"),
            }
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_precision_is_widened_exactly() {
        let bytes = [f16::from_f32(1.5), f16::from_f32(-0.25)]
            .iter()
            .flat_map(|value| value.to_le_bytes())
            .collect();
        assert_eq!(widen(GgmlDType::F16, bytes).unwrap(), [1.5, -0.25]);
        let bytes = [half::bf16::from_f32(3.0)]
            .iter()
            .flat_map(|value| value.to_le_bytes())
            .collect();
        assert_eq!(widen(GgmlDType::BF16, bytes).unwrap(), [3.0]);
        assert!(widen(GgmlDType::Q4K, vec![0; 143]).is_err());
    }
}
