//! What the codes of a packed matrix mean: scales, the places that they hold for, and zero points,
//! minima or a table of numbers.

use crate::checkpoint::Held;
use half::f16;
use planagent_kernels::matrix::WeightFormat;
use rayon::prelude::*;
use std::ops::Range;

/// Numbers of a block of ggml's formats that hold codes.
pub(super) const BLOCK: usize = 32;

/// The meaning of the codes of a matrix.
#[derive(Debug, Clone, PartialEq)]
#[allow(
    clippy::struct_field_names,
    reason = "scales are called so in every format"
)]
pub(super) struct Scales {
    /// A scale for each place.
    pub scales: Vec<f32>,
    pub places: Places,
    pub meaning: Meaning,
}

/// Which scale a number has.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Places {
    /// Rectangles of this many rows and columns; `across` of them lie side by side.
    Blocks {
        rows: usize,
        columns: usize,
        across: usize,
    },
    /// A group for each column; a row has `across` of them.
    Listed { groups: Vec<u32>, across: usize },
    /// Runs of the row-major numbers.
    Runs(usize),
}

/// How a code becomes a number. The lists have an entry for each scale.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Meaning {
    /// scale · (code − zero).
    Zeros(Vec<i16>),
    /// scale · (code − zero), with the same zero everywhere.
    Zero(i16),
    /// scale · code + minimum.
    Minima(Vec<f32>),
    /// scale · table of the code.
    Table(Vec<f32>),
}

impl Places {
    /// Groups along the rows of a matrix.
    pub(super) fn groups(columns: usize, across: usize) -> Self {
        Self::Blocks {
            rows: 1,
            columns,
            across,
        }
    }

    /// One scale for each row.
    pub(super) fn rows(inputs: usize) -> Self {
        Self::groups(inputs, 1)
    }

    /// Scales that a matrix of this shape needs; none if a number overflows.
    pub(super) fn count(&self, outputs: usize, inputs: usize) -> Option<usize> {
        match self {
            Self::Blocks { rows, across, .. } => {
                outputs.div_ceil((*rows).max(1)).checked_mul(*across)
            }
            Self::Listed { across, .. } => outputs.checked_mul(*across),
            Self::Runs(run) => Some(outputs.checked_mul(inputs)?.div_ceil((*run).max(1))),
        }
    }

    /// The end of the run of columns from `column` on that share a scale, and the index of the
    /// scale.
    fn run(&self, row: usize, column: usize, inputs: usize) -> (usize, usize) {
        match self {
            Self::Blocks {
                rows,
                columns,
                across,
            } => {
                let group = column / columns;
                ((group + 1) * columns, row / rows * across + group)
            }
            Self::Listed { groups, across } => {
                let group = groups.get(column).copied().unwrap_or(0);
                let same = groups
                    .iter()
                    .skip(column)
                    .take_while(|other| **other == group);
                (column + same.count().max(1), row * across + group as usize)
            }
            Self::Runs(run) => {
                let flat = row * inputs + column;
                (column + run - flat % run, flat / run)
            }
        }
    }
}

/// The codes of a run of numbers that share a scale, and the columns that they are in.
struct Run<'a> {
    codes: &'a [u8],
    columns: Range<usize>,
    /// Index of the scale.
    scale: usize,
}

impl Scales {
    /// Whether there is a scale, and a zero point or minimum, for every number of a matrix.
    pub(super) fn fit(&self, outputs: usize, inputs: usize) -> bool {
        let Some(count) = self.places.count(outputs, inputs) else {
            return false;
        };
        let places = match &self.places {
            Places::Blocks {
                rows,
                columns,
                across,
            } => *rows > 0 && *columns > 0 && inputs.div_ceil(*columns) <= *across,
            Places::Listed { groups, across } => {
                groups.len() == inputs && groups.iter().all(|group| (*group as usize) < *across)
            }
            Places::Runs(run) => *run > 0,
        };
        let meaning = match &self.meaning {
            Meaning::Zeros(zeros) => zeros.len() >= count,
            Meaning::Minima(minima) => minima.len() >= count,
            Meaning::Zero(_) => true,
            Meaning::Table(table) => !table.is_empty(),
        };
        places && meaning && self.scales.len() >= count
    }

    fn runs<'a>(&'a self, row: usize, codes: &'a [u8]) -> impl Iterator<Item = Run<'a>> {
        let inputs = codes.len();
        let mut column = 0;
        std::iter::from_fn(move || {
            let (end, scale) = (column < inputs).then(|| self.places.run(row, column, inputs))?;
            let columns = column..end.min(inputs);
            column = columns.end;
            Some(Run {
                codes: codes.get(columns.clone())?,
                columns,
                scale,
            })
        })
    }

