//! The weight formats of matrices.

use super::stored_format::StoredFormat;
use candle_core::quantized::GgmlDType;
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize};
use std::fmt;
use std::str::FromStr;

/// Number format of a weight matrix, by ggml's names.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum WeightFormat {
    /// 32-bit floating point.
    #[default]
    F32,
    /// 16-bit floating point, 5 bits of exponent.
    F16,
    /// 8 bits a number and a scale for every 32 (8.5 bits).
    Q8_0,
    /// 8 bits a number and a scale for every 256 (8.06 bits). Only memory has it.
    /// Why: docs/decisions/151-one-scale-for-256.md.
    #[serde(rename = "q8_256")]
    Q8Of256,
    /// 6 bits a number and a scale for every 16, in blocks of 256 (6.56 bits).
    #[serde(rename = "q6_k")]
    Q6K,
    /// 5 bits a number, a scale and a minimum for every 32 (6 bits).
    Q5_1,
    /// 5 bits a number, a scale and a minimum for every 32, in blocks of 256 (5.5 bits).
    #[serde(rename = "q5_k")]
    Q5K,
    /// 5 bits a number and a scale for every 32 (5.5 bits).
    Q5_0,
    /// 4 bits a number, a scale and a minimum for every 32 (5 bits).
    Q4_1,
    /// 4 bits a number, a scale and a minimum for every 32, in blocks of 256 (4.5 bits).
    #[serde(rename = "q4_k")]
    Q4K,
    /// 4 bits that choose from a table, and a scale for every 32 (4.5 bits). Only files have it.
    Iq4Nl,
    /// 4 bits that choose from a table, and a scale for every 32, in blocks of 256 (4.25 bits). Only
    /// files have it.
    Iq4Xs,
    /// 4-bit floats and an exponent for every 32 (4.25 bits). Only files have it.
    Mxfp4,
    /// 4 bits a number and a scale for every 32 (4.5 bits).
    Q4_0,
    /// 3 bits a number and a scale for every 16, in blocks of 256 (3.44 bits).
    #[serde(rename = "q3_k")]
    Q3K,
}

impl WeightFormat {
    /// Those that numbers can be rounded to, from largest to smallest.
    pub const ALL: [Self; 11] = [
        Self::F32,
        Self::F16,
        Self::Q8_0,
        Self::Q6K,
        Self::Q5_1,
        Self::Q5K,
        Self::Q5_0,
        Self::Q4_1,
        Self::Q4K,
        Self::Q4_0,
        Self::Q3K,
    ];

