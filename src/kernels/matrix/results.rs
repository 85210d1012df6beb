//! The numbers of a product: memory that threads fill column by column.
//! Why: docs/decisions/138-results-are-written-once.md.
#![allow(
    unsafe_code,
    reason = "threads write disjoint columns of memory that nobody has written before"
)]

use super::format::{COLUMNS, TileSums};
use super::line::{CacheLine, LANES};
use super::packed_tiles::PackedTiles;
use super::product;
use super::simd::{Instructions, Simd};
use crate::activation::Activation;
use crate::values::clamp;
use candle_core::{Device, Tensor, bail};
use std::mem::MaybeUninit;

/// The row-major numbers of a product, (rows, outputs). The columns of its segments are written one
/// after the other.
#[derive(Debug)]
pub(super) struct Results {
    /// Has room for all numbers, and holds none before [`Self::finish`] but those that are skipped.
    numbers: Vec<f32>,
    /// Numbers that are skipped, so that the first of the product begins a cache line. Else each
    /// piece of a row would share its lines with the next piece, which is written much later.
    skipped: usize,
    rows: usize,
    outputs: usize,
    /// Columns that are written.
    written: usize,
}

/// Activations that are multiplied with the weights of some columns.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pass<'a> {
    /// (rows, inputs)
    pub(super) x: &'a [f32],
    /// Least and greatest that the activations are clamped to.
    pub(super) bounds: Option<[f32; 2]>,
    pub(super) then: Then<'a>,
}