    fn scale(&self, index: usize) -> f32 {
        self.scales.get(index).copied().unwrap_or(0.0)
    }

    fn zero(&self, index: usize) -> i16 {
        match &self.meaning {
            Meaning::Zeros(zeros) => zeros.get(index).copied().unwrap_or(0),
            Meaning::Zero(zero) => *zero,
            Meaning::Minima(_) | Meaning::Table(_) => 0,
        }
    }

    /// The numbers of a matrix whose rows have `inputs` codes.
    pub(super) fn values(&self, codes: &[u8], inputs: usize) -> Vec<f32> {
        let mut values = vec![0.0; codes.len()];
        let rows = values
            .par_chunks_mut(inputs.max(1))
            .zip(codes.par_chunks(inputs.max(1)));
        rows.enumerate().for_each(|(row, (values, codes))| {
            for run in self.runs(row, codes) {
                if let Some(values) = values.get_mut(run.columns.clone()) {
                    self.run_values(&run, values);
                }
            }
        });
        values
    }

    fn run_values(&self, run: &Run<'_>, values: &mut [f32]) {
        let scale = self.scale(run.scale);
        let pairs = values.iter_mut().zip(run.codes);
        match &self.meaning {
            Meaning::Zeros(_) | Meaning::Zero(_) => {
                let zero = self.zero(run.scale);
                pairs.for_each(|(value, code)| {
                    *value = f32::from(i16::from(*code) - zero) * scale;
                });
            }
            Meaning::Minima(minima) => {
                let minimum = minima.get(run.scale).copied().unwrap_or(0.0);
                pairs.for_each(|(value, code)| *value = f32::from(*code) * scale + minimum);
            }
            Meaning::Table(table) => pairs.for_each(|(value, code)| {
                *value = table.get(usize::from(*code)).copied().unwrap_or(f32::NAN) * scale;
            }),
        }
    }

    /// The format of blocks for codes of `bits` bits in rows of `inputs`.
    pub(super) fn format(&self, bits: u32, inputs: usize) -> (WeightFormat, Held) {
        const ROUNDED: (WeightFormat, Held) = (WeightFormat::Q8_0, Held::Rounded);
        // A block of ggml has one scale, so no block may reach over two scales of the file.
        let whole = match self.places {
            Places::Blocks {
                columns, across, ..
            } => across == 1 || columns.is_multiple_of(BLOCK),
            Places::Listed { .. } | Places::Runs(_) => false,
        };
        if !whole || !inputs.is_multiple_of(BLOCK) {
            return ROUNDED;
        }
        let weight_format = match &self.meaning {
            Meaning::Minima(_) if bits <= 4 => WeightFormat::Q4_1,
            Meaning::Minima(_) if bits == 5 => WeightFormat::Q5_1,
            Meaning::Zero(zero) => match of_range(bits, *zero, *zero) {
                Some(format) => format,
                None => return ROUNDED,
            },
            Meaning::Zeros(zeros) => {
                let smallest = zeros.iter().copied().min().unwrap_or(0);
                let largest = zeros.iter().copied().max().unwrap_or(0);
                match of_range(bits, smallest, largest) {
                    Some(format) => format,
                    None => return ROUNDED,
                }
            }
            Meaning::Minima(_) | Meaning::Table(_) => return ROUNDED,
        };
        let held = match &self.meaning {
            Meaning::Minima(minima) => in_halves(&self.scales).max(in_halves(minima)),
            _ => in_halves(&self.scales),
        };
        (weight_format, held)
    }

    /// The blocks of a row's codes in a format that [`Self::format`] gave, and the largest distance
    /// of a number from that of the file.
    pub(super) fn row_blocks(
        &self,
        row: usize,
        codes: &[u8],
        format: WeightFormat,
        out: &mut [u8],
    ) -> f32 {
        let mut largest = 0.0_f32;
        let blocks = codes.as_chunks::<BLOCK>().0.iter();
        let out = out.chunks_exact_mut(format.block_bytes());
        for (index, (codes, out)) in blocks.zip(out).enumerate() {
            let (_, scale) = self.places.run(row, index * BLOCK, codes.len());
            let error = self.block(scale, codes, format, out);
            largest = largest.max(error);
        }
        largest
    }