    /// The name in configurations and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::F16 => "f16",
            Self::Q8_0 => "q8_0",
            Self::Q8Of256 => "q8_256",
            Self::Q6K => "q6_k",
            Self::Q5_1 => "q5_1",
            Self::Q5K => "q5_k",
            Self::Q5_0 => "q5_0",
            Self::Q4_1 => "q4_1",
            Self::Q4K => "q4_k",
            Self::Iq4Nl => "iq4_nl",
            Self::Iq4Xs => "iq4_xs",
            Self::Mxfp4 => "mxfp4",
            Self::Q4_0 => "q4_0",
            Self::Q3K => "q3_k",
        }
    }

    /// Numbers in a block.
    pub fn block(self) -> usize {
        match self {
            Self::F32 | Self::F16 => 1,
            Self::Q8_0
            | Self::Q5_1
            | Self::Q5_0
            | Self::Q4_1
            | Self::Q4_0
            | Self::Iq4Nl
            | Self::Mxfp4 => 32,
            Self::Q8Of256 | Self::Q6K | Self::Q5K | Self::Q4K | Self::Q3K | Self::Iq4Xs => 256,
        }
    }

    /// Activations that share a scale when a product rounds them to eight bits; none where it rounds
    /// nothing. As in ggml, these are the activations of a block of weights.
    pub(super) fn activations_a_scale(self) -> Option<usize> {
        Some(self.block()).filter(|block| *block > 1)
    }

    /// Bytes of a block (ggml, `ggml-common.h`).
    pub fn block_bytes(self) -> usize {
        match self {
            Self::F32 => 4,
            Self::F16 => 2,
            Self::Q8_0 => 34,
            Self::Q8Of256 => 258,
            Self::Q6K => 210,
            Self::Q5_1 => 24,
            Self::Q5K => 176,
            Self::Q5_0 => 22,
            Self::Q4_1 => 20,
            Self::Q4K => 144,
            Self::Q4_0 | Self::Iq4Nl => 18,
            Self::Iq4Xs => 136,
            Self::Mxfp4 => 17,
            Self::Q3K => 110,
        }
    }

    /// Offsets of the half-precision numbers in a block: its scale, and its minimum or the scale of
    /// its minima.
    pub fn halves(self) -> &'static [usize] {
        match self {
            Self::F32 | Self::Mxfp4 => &[],
            Self::F16
            | Self::Q8_0
            | Self::Q8Of256
            | Self::Q5_0
            | Self::Q4_0
            | Self::Iq4Nl
            | Self::Iq4Xs => &[0],
            Self::Q5_1 | Self::Q5K | Self::Q4_1 | Self::Q4K => &[0, 2],
            Self::Q6K => &[208],
            Self::Q3K => &[108],
        }
    }

    /// Bits of a number, its share of scales included.
    pub fn bits(self) -> f64 {
        (8 * self.block_bytes()) as f64 / self.block() as f64
    }

    /// Whether rows of `inputs` numbers fill blocks. In memory, zeros may fill the last block of a
    /// long row. Why: docs/decisions/143-filled-blocks.md.
    fn holds(self, inputs: usize) -> bool {
        /// Numbers of a row beside which a block of 32 is little: 6 %.
        const LONG: usize = 512;
        // Numbers that fill blocks of `q8_256` take memory, and no time.
        let fills = self.block() == 32 || self == Self::Q8Of256;
        inputs.is_multiple_of(self.block()) || fills && inputs > LONG
    }

    /// Bytes of a matrix of this shape in memory; `None` if the format cannot hold it or the number
    /// overflows.
    pub fn matrix_bytes(self, outputs: usize, inputs: usize) -> Option<usize> {
        let blocks = self.holds(inputs).then(|| inputs.div_ceil(self.block()))?;
        blocks.checked_mul(self.block_bytes())?.checked_mul(outputs)
    }

    /// This format if a file can hold rows of `inputs` numbers in it, else a finer one that can:
    /// blocks of 32 for those of 256, which llama.cpp chooses too but for `q3_k` (`iq4_nl`).
    /// Why: docs/decisions/139-five-bits-for-odd-widths.md.
    pub fn or_finer(self, inputs: usize) -> Self {
        self.or_finer_where(&|format| inputs.is_multiple_of(format.block()))
    }

    /// As [`Self::or_finer`], of formats in memory.
    pub fn or_finer_in_memory(self, inputs: usize) -> Self {
        self.or_finer_where(&|format| format.holds(inputs))
    }

    fn or_finer_where(self, holds: &impl Fn(Self) -> bool) -> Self {
        let finer = match self {
            Self::Q3K => Self::Q4_0,
            Self::Q4K | Self::Iq4Xs => Self::Q5_0,
            Self::Q5K => Self::Q5_1,
            Self::Q8Of256 | Self::Q6K => Self::Q8_0,
            Self::Q8_0
            | Self::Q5_1
            | Self::Q5_0
            | Self::Q4_1
            | Self::Q4_0
            | Self::Iq4Nl
            | Self::Mxfp4 => Self::F16,
            Self::F16 | Self::F32 => return self,
        };
        if holds(self) {
            self
        } else {
            finer.or_finer_where(holds)
        }
    }

    /// The same format in a file.
    pub fn stored(self) -> StoredFormat {
        let format = match self {
            Self::Iq4Nl => return StoredFormat::Iq4Nl,
            Self::Iq4Xs => return StoredFormat::Iq4Xs,
            Self::Mxfp4 => return StoredFormat::Mxfp4,
            Self::F32 => GgmlDType::F32,
            Self::F16 => GgmlDType::F16,
            Self::Q8Of256 => return StoredFormat::Q8Of256,
            Self::Q8_0 => GgmlDType::Q8_0,
            Self::Q6K => GgmlDType::Q6K,
            Self::Q5_1 => GgmlDType::Q5_1,
            Self::Q5K => GgmlDType::Q5K,
            Self::Q5_0 => GgmlDType::Q5_0,
            Self::Q4_1 => GgmlDType::Q4_1,
            Self::Q4K => GgmlDType::Q4K,
            Self::Q4_0 => GgmlDType::Q4_0,
            Self::Q3K => GgmlDType::Q3K,
        };
        StoredFormat::Ggml(format)
    }

    /// Reads a format that weights can be rounded to, or null.
    pub fn choice<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Self>, D::Error> {
        let name = Option::<String>::deserialize(deserializer)?;
        name.map(|name| name.parse().map_err(D::Error::custom))
            .transpose()
    }
}

