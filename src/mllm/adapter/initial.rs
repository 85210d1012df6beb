//! What a base loses before an adapter is merged that was saved with the numbers of its start.

use super::leading::leading_vectors;
use nalgebra::DMatrix;

/// What the trainer took from the base when the adapter was made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Initial {
    /// Nothing.
    Same,
    /// `PiSSA`: the best approximation of the adapter's rank.
    Leading,
    /// `OLoRA`: the part in the span of the first columns, as many as the rank, times the scale.
    FirstColumns { scale: f64 },
}

/// Takes from a matrix with `columns` columns what an adapter of `rank` had at its start.
pub(super) fn subtract(initial: &Initial, values: &mut [f32], columns: usize, rank: usize) {
    let rows = values.len() / columns.max(1);
    let rank = rank.min(rows).min(columns);
    // nalgebra stores columns.
    let by_columns =
        || DMatrix::from_row_iterator(rows, columns, values.iter().copied().map(f64::from));
    let (matrix, basis, scale) = match initial {
        Initial::Same => return,
        Initial::FirstColumns { scale } => {
            let matrix = by_columns();
            let basis = orthonormal(matrix.columns(0, rank).into_owned());
            (matrix, basis, *scale)
        }
        Initial::Leading if rows > columns => {
            // The shorter side has the smaller problem; the part is the same.
            let matrix = by_columns().transpose();
            let basis = leading_vectors(&matrix, rank);
            let part = (&basis * (basis.transpose() * &matrix)).transpose();
            return minus(values, columns, &part, 1.0);
        }
        Initial::Leading => {
            let matrix = by_columns();
            let basis = leading_vectors(&matrix, rank);
            (matrix, basis, 1.0)
        }
    };
    let part = &basis * (basis.transpose() * &matrix);
    minus(values, columns, &part, scale);
}

fn minus(values: &mut [f32], columns: usize, part: &DMatrix<f64>, scale: f64) {
    for (row, part) in values.chunks_exact_mut(columns.max(1)).zip(part.row_iter()) {
        for (value, part) in row.iter_mut().zip(part.iter()) {
            *value = (f64::from(*value) - scale * part) as f32;
        }
    }
}

/// Makes columns orthonormal, in order. One that depends on those before it becomes zero.
pub(super) fn orthonormal(mut columns: DMatrix<f64>) -> DMatrix<f64> {
    /// Part of a column's length below which what is left of it is rounding.
    const ROUNDING: f64 = 1e-12;
    for index in 0..columns.ncols() {
        let (before, mut rest) = columns.columns_range_pair_mut(0..index, index..=index);
        let mut column = rest.column_mut(0);
        let length = column.norm();
        // Once more, since the first pass leaves what it rounded.
        for _ in 0..2 {
            for earlier in before.column_iter() {
                let along = earlier.dot(&column);
                column.axpy(-along, &earlier, 1.0);
            }
        }
        let left = column.norm();
        if left > ROUNDING * length {
            column /= left;
        } else {
            column.fill(0.0);
        }
    }
    columns
}