    fn block(
        &self,
        place: usize,
        codes: &[u8; BLOCK],
        format: WeightFormat,
        out: &mut [u8],
    ) -> f32 {
        let scale = self.scale(place);
        let d = f16::from_f32(scale);
        // What the 16 bits of the scale lose counts once for each number, most for the farthest.
        let lost = (scale - d.to_f32()).abs();
        let mut bytes = d.to_le_bytes().to_vec();
        let mut error = 0.0;
        let offset = match format {
            WeightFormat::Q4_0 => 8,
            WeightFormat::Q5_0 => 16,
            _ => 0,
        };
        let numbers = codes.map(|code| i16::from(code) - self.zero(place));
        let farthest = numbers.iter().map(|number| number.abs()).max().unwrap_or(0);
        if let Meaning::Minima(minima) = &self.meaning {
            let minimum = minima.get(place).copied().unwrap_or(0.0);
            let m = f16::from_f32(minimum);
            bytes.extend(m.to_le_bytes());
            error = (minimum - m.to_f32()).abs();
        }
        error += f32::from(farthest) * lost;
        match format {
            WeightFormat::Q8_0 => {
                bytes.extend(numbers.map(|number| (number as i8).cast_unsigned()));
            }
            _ => bytes.extend(nibbles(
                &numbers.map(|number| (number + offset) as u8),
                format,
            )),
        }
        for (out, byte) in out.iter_mut().zip(bytes) {
            *out = byte;
        }
        error
    }
}

/// ggml's layout of numbers of four or five bits: the fifth bits, then the lower four of numbers n
/// and n + 16 in a byte.
fn nibbles(numbers: &[u8; BLOCK], format: WeightFormat) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(4 + BLOCK / 2);
    if matches!(format, WeightFormat::Q5_0 | WeightFormat::Q5_1) {
        let fifth =
            |word: u32, (index, number): (usize, &u8)| word | u32::from(number >> 4 & 1) << index;
        bytes.extend(numbers.iter().enumerate().fold(0, fifth).to_le_bytes());
    }
    let (low, high) = numbers.split_at(BLOCK / 2);
    bytes.extend(
        low.iter()
            .zip(high)
            .map(|(low, high)| low & 15 | (high & 15) << 4),
    );
    bytes
}

/// The smallest format of whole numbers that holds codes of `bits` bits less any of the zero points
/// from `smallest` to `largest`.
fn of_range(bits: u32, smallest: i16, largest: i16) -> Option<WeightFormat> {
    let (low, high) = (-i32::from(largest), (1 << bits) - 1 - i32::from(smallest));
    [
        (WeightFormat::Q4_0, 8),
        (WeightFormat::Q5_0, 16),
        (WeightFormat::Q8_0, 128),
    ]
    .into_iter()
    .find(|(_, half)| -half <= low && high < *half)
    .map(|(format, _)| format)
}

