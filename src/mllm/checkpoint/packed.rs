//! Matrices that a quantizer packed, and how formats of this program hold them.

use crate::MllmError;
use planagent_kernels::matrix::{Matrix, WeightFormat};
use rayon::prelude::*;

/// How a quantizer packed a tensor, and where its numbers go.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct PackedForm {
    /// What reports call it: the method and the bits of a number.
    pub label: String,
    /// The format in memory where no other is asked for.
    pub weight_format: WeightFormat,
    pub held: Held,
}

/// How [`PackedForm::weight_format`] holds the numbers of a packed tensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Held {
    Exactly,
    /// But for scales and minima, which it has in half precision.
    ScalesRounded,
    /// They are rounded to it.
    Rounded,
}

/// A packed tensor in a format of this program.
#[derive(Debug)]
pub(crate) struct PackedBlocks {
    pub bytes: Vec<u8>,
    /// Largest distance of a number from that of the file.
    pub largest_error: f32,
}

impl Held {
    /// What a report says of it.
    pub(super) fn reason(self) -> Option<&'static str> {
        match self {
            Self::Exactly => None,
            Self::ScalesRounded => Some("its scales are rounded to half precision"),
            Self::Rounded => Some(
                "rounded to 8 bits; no format of blocks holds the numbers (--quantize f16 rounds less, f32 not at all)",
            ),
        }
    }
}

/// Rows that are compared at once: their copy in f32 takes little memory.
const COMPARED_ROWS: usize = 64;

/// The largest distance of a matrix from the numbers that it was rounded from.
pub(super) fn largest_difference(matrix: &Matrix, values: &[f32]) -> Result<f32, MllmError> {
    let inputs = matrix.inputs();
    let pieces = values.par_chunks((COMPARED_ROWS * inputs).max(1));
    let differences = pieces.enumerate().map(|(piece, values)| {
        let first = (piece * COMPARED_ROWS) as u32;
        let ids: Vec<u32> = (first..).take(values.len() / inputs.max(1)).collect();
        let rows = matrix.rows(&ids)?.flatten_all()?.to_vec1::<f32>()?;
        let difference = |(row, value): (&f32, &f32)| (row - value).abs();
        Ok(rows.iter().zip(values).map(difference).fold(0.0, f32::max))
    });
    differences.try_reduce(|| 0.0, |first: f32, second| Ok(first.max(second)))
}
