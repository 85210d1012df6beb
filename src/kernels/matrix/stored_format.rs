//! Number formats of tensors in files.

use super::blocks::widen;
use candle_core::quantized::{GgmlDType, QTensor};
use candle_core::{Device, Result, Tensor, bail};
use half::f16;

/// Number format of a tensor in a file (ggml, `ggml-common.h`).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StoredFormat {
    /// A format that candle reads.
    Ggml(GgmlDType),
    /// 4 bits that choose from a table of bytes, with a scale for every 32.
    Iq4Nl,
    /// The same with a scale of 6 bits for every 32, in blocks of 256.
    Iq4Xs,
    /// 4-bit floats with an exponent for every 32 (OCP Microscaling).
    Mxfp4,
    /// 8 bits a number, with a scale of 16 bits for every 256. No file has it.
    Q8Of256,
}

/// The table of [`StoredFormat::Iq4Nl`] and [`StoredFormat::Iq4Xs`] (`kvalues_iq4nl`).
pub(super) const IQ4: [i8; 16] = [
    -127, -104, -83, -65, -49, -35, -22, -10, 1, 13, 25, 38, 53, 69, 89, 113,
];
/// Twice the values of the 4-bit floats (`kvalues_mxfp4`).
pub(super) const MXFP4: [i8; 16] = [0, 1, 2, 3, 4, 6, 8, 12, 0, -1, -2, -3, -4, -6, -8, -12];
/// Exponent of [`MXFP4`]'s scale for the stored byte 0: its bias, and one for the doubled table.
pub(super) const MXFP4_BIAS: i32 = 128;
/// Numbers with one scale.
/// Why: docs/decisions/121-blocks-of-32.md.
const BLOCK: usize = 32;
/// Numbers of a large block.
const SPAN: usize = 256;

impl From<GgmlDType> for StoredFormat {
    fn from(format: GgmlDType) -> Self {
        Self::Ggml(format)
    }
}

impl StoredFormat {
    /// Numbers in a block.
    pub fn block_size(self) -> usize {
        match self {
            Self::Ggml(format) => format.block_size(),
            Self::Iq4Nl | Self::Mxfp4 => BLOCK,
            Self::Iq4Xs | Self::Q8Of256 => SPAN,
        }
    }

    /// Bytes of a block.
    pub fn type_size(self) -> usize {
        match self {
            Self::Ggml(format) => format.type_size(),
            Self::Iq4Nl => 18,
            Self::Iq4Xs => 136,
            Self::Mxfp4 => 17,
            Self::Q8Of256 => 2 + SPAN,
        }
    }

    /// Its name in ggml, in lower case.
    pub fn name(self) -> String {
        match self {
            Self::Ggml(format) => {
                let name = format!("{format:?}").to_lowercase();
                name.strip_suffix('k')
                    .map_or_else(|| name.clone(), |digits| format!("{digits}_k"))
            }
            Self::Iq4Nl => "iq4_nl".into(),
            Self::Iq4Xs => "iq4_xs".into(),
            Self::Mxfp4 => "mxfp4".into(),
            Self::Q8Of256 => "q8_256".into(),
        }
    }

    /// Bits of a number, its share of scales included.
    pub fn bits(self) -> f64 {
        (8 * self.type_size()) as f64 / self.block_size() as f64
    }

    /// The values of whole blocks.
    pub fn widen(self, bytes: Vec<u8>) -> Result<Vec<f32>> {
        let mut values = Vec::new();
        match self {
            Self::Ggml(format) => return widen(format, bytes),
            Self::Iq4Nl => each::<18>(&bytes, |block| {
                put(
                    &mut values,
                    half(block, 0).to_f32(),
                    &nibbles(&block[2..], &IQ4),
                );
            }),
            Self::Iq4Xs => each::<136>(&bytes, |block| iq4_xs(block, &mut values)),
            Self::Q8Of256 => each::<{ 2 + SPAN }>(&bytes, |block| {
                let scale = half(block, 0).to_f32();
                let number = |byte: &u8| scale * f32::from(byte.cast_signed());
                values.extend(block[2..].iter().map(number));
            }),
            Self::Mxfp4 => each::<17>(&bytes, |block| {
                let scale = f64::from(i32::from(block[0]) - MXFP4_BIAS).exp2() as f32;
                put(&mut values, scale, &nibbles(&block[1..], &MXFP4));
            }),
        }
        Ok(values)
    }

    /// Rounds the numbers of whole blocks.
    ///
    /// # Errors
    /// When no number is rounded to the format, but read from files.
    pub(super) fn round(self, values: &[f32]) -> Result<Vec<u8>> {
        match self {
            Self::Ggml(format) => {
                let tensor = Tensor::from_slice(values, values.len(), &Device::Cpu)?;
                Ok(QTensor::quantize(&tensor, format)?.data()?.into_owned())
            }
            Self::Q8Of256 => {
                let blocks = values.as_chunks().0;
                let mut bytes = Vec::with_capacity(blocks.len() * self.type_size());
                for block in blocks {
                    bytes.extend(q8_of_256(block));
                }
                Ok(bytes)
            }
            Self::Iq4Nl | Self::Iq4Xs | Self::Mxfp4 => {
                let name = self.name();
                bail!("{name} is read from files, and no number is rounded to it")
            }
        }
    }
}