/// How half precision holds numbers. Errors count relative to the largest of them: an error far
/// below the others changes no product.
fn in_halves(numbers: &[f32]) -> Held {
    /// Relative rounding error of half precision, which has 11 binary digits.
    const HALF_STEP: f32 = 1.0 / 2048.0;
    let largest = numbers
        .iter()
        .fold(0.0_f32, |largest, number| largest.max(number.abs()));
    let error = |number: &f32| (number - f16::from_f32(*number).to_f32()).abs();
    let worst = numbers.iter().map(error).fold(0.0_f32, f32::max);
    if worst == 0.0 {
        Held::Exactly
    } else if worst <= largest * HALF_STEP {
        Held::ScalesRounded
    } else {
        Held::Rounded
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::quantized::GgmlDType;

    fn groups(bits: u32, meaning: Meaning) -> (Scales, Vec<u8>) {
        let scales = Scales {
            scales: vec![0.5, -0.25, 1.0, 0.125],
            places: Places::groups(BLOCK, 2),
            meaning,
        };
        let codes = (0..4 * BLOCK)
            .map(|code| (code * 7 % (1 << bits)) as u8)
            .collect();
        (scales, codes)
    }

    fn from_blocks(scales: &Scales, codes: &[u8], format: WeightFormat) -> (Vec<f32>, f32) {
        let mut blocks = vec![0; codes.len() / BLOCK * format.block_bytes()];
        let width = 2 * format.block_bytes();
        let rows = codes
            .chunks_exact(2 * BLOCK)
            .zip(blocks.chunks_exact_mut(width));
        let error = rows
            .enumerate()
            .map(|(row, (codes, out))| scales.row_blocks(row, codes, format, out));
        let error = error.fold(0.0, f32::max);
        (format.stored().widen(blocks).unwrap(), error)
    }

    #[test]
    fn blocks_hold_the_numbers_of_their_formats_exactly() {
        let formats = [
            (4, Meaning::Zero(8), WeightFormat::Q4_0),
            (4, Meaning::Zeros(vec![0, 15, 7, 8]), WeightFormat::Q5_0),
            (3, Meaning::Zeros(vec![0, 7, 1, 3]), WeightFormat::Q4_0),
            (2, Meaning::Zeros(vec![0, 3, 1, 4]), WeightFormat::Q4_0),
            (8, Meaning::Zero(128), WeightFormat::Q8_0),
            (5, Meaning::Zero(16), WeightFormat::Q5_0),
            (6, Meaning::Zero(32), WeightFormat::Q8_0),
            (
                4,
                Meaning::Minima(vec![-1.5, 2.0, 0.0, -8.0]),
                WeightFormat::Q4_1,
            ),
            (
                5,
                Meaning::Minima(vec![-1.5, 2.0, 0.0, -8.0]),
                WeightFormat::Q5_1,
            ),
        ];
        for (bits, meaning, expected) in formats {
            let (scales, codes) = groups(bits, meaning);
            assert!(scales.fit(2, 2 * BLOCK));
            assert_eq!(scales.format(bits, 2 * BLOCK), (expected, Held::Exactly));
            let values = scales.values(&codes, 2 * BLOCK);
            let (held, error) = from_blocks(&scales, &codes, expected);
            assert_eq!((held, error), (values, 0.0), "{expected}");
        }
    }

    #[test]
    fn what_no_block_holds_is_rounded() {
        for (bits, meaning) in [
            (8, Meaning::Zeros(vec![128, 3, 0, 200])),
            (6, Meaning::Minima(vec![0.0; 4])),
            (4, Meaning::Table(vec![0.0; 16])),
        ] {
            let (scales, _) = groups(bits, meaning);
            assert_eq!(scales.format(bits, 2 * BLOCK).1, Held::Rounded);
        }
        let (scales, _) = groups(4, Meaning::Zero(8));
        assert_eq!(
            scales.format(4, 40).1,
            Held::Rounded,
            "rows are no whole blocks"
        );
        let small = Scales {
            places: Places::groups(16, 4),
            ..scales.clone()
        };
        assert_eq!(
            small.format(4, 64).1,
            Held::Rounded,
            "groups are shorter than blocks"
        );
        let large = Scales {
            scales: vec![1e6; 4],
            ..scales
        };
        assert_eq!(
            large.format(4, 64).1,
            Held::Rounded,
            "half precision ends at 65504"
        );
    }

    #[test]
    fn the_error_of_rounded_scales_is_measured() {
        let (mut scales, codes) = groups(8, Meaning::Zero(128));
        scales.scales = vec![0.1, 0.2, 0.3, 0.4];
        assert_eq!(
            scales.format(8, 64),
            (WeightFormat::Q8_0, Held::ScalesRounded)
        );
        let values = scales.values(&codes, 64);
        let (held, error) = from_blocks(&scales, &codes, WeightFormat::Q8_0);
        let worst = held
            .iter()
            .zip(&values)
            .map(|(held, value)| (held - value).abs());
        let worst = worst.fold(0.0, f32::max);
        assert!(
            worst > 0.0 && worst <= error * 1.001 && error < 0.02,
            "{worst} {error}"
        );
    }

    #[test]
    fn every_kind_of_place_finds_its_scale() {
        let listed = Scales {
            scales: vec![1.0, 10.0, 100.0, 1000.0],
            places: Places::Listed {
                groups: vec![1, 0, 1],
                across: 2,
            },
            meaning: Meaning::Zero(0),
        };
        assert_eq!(
            listed.values(&[1; 6], 3),
            [10.0, 1.0, 10.0, 1000.0, 100.0, 1000.0]
        );
        let flat = Scales {
            places: Places::Runs(2),
            ..listed.clone()
        };
        assert_eq!(
            flat.values(&[1; 6], 3),
            [1.0, 1.0, 10.0, 10.0, 100.0, 100.0]
        );
        let ragged = Scales {
            places: Places::Blocks {
                rows: 2,
                columns: 2,
                across: 2,
            },
            ..listed.clone()
        };
        assert!(ragged.fit(3, 3) && !ragged.fit(5, 3) && !ragged.fit(3, 5));
        let expected = [1.0, 1.0, 10.0, 1.0, 1.0, 10.0, 100.0, 100.0, 1000.0];
        assert_eq!(ragged.values(&[1; 9], 3), expected);
        assert!(!listed.fit(2, 4) && listed.fit(2, 3) && !listed.fit(3, 3));
        assert_eq!(GgmlDType::Q8_0.block_size(), BLOCK);
    }
}