impl fmt::Display for WeightFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// A name that is not in [`WeightFormat::ALL`].
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("unknown weight format '{name}'; choose one of {}", WeightFormat::ALL.map(WeightFormat::name).join(", "))]
pub struct UnknownWeightFormat {
    name: String,
}

impl FromStr for WeightFormat {
    type Err = UnknownWeightFormat;

    fn from_str(name: &str) -> Result<Self, UnknownWeightFormat> {
        Self::ALL
            .into_iter()
            .find(|weight_format| weight_format.name() == name)
            .ok_or_else(|| UnknownWeightFormat {
                name: name.to_string(),
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_back() {
        for weight_format in WeightFormat::ALL {
            assert_eq!(weight_format.name().parse(), Ok(weight_format));
            assert_eq!(
                serde_json::to_value(weight_format).unwrap(),
                weight_format.name()
            );
            assert_eq!(
                serde_json::from_value::<WeightFormat>(weight_format.name().into()).unwrap(),
                weight_format
            );
            assert_eq!(
                weight_format.block_bytes(),
                weight_format.stored().type_size()
            );
            assert_eq!(weight_format.block(), weight_format.stored().block_size());
        }
        for no_choice in ["iq4_nl", "iq4_xs", "mxfp4", "q8_256"] {
            let format: WeightFormat = serde_json::from_value(no_choice.into()).unwrap();
            assert_eq!(
                (format.name(), format.stored().name().as_str()),
                (no_choice, no_choice)
            );
            assert_eq!(format.block_bytes(), format.stored().type_size());
            assert_eq!(format.block(), format.stored().block_size());
            assert!(no_choice.parse::<WeightFormat>().is_err());
            assert!(WeightFormat::choice(serde_json::Value::from(no_choice)).is_err());
        }
        assert_eq!(
            WeightFormat::choice(serde_json::Value::from("q4_k")).unwrap(),
            Some(WeightFormat::Q4K)
        );
        assert!(
            "q2_k"
                .parse::<WeightFormat>()
                .unwrap_err()
                .to_string()
                .contains("q4_k")
        );
    }

    #[test]
    fn odd_widths_fall_to_finer_storages() {
        use WeightFormat::{Q3K, Q4_0, Q4K, Q5_0, Q5_1, Q5K, Q6K, Q8_0};
        for (asked, finer) in [(Q3K, Q4_0), (Q4K, Q5_0), (Q5K, Q5_1), (Q6K, Q8_0)] {
            assert_eq!(asked.or_finer(512), asked);
            assert_eq!(asked.or_finer(96), finer);
            assert!(finer.bits() > asked.bits());
            assert_eq!(asked.or_finer(7), WeightFormat::F16);
        }
        assert_eq!(
            [96, 100].map(|inputs| WeightFormat::Q4_0.or_finer(inputs)),
            [WeightFormat::Q4_0, WeightFormat::F16]
        );
        assert_eq!(WeightFormat::F32.or_finer(7), WeightFormat::F32);
        // Zeros fill blocks in memory and in long rows, not in files.
        let in_memory = |inputs| Q4K.or_finer_in_memory(inputs);
        let found = [1024, 4304, 3420, 48].map(in_memory);
        assert_eq!(found, [Q4K, Q5_0, Q5_0, WeightFormat::F16]);
        assert_eq!(Q8_0.or_finer(4304), WeightFormat::F16);
    }
}
