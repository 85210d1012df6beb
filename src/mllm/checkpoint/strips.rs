//! Reads matrices, large ones strip by strip: what is read and widened of them is never whole in memory.

use super::row_order::RowOrder;
use super::weight_file::TensorPlace;
use super::weight_format_plan::held_as;
use super::weights::{StoredTensor, Weights};
use crate::MllmError;
use planagent_kernels::matrix::{LANES, Matrix, WeightFormat};

/// Numbers of a strip: 64 MiB in f32.
pub(super) const STRIP: usize = 1 << 24;

impl Weights {
    /// The rows of a matrix that are read at once: all of a small one, and of one whose file reads
    /// only whole tensors.
    pub(super) fn rows_at_once(
        &self,
        stored: &StoredTensor,
        [outputs, inputs]: [usize; 2],
    ) -> usize {
        let file = self.files.get(stored.file);
        let in_parts = stored.rows == RowOrder::Plain
            && file.is_some_and(|file| file.reads_parts())
            && stored.place.bytes.is_multiple_of(outputs.max(1) as u64);
        if !in_parts {
            return outputs;
        }
        let step = (STRIP / inputs.max(1) / LANES).max(1) * LANES;
        outputs.min(step)
    }

    /// Reads a matrix of plain numbers or ggml's blocks.
    pub(super) fn matrix(
        &self,
        stored: &StoredTensor,
        shape: [usize; 2],
        wanted: WeightFormat,
    ) -> Result<Matrix, MllmError> {
        let [outputs, inputs] = shape;
        let step = self.rows_at_once(stored, shape);
        if step == outputs {
            return self.strip(stored, shape, wanted);
        }
        let row = stored.place.bytes / outputs as u64;
        Matrix::in_strips(wanted, shape, step, |rows| {
            let place = TensorPlace {
                shape: vec![rows.len(), inputs],
                begin: stored.place.begin + row * rows.start as u64,
                bytes: row * rows.len() as u64,
                ..stored.place
            };
            let strip = StoredTensor {
                place,
                ..stored.clone()
            };
            let read = self.strip(&strip, [rows.len(), inputs], wanted);
            read.map_err(|error| further(error, rows.start * inputs))
        })
    }

    /// Reads some rows of a matrix, or all.
    fn strip(
        &self,
        stored: &StoredTensor,
        [outputs, inputs]: [usize; 2],
        wanted: WeightFormat,
    ) -> Result<Matrix, MllmError> {
        let format = stored.place.format;
        if held_as(format) == Some(wanted) {
            let bytes = self.bytes(stored)?;
            self.check_blocks(stored, wanted, &bytes)?;
            return Ok(Matrix::from_blocks(wanted, outputs, inputs, &bytes)?);
        }
        Ok(Matrix::quantize(
            &self.values(stored)?,
            outputs,
            inputs,
            wanted,
        )?)
    }
}

/// An error about a strip that begins so many elements behind the first of its matrix.
fn further(error: MllmError, before: usize) -> MllmError {
    match error {
        MllmError::NonFiniteWeight {
            path,
            name,
            element,
            value,
        } => MllmError::NonFiniteWeight {
            path,
            name,
            element: element + before,
            value,
        },
        other => other,
    }
}
