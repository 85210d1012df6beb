//! The arithmetic of merging.

use super::change::{Change, Experts, LowRank, Rows, flat};
use super::initial::subtract;
use crate::MllmError;
use crate::checkpoint::{BaseTensor, TensorPlace, TensorSource};
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// A tensor of the base with the changes of an adapter, computed when it is read.
#[derive(Debug)]
pub(super) struct MergedTensor {
    pub(super) adapter: PathBuf,
    pub(super) base: BaseTensor,
    /// Their shapes are checked.
    pub(super) changes: Vec<Change>,
}

impl TensorSource for MergedTensor {
    /// The adapter, since its numbers are at fault where the result is not finite.
    fn path(&self) -> &Path {
        &self.adapter
    }

    fn bytes(&self, _place: &TensorPlace) -> Result<Vec<u8>, MllmError> {
        let values = self.values()?;
        Ok(values
            .iter()
            .flat_map(|value| value.to_le_bytes())
            .collect())
    }

    /// The files of base and adapter are hashed by themselves.
    fn hash(&self, _hasher: &mut blake3::Hasher) -> Result<(), MllmError> {
        Ok(())
    }
}

impl MergedTensor {
    fn values(&self) -> Result<Vec<f32>, MllmError> {
        let mut values = self.base.values()?;
        for change in &self.changes {
            self.make(change, &mut values)?;
        }
        Ok(values)
    }

    fn make(&self, change: &Change, values: &mut [f32]) -> Result<(), MllmError> {
        let shape = self.base.shape();
        let columns = flat(shape).map_or(1, |[_, columns]| columns);
        // One match: an arm is a kind of change, and all arms know the same base tensor.
        match change {
            Change::Replace { tensor, rows, .. } => {
                let new = tensor.values()?;
                let places = rows.of_target(values, columns)?.iter_mut();
                places
                    .zip(rows.of_source(&new, columns)?)
                    .for_each(|(place, new)| *place = *new);
            }
            Change::Add {
                tensor,
                scale,
                rows,
            } => {
                let added = tensor.values()?;
                let places = rows.of_target(values, columns)?.iter_mut();
                places
                    .zip(rows.of_source(&added, columns)?)
                    .for_each(|(place, added)| *place += scale * added);
            }
            Change::Tokens { tensor, indices } => {
                let new = tensor.values()?;
                for (index, new) in indices.iter().zip(new.chunks_exact(columns)) {
                    let row = values.chunks_exact_mut(columns).nth(*index);
                    if let Some(row) = row {
                        row.copy_from_slice(new);
                    }
                }
            }
            Change::LowRank(low) => add_low_rank(low, values, columns)?,
            Change::Experts(experts) => add_experts(experts, values, shape)?,
        }
        Ok(())
    }
}

impl Rows {
    /// The numbers of these rows in the base's tensor.
    fn of_target(self, values: &mut [f32], columns: usize) -> Result<&mut [f32], MllmError> {
        match self {
            Self::All => Ok(values),
            Self::Part { target, count, .. } => values
                .get_mut(target * columns..(target + count) * columns)
                .ok_or_else(rows_outside),
        }
    }

    /// The numbers of these rows in the adapter's tensor.
    fn of_source(self, values: &[f32], columns: usize) -> Result<&[f32], MllmError> {
        match self {
            Self::All => Ok(values),
            Self::Part { source, count, .. } => values
                .get(source * columns..(source + count) * columns)
                .ok_or_else(rows_outside),
        }
    }
}

/// The error of rows that a tensor does not have, though its shape was checked.
fn rows_outside() -> MllmError {
    candle_core::Error::Msg("the rows of an adapter lie outside of its tensor".to_owned()).into()
}

/// W + s L R, and of `DoRA` each output of it at the length that the adapter says.
fn add_low_rank(low: &LowRank, values: &mut [f32], columns: usize) -> Result<(), MllmError> {
    subtract(&low.initial, values, columns, low.rank);
    let (left, right) = (low.left.values()?, low.right.values()?);
    let left = low.rows.of_source(&left, low.rank)?;
    let values = low.rows.of_target(values, columns)?;
    add_product(values, columns, left, &right, low.rank, low.scale);
    let Some(magnitude) = &low.magnitude else {
        return Ok(());
    };
    let magnitude = magnitude.values()?;
    if low.transposed {
        let factors = column_lengths(values, columns);
        let factors: Vec<f32> = magnitude.iter().zip(factors).map(|(m, n)| m / n).collect();
        for row in values.chunks_exact_mut(columns) {
            for (value, factor) in row.iter_mut().zip(&factors) {
                *value *= factor;
            }
        }
    } else {
        let magnitude = low.rows.of_source(&magnitude, 1)?;
        for (row, magnitude) in values.chunks_exact_mut(columns).zip(magnitude) {
            let factor = magnitude / length(row);
            for value in row {
                *value *= factor;
            }
        }
    }
    Ok(())
}

/// Adds `scale` times the product of (rows, rank) and (rank, columns). Each row is summed by itself,
/// so that the result does not depend on the number of threads.
fn add_product(
    values: &mut [f32],
    columns: usize,
    left: &[f32],
    right: &[f32],
    rank: usize,
    scale: f32,
) {
    values
        .par_chunks_exact_mut(columns)
        .zip(left.par_chunks_exact(rank))
        .for_each_init(
            || vec![0.0_f32; columns],
            |sum, (row, factors)| {
                sum.fill(0.0);
                for (factor, right) in factors.iter().zip(right.chunks_exact(columns)) {
                    for (sum, right) in sum.iter_mut().zip(right) {
                        *sum += factor * right;
                    }
                }
                for (value, sum) in row.iter_mut().zip(&*sum) {
                    *value += scale * *sum;
                }
            },
        );
}

/// The Euclidean length of a row.
fn length(row: &[f32]) -> f32 {
    let squares = row.iter().map(|value| f64::from(*value).powi(2));
    squares.sum::<f64>().sqrt() as f32
}

/// The Euclidean lengths of the columns.
fn column_lengths(values: &[f32], columns: usize) -> Vec<f32> {
    let mut squares = vec![0.0_f64; columns];
    for row in values.chunks_exact(columns) {
        for (sum, value) in squares.iter_mut().zip(row) {
            *sum += f64::from(*value).powi(2);
        }
    }
    squares.into_iter().map(|sum| sum.sqrt() as f32).collect()
}

/// Adds the product of each expert to its matrix.
fn add_experts(experts: &Experts, values: &mut [f32], shape: &[usize]) -> Result<(), MllmError> {
    let &[count, rows, columns] = shape else {
        return Ok(());
    };
    let (a, b) = (experts.a.values()?, experts.b.values()?);
    let (rank, wide) = (experts.rank, if experts.older { rows } else { columns });
    let matrices = values.chunks_exact_mut(rows * columns);
    for (expert, (matrix, a)) in matrices.zip(a.chunks_exact(rank * wide)).enumerate() {
        // A row of B has the numbers of all experts for each rank.
        let b: Vec<f32> = b
            .chunks_exact(rank * count)
            .flat_map(|row| row.iter().skip(expert).step_by(count).copied())
            .collect();
        if experts.older {
            let left = super::change::transposed(a, rank, rows);
            let right = super::change::transposed(&b, columns, rank);
            add_product(matrix, columns, &left, &right, rank, experts.scale);
        } else {
            add_product(matrix, columns, &b, a, rank, experts.scale);
        }
    }
    Ok(())
}
