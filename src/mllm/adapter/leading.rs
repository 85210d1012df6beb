//! The leading singular vectors of a matrix.

use super::initial::orthonormal;
use nalgebra::{DMatrix, SymmetricEigen};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// Rows up to which the whole decomposition is computed.
const DIRECT: usize = 384;
/// Vectors of a block beside the wanted ones.
const SPARE: usize = 8;
/// Largest residual of a vector that is taken as found, relative to the largest eigenvalue.
const TOLERANCE: f64 = 1e-10;

/// The left singular vectors of the `rank` largest singular values of a matrix that is not taller
/// than wide, as columns.
pub(super) fn leading_vectors(matrix: &DMatrix<f64>, rank: usize) -> DMatrix<f64> {
    let transposed = matrix.transpose();
    if matrix.nrows() <= DIRECT {
        return leading_of(matrix * &transposed, rank);
    }
    in_krylov_space(matrix.nrows(), |block| matrix * (&transposed * block), rank)
}

/// The eigenvectors of the `rank` largest eigenvalues of a symmetric matrix.
fn leading_of(symmetric: DMatrix<f64>, rank: usize) -> DMatrix<f64> {
    let decomposed = SymmetricEigen::new(symmetric);
    let values = &decomposed.eigenvalues;
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|a, b| {
        let value = |at: &usize| values.get(*at).copied().unwrap_or(f64::MIN);
        value(b).total_cmp(&value(a))
    });
    order.truncate(rank);
    decomposed.eigenvectors.select_columns(&order)
}

/// The same of an operator on `size` numbers, in the space of a random block and of its products
/// with the operator (Musco and Musco, arXiv:1504.05477). It ends when the residuals are small, or
/// with the whole space.
fn in_krylov_space(
    size: usize,
    operator: impl Fn(&DMatrix<f64>) -> DMatrix<f64>,
    rank: usize,
) -> DMatrix<f64> {
    let mut random = Pcg64Mcg::seed_from_u64(0);
    let width = (rank + SPARE).min(size);
    let start = DMatrix::from_fn(size, width, |_, _| random.random_range(-1.0..1.0));
    let mut basis = orthonormal(start);
    let mut products = operator(&basis);
    let mut looked_at = 0;
    loop {
        let whole = basis.ncols() >= size;
        // A look costs as much as many blocks.
        if whole || basis.ncols() >= looked_at + looked_at / 2 {
            looked_at = basis.ncols();
            let small = basis.transpose() * &products;
            let inner = leading_of((&small + small.transpose()) * 0.5, rank);
            let found = &basis * &inner;
            let images = &products * &inner;
            if whole || residual(&found, &images) < TOLERANCE {
                return found;
            }
        }
        let last = products.columns_range(basis.ncols() - width.min(basis.ncols())..);
        let next = last.into_owned();
        let known = basis.ncols();
        let joined = join(
            &basis,
            &next.columns(0, next.ncols().min(size - known)).into_owned(),
        );
        basis = orthonormal_behind(&joined, known);
        let block = basis.columns_range(known..).into_owned();
        products = join(&products, &operator(&block));
    }
}

/// The largest residual of eigenvectors, relative to the largest eigenvalue.
fn residual(found: &DMatrix<f64>, images: &DMatrix<f64>) -> f64 {
    let (mut largest, mut worst) = (f64::MIN_POSITIVE, 0.0_f64);
    for (vector, image) in found.column_iter().zip(images.column_iter()) {
        let value = vector.dot(&image);
        largest = largest.max(value.abs());
        worst = worst.max((image - vector * value).norm());
    }
    worst / largest
}

fn join(left: &DMatrix<f64>, right: &DMatrix<f64>) -> DMatrix<f64> {
    let columns: Vec<_> = left.column_iter().chain(right.column_iter()).collect();
    DMatrix::from_columns(&columns)
}

/// Makes the columns from `known` on orthonormal among themselves and to those before, which are.
fn orthonormal_behind(columns: &DMatrix<f64>, known: usize) -> DMatrix<f64> {
    let before = columns.columns(0, known).into_owned();
    let mut rest = columns.columns_range(known..).into_owned();
    for _ in 0..2 {
        rest -= &before * (before.transpose() * &rest);
        rest = orthonormal(rest);
    }
    join(&before, &rest)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_ways_find_the_same_part() {
        let mut random = Pcg64Mcg::seed_from_u64(3);
        let matrix = DMatrix::from_fn(60, 90, |_, _| random.random_range(-1.0..1.0));
        let direct = leading_vectors(&matrix, 5);
        let transposed = matrix.transpose();
        let other = in_krylov_space(60, |block| &matrix * (&transposed * block), 5);
        let part = |basis: &DMatrix<f64>| basis * (basis.transpose() * &matrix);
        let difference = (part(&direct) - part(&other)).abs().max();
        assert!(difference < 1e-7, "{difference}");
    }
}