/// What becomes of the sums of a row of activations.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Then<'a> {
    pub(super) onto: Onto<'a>,
    /// A number for each output of the whole product.
    pub(super) bias: Option<&'a [f32]>,
    /// A factor for each output of the whole product, of its sum and bias.
    pub(super) scale: Option<&'a [f32]>,
    /// Least and greatest that the sum of all these is clamped to.
    pub(super) bounds: Option<[f32; 2]>,
    /// Applied to the sum.
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
        let mut numbers: Vec<f32> = Vec::with_capacity(rows * outputs + LANES - 1);
        let skipped = numbers.as_ptr().align_offset(size_of::<CacheLine>());
        // The offset may be unknown, as in an interpreter.
        numbers.resize(skipped.min(LANES - 1), 0.0);
        Self {
            skipped: numbers.len(),
            numbers,
            rows,
            outputs,
            written: 0,
        }
    }

    /// Appends the columns of tiles: their products with each of `passes`. Does nothing if columns or
    /// passes do not fit.
    pub(super) fn append(
        &mut self,
        tiles: &PackedTiles,
        passes: &[Pass<'_>],
        instructions: Instructions,
    ) {
        let room = self.written + tiles.outputs() <= self.outputs;
        if passes.is_empty() || !room || !self.fit(tiles, passes) {
            return;
        }
        for Pass { x, bounds, then } in passes {
            let columns = Columns {
                start: self.numbers.spare_capacity_mut().as_mut_ptr(),
                stride: self.outputs,
                first: self.written,
                width: tiles.outputs(),
                rows: self.rows,
                then: *then,
            };
            product::multiply(tiles, x, *bounds, &columns, instructions);
        }
        self.written += tiles.outputs();
    }

    /// Whether each pass has a number for each place, and the first alone needs no earlier one.
    fn fit(&self, tiles: &PackedTiles, passes: &[Pass<'_>]) -> bool {
        passes
            .iter()
            .enumerate()
            .all(|(index, Pass { x, then, .. })| {
                let onto = match then.onto {
                    Onto::Nothing => index == 0,
                    Onto::Residual(residual) => {
                        index == 0 && residual.len() == self.rows * self.outputs
                    }
                    Onto::Written => index > 0,
                };
                onto && x.len() == self.rows * tiles.inputs()
                    && [then.bias, then.scale]
                        .iter()
                        .flatten()
                        .all(|row| row.len() == self.outputs)
            })
    }

    /// The numbers, (rows, outputs).
    ///
    /// # Errors
    /// When columns are missing.
    pub(super) fn finish(mut self) -> candle_core::Result<Tensor> {
        if self.written != self.outputs {
            let (written, outputs) = (self.written, self.outputs);
            bail!("a product has {written} of its {outputs} columns");
        }
        let count = self.rows * self.outputs;
        // SAFETY: `append` checked that activations and tiles cover all rows and columns, and
        // `multiply` writes each of their sums.
        unsafe { self.numbers.set_len(self.skipped + count) };
        Tensor::from_vec(self.numbers, self.skipped + count, &Device::Cpu)?
            .narrow(0, self.skipped, count)?
            .reshape((self.rows, self.outputs))
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
}

// SAFETY: a product gives every thread different columns.
unsafe impl Sync for Columns<'_> {}

impl Columns<'_> {
    /// Writes the sums of consecutive rows from a column on, up to the last column.
    ///
    /// # Safety
    /// No other thread may read or write these columns at the same time. With [`Onto::Written`], an
    /// earlier pass has written them.
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
            // SAFETY: the caller says that an earlier pass has written what is read here.
            unsafe { self.complete(simd, place, column, sums) };
        }
        if let Some(bounds) = self.then.bounds {
            clamp(sums.as_flattened_mut().as_flattened_mut(), bounds);
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
                    // A constant length, so that the copy is no call.
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
    unsafe fn complete<S: Simd>(&self, simd: S, place: usize, column: usize, sums: &mut TileSums) {
        let count = COLUMNS.min(self.width - column);
        if let Some(bias) = self.then.bias {
            add(simd, sums, &bias[self.first + column..][..count]);
        }
        if let Some(scale) = self.then.scale {
            multiply(simd, sums, &scale[self.first + column..][..count]);
        }
        match self.then.onto {
            // −0 becomes 0, as in a sum that starts at 0.
            Onto::Nothing => add(simd, sums, &[0.0; COLUMNS]),
            Onto::Residual(residual) => add(simd, sums, &residual[place..][..count]),
            Onto::Written => {
                // SAFETY: the caller says that they are written, and the assertion of `write` that
                // they are within the room.
                let written =
                    unsafe { std::slice::from_raw_parts(self.start.add(place).cast(), count) };
                add(simd, sums, written);
            }
        }
    }
}

/// Adds numbers to as many sums.
#[inline(always)]
fn add<S: Simd>(simd: S, sums: &mut TileSums, numbers: &[f32]) {
    // A constant length, so that all numbers stay in registers.
    if let Some(numbers) = numbers.first_chunk::<COLUMNS>() {
        for (sums, numbers) in sums.iter_mut().zip(numbers.as_chunks().0) {
            simd.store(simd.add(simd.load(sums), simd.load(numbers)), sums);
        }
    } else {
        for (sum, number) in sums.as_flattened_mut().iter_mut().zip(numbers) {
            *sum += number;
        }
    }
}

/// Multiplies sums by as many numbers.
#[inline(always)]
fn multiply<S: Simd>(simd: S, sums: &mut TileSums, numbers: &[f32]) {
    if let Some(numbers) = numbers.first_chunk::<COLUMNS>() {
        for (sums, numbers) in sums.iter_mut().zip(numbers.as_chunks().0) {
            simd.store(simd.mul(simd.load(sums), simd.load(numbers)), sums);
        }
    } else {
        for (sum, number) in sums.as_flattened_mut().iter_mut().zip(numbers) {
            *sum *= number;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::weight_format::WeightFormat;
    use super::*;

    fn pass<'a>(x: &'a [f32], then: Then<'a>) -> Pass<'a> {
        let bounds = None;
        Pass { x, bounds, then }
    }

    #[test]
    fn columns_that_nobody_wrote_are_no_result() {
        let tiles = PackedTiles::pack(WeightFormat::F32, 3, 2, &[0; 24]);
        let x = [0.0; 4];
        let then = Then::default();
        let long = [0.0; 7];
        let residual = Then {
            onto: Onto::Residual(&long),
            ..then
        };
        let bias = Then {
            bias: Some(&long),
            ..then
        };
        let written = Then {
            onto: Onto::Written,
            ..then
        };
        let finished = |outputs, passes: &[Pass<'_>]| {
            let mut results = Results::with_room(2, outputs);
            results.append(&tiles, passes, Instructions::best());
            results.finish()
        };
        let whole = finished(3, &[pass(&x, then)]).unwrap();
        assert_eq!(whole.to_vec2::<f32>().unwrap(), [[0.0; 3]; 2]);
        let short = &x[..2];
        assert!(finished(3, &[]).is_err());
        assert!(finished(2, &[pass(&x, then)]).is_err());
        assert!(finished(4, &[pass(&x, then)]).is_err());
        assert!(finished(3, &[pass(short, then)]).is_err());
        let scale = Then {
            scale: Some(&long),
            ..then
        };
        for then in [residual, bias, scale, written] {
            assert!(finished(3, &[pass(&x, then)]).is_err());
        }
        let twice = [pass(&x, then); 2];
        assert!(finished(3, &twice).is_err());
    }
}
