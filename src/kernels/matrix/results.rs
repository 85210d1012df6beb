//! The numbers of a product: memory that threads fill column by column.
#![allow(
    unsafe_code,
    reason = "threads write disjoint columns of memory that nobody has written before"
)]

use super::format::{COLUMNS, TileSums};
use super::simd::Simd;
use crate::activation::Activation;
use std::marker::PhantomData;
use std::mem::MaybeUninit;

/// The row-major numbers of a product, (rows, outputs). The columns of its segments are written one
/// after the other.
#[derive(Debug)]
pub(super) struct Results {
    /// Has room for all numbers, and holds none before [`Self::finish`].
    numbers: Vec<f32>,
    rows: usize,
    outputs: usize,
    /// Columns that are written.
    written: usize,
}

/// What becomes of the sums of a row of activations.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Then<'a> {
    pub(super) onto: Onto<'a>,
    /// A number for each output of the whole product.
    pub(super) bias: Option<&'a [f32]>,
    /// Of the sum of all these.
    pub(super) activation: Option<Activation>,
}

/// What sums are added to.
#[derive(Debug, Clone, Copy, Default)]
pub(super) enum Onto<'a> {
    #[default]
    Nothing,
    /// Numbers in the layout of the results.
    Residual(&'a [f32]),
    /// What an earlier pass has written to the same columns.
    Written,
}

impl Results {
    pub(super) fn with_room(rows: usize, outputs: usize) -> Self {
        Self {
            numbers: Vec::with_capacity(rows * outputs),
            rows,
            outputs,
            written: 0,
        }
    }

    /// The next `width` columns, which `write` fills once for each of `passes`: every number of
    /// them. Nothing happens where there are fewer columns, or where `passes` do not fit.
    pub(super) fn append<'p, const PASSES: usize>(
        &mut self,
        width: usize,
        passes: [Then<'p>; PASSES],
        mut write: impl FnMut(usize, &Columns<'p>),
    ) {
        let count = self.rows * self.outputs;
        let fits = |then: &Then<'_>| {
            let residual = match then.onto {
                Onto::Residual(residual) => residual.len() == count,
                Onto::Nothing => true,
                Onto::Written => false,
            };
            residual && then.bias.is_none_or(|bias| bias.len() == self.outputs)
        };
        let later = |then: &Then<'_>| matches!(then.onto, Onto::Written) && then.bias.is_none();
        let [first, others @ ..] = passes.as_slice() else {
            return;
        };
        if self.written + width > self.outputs || !fits(first) || !others.iter().all(later) {
            return;
        }
        for (pass, then) in passes.into_iter().enumerate() {
            write(
                pass,
                &Columns {
                    start: self.numbers.spare_capacity_mut().as_mut_ptr(),
                    stride: self.outputs,
                    first: self.written,
                    width,
                    rows: self.rows,
                    then,
                    result: PhantomData,
                },
            );
        }
        self.written += width;
    }

    /// The numbers; `None` where columns are missing.
    pub(super) fn finish(mut self) -> Option<Vec<f32>> {
        if self.written != self.outputs {
            return None;
        }
        // SAFETY: `append` had all columns written.
        unsafe { self.numbers.set_len(self.rows * self.outputs) };
        Some(self.numbers)
    }
}

/// Columns of results that one product writes.
#[derive(Debug)]
pub(super) struct Columns<'a> {
    start: *mut MaybeUninit<f32>,
    stride: usize,
    first: usize,
    width: usize,
    rows: usize,
    then: Then<'a>,
    result: PhantomData<&'a mut [f32]>,
}

// SAFETY: a product gives every thread different columns.
unsafe impl Sync for Columns<'_> {}

impl Columns<'_> {
    /// Writes the sums of consecutive rows from a column on, up to the last column.
    ///
    /// # Safety
    /// No other thread may read or write these columns at the same time.
    #[inline(always)]
    pub(super) unsafe fn write<S: Simd>(
        &self,
        simd: S,
        row: usize,
        column: usize,
        sums: &mut [TileSums],
    ) {
        assert!(
            row + sums.len() <= self.rows && column < self.width,
            "a sum outside the result"
        );
        for (row, sums) in (row..).zip(sums.iter_mut()) {
            let place = row * self.stride + self.first + column;
            // SAFETY: an earlier pass has written these columns where sums are added to it.
            unsafe { self.complete(place, column, sums.as_flattened_mut()) };
        }
        if let Some(activation) = self.then.activation {
            let values = sums.as_flattened_mut().as_flattened_mut();
            simd.run(activation.in_place(values));
        }
        for (row, sums) in (row..).zip(sums) {
            let place = row * self.stride + self.first + column;
            let sums = sums.as_flattened();
            let left = self.width - column;
            // SAFETY: the assertion shows that the row and the columns from `column` on, at most
            // those left, are within the room; the caller has exclusive access.
            unsafe {
                let place = self.start.add(place).cast::<f32>();
                if sums.len() <= left {
                    // A known number, which needs no call.
                    place.copy_from_nonoverlapping(sums.as_ptr(), COLUMNS);
                } else {
                    place.copy_from_nonoverlapping(sums.as_ptr(), left);
                }
            }
        }
    }

    /// Adds to sums what belongs to them, from a place of the results on.
    ///
    /// # Safety
    /// With [`Onto::Written`], these numbers are written.
    #[inline(always)]
    unsafe fn complete(&self, place: usize, column: usize, sums: &mut [f32]) {
        let count = sums.len().min(self.width - column);
        let sums = &mut sums[..count];
        if let Some(bias) = self.then.bias {
            for (sum, bias) in sums.iter_mut().zip(&bias[self.first + column..]) {
                *sum += bias;
            }
        }
        match self.then.onto {
            // -0 becomes 0, as beside any other residual.
            Onto::Nothing => sums.iter_mut().for_each(|sum| *sum += 0.0),
            Onto::Residual(residual) => {
                for (sum, residual) in sums.iter_mut().zip(&residual[place..]) {
                    *sum += residual;
                }
            }
            Onto::Written => {
                // SAFETY: the caller says that they are written, and the assertion of `write` that
                // they are within the room.
                let written =
                    unsafe { std::slice::from_raw_parts(self.start.add(place).cast(), count) };
                for (sum, written) in sums.iter_mut().zip::<&[f32]>(written) {
                    *sum += written;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_that_nobody_wrote_are_no_result() {
        let then = Then::default();
        let long = [0.0; 7];
        let residual = Then {
            onto: Onto::Residual(&long),
            ..then
        };
        let written = Then {
            onto: Onto::Written,
            ..then
        };
        let mut results = Results::with_room(2, 3);
        assert!(Results::with_room(2, 3).finish().is_none());
        // More columns than there are, a residual of another size, and a first pass that reads.
        results.append(4, [then], |_, _| panic!("there are three columns"));
        results.append(3, [residual], |_, _| {
            panic!("the residual has seven numbers")
        });
        results.append(3, [written], |_, _| panic!("nothing is written"));
        results.append(3, [], |_, _| panic!("there is no pass"));
        assert!(results.finish().is_none());
    }
}