/// The scale and the numbers of a block.
fn q8_of_256(values: &[f32; SPAN]) -> [u8; 2 + SPAN] {
    /// Largest magnitude of a number.
    const LARGEST: f32 = 127.0;
    /// A sum with it is rounded to a whole number.
    const ROUNDING: f32 = 1.5 * (1 << 23) as f32;
    let largest = values.iter().fold(0f32, |so_far, v| so_far.max(v.abs()));
    let scale = f16::from_f32(largest / LARGEST);
    let step = scale.to_f32();
    let mut block = [0; 2 + SPAN];
    block[..2].copy_from_slice(&scale.to_le_bytes());
    for (byte, value) in block[2..].iter_mut().zip(values) {
        // Beside a step of 0, all numbers are zeros.
        let number = if step > 0.0 { value / step } else { 0.0 };
        // Ties to even, as `round_ties_even`, which is a call on most processors.
        let rounded = number.clamp(-LARGEST, LARGEST) + ROUNDING - ROUNDING;
        *byte = (rounded as i8).cast_unsigned();
    }
    block
}

fn each<const BYTES: usize>(bytes: &[u8], mut convert: impl FnMut(&[u8; BYTES])) {
    bytes.as_chunks::<BYTES>().0.iter().for_each(&mut convert);
}

/// Adds the values of numbers with one scale.
fn put(values: &mut Vec<f32>, scale: f32, numbers: &[i8; BLOCK]) {
    values.extend(numbers.iter().map(|number| scale * f32::from(*number)));
}

fn half(block: &[u8], at: usize) -> f16 {
    block
        .get(at..at + 2)
        .map_or(f16::ZERO, |bytes| f16::from_le_bytes([bytes[0], bytes[1]]))
}

/// The numbers of 16 bytes: of the low halves, then of the high ones.
fn nibbles(bytes: &[u8], table: &[i8; 16]) -> [i8; BLOCK] {
    let mut numbers = [0; BLOCK];
    let (low, high) = numbers.split_at_mut(BLOCK / 2);
    for ((low, high), byte) in low.iter_mut().zip(high).zip(bytes) {
        (*low, *high) = (table[usize::from(byte & 15)], table[usize::from(byte >> 4)]);
    }
    numbers
}

fn iq4_xs(block: &[u8; 136], values: &mut Vec<f32>) {
    let d = half(block, 0).to_f32();
    let high = u16::from_le_bytes([block[2], block[3]]);
    for part in 0..8 {
        let low = block[4 + part / 2] >> (part % 2 * 4) & 15;
        let scale = i16::from(low) | ((high >> (2 * part) & 3) << 4).cast_signed();
        let numbers = nibbles(&block[8 + 16 * part..24 + 16 * part], &IQ4);
        put(values, d * f32::from(scale - 32), &numbers);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_and_exponents_are_read_as_in_ggml() {
        let mut block = vec![0; 18];
        block[..2].copy_from_slice(&f16::from_f32(0.5).to_le_bytes());
        (block[2], block[17]) = (0x0f, 0x80);
        let found = StoredFormat::Iq4Nl.widen(block).unwrap();
        // Byte 0 holds numbers 0 and 16, byte 15 numbers 15 and 31.
        assert_eq!(
            [0, 16, 15, 31].map(|at| found[at].to_bits()),
            [56.5, -63.5, -63.5, 0.5].map(f32::to_bits)
        );

        for (exponent, scale) in [(127_u8, 0.5_f32), (120, 0.003_906_25), (146, 262_144.0)] {
            let mut block = vec![0x72; 17];
            block[0] = exponent;
            let found = StoredFormat::Mxfp4.widen(block).unwrap();
            let expected = [2.0 * scale, 12.0 * scale].map(f32::to_bits);
            assert_eq!(
                [0, 16].map(|at| found[at].to_bits()),
                expected,
                "{exponent}"
            );
        }

        let mut block = vec![0; 136];
        block[..2].copy_from_slice(&f16::from_f32(0.25).to_le_bytes());
        // Scale 33 of the first part: low bits 1, high bits 2; scale 0 of the others.
        (block[2], block[4]) = (2, 1);
        let found = StoredFormat::Iq4Xs.widen(block).unwrap();
        let expected = [0.25 * -127.0, 0.25 * -32.0 * -127.0].map(f32::to_bits);
        assert_eq!([0, 32].map(|at| found[at].to_bits()), expected);
    }

    #[test]
    fn numbers_of_a_block_of_256_are_rounded_to_the_nearest_of_255() {
        let rounded = |values: &[f32]| {
            let bytes = StoredFormat::Q8Of256.round(values).unwrap();
            StoredFormat::Q8Of256.widen(bytes).unwrap()
        };
        let values: Vec<f32> = (0..2 * SPAN)
            .map(|index| (index * 37 % 255) as f32 - 127.0)
            .collect();
        assert_eq!(rounded(&values), values);
        for factor in [1e-3, 0.3, 500.0] {
            let values: Vec<f32> = values.iter().map(|value| value * factor).collect();
            for (found, value) in rounded(&values).iter().zip(&values) {
                // Half a step, and what the scale loses in 11 bits.
                let allowed = factor * (0.51 + 127.0 / 2048.0);
                assert!((found - value).abs() <= allowed, "{found} {value}");
            }
        }
        // Beside the smallest scale, all numbers are zeros.
        for small in [0.0, 1e-30] {
            assert_eq!(rounded(&[small; SPAN]), [0.0; SPAN]);
        }
        assert!(StoredFormat::Mxfp4.round(&values).is_err());
    }

    #[test]
    fn names_are_ggmls() {
        let names = [
            StoredFormat::Ggml(GgmlDType::Q3K),
            StoredFormat::Ggml(GgmlDType::BF16),
            StoredFormat::Iq4Nl,
        ];
        assert_eq!(names.map(StoredFormat::name), ["q3_k", "bf16", "iq4_nl"]);
        assert!((StoredFormat::Ggml(GgmlDType::Q4_0).bits() - 4.5).abs() < 1e-9);
    }
}
