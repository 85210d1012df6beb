//! Weight matrices in their stored weight format, and their products with rows of activations.
#![allow(
    clippy::inline_always,
    reason = "kernels must be inlined into the functions that enable the instructions"
)]

mod blocks;
mod float;
mod format;
mod line;
mod packed_tiles;
mod probe;
mod product;
mod quantized;
mod results;
mod simd;
mod stored_format;
#[cfg(test)]
mod tests;
mod weight_format;

use candle_core::{Device, Result, Tensor, bail};
use rayon::prelude::*;
use std::borrow::Cow;
use std::io::{self, Write};
use std::ops::Range;
use std::sync::Arc;

// Tests of other crates compare with it.
#[doc(hidden)]
pub use blocks::widen;
pub use line::{CacheLine, LANES};
use packed_tiles::PackedTiles;
pub(crate) use probe::byte_operations;
use results::{Onto, Pass, Results, Then};
pub use simd::{Instructions, Kernel, Simd};
pub use stored_format::StoredFormat;
pub use weight_format::{UnknownWeightFormat, WeightFormat};

use super::values::{TASK_NUMBERS, with_optional, with_values};
use super::{Activation, Work};

/// A matrix W of shape (outputs, inputs); its product with rows x is x Wᵀ. Clones share one copy of
/// the weights.
#[derive(Debug, Clone)]
pub struct Matrix {
    inputs: usize,
    outputs: usize,
    /// Consecutive rows in one weight format. A stack of matrices may have more than one segment.
    segments: Vec<Arc<PackedTiles>>,
    /// Whether what rounding takes from the activations is multiplied too.
    in_two_terms: bool,
}

/// What stands beside a product of clamped activations: f(clamped(scale · (product + bias) +
/// residual)).
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Beside<'a> {
    /// (outputs)
    pub(crate) bias: Option<&'a Tensor>,
    /// (outputs)
    pub(crate) scale: Option<&'a Tensor>,
    /// (tokens, outputs)
    pub(crate) residual: Option<&'a Tensor>,
    /// Least and greatest of the activations, and of the sums.
    pub(crate) bounds: Option<[[f32; 2]; 2]>,
    pub(crate) activation: Option<Activation>,
}

impl Matrix {
    /// Whether a weight format can hold a matrix of this shape.
    pub fn fits(weight_format: WeightFormat, outputs: usize, inputs: usize) -> bool {
        outputs > 0 && inputs > 0 && weight_format.matrix_bytes(outputs, inputs).is_some()
    }

    /// Quantizes row-major values, to ggml's formats with its reference quantizers. Zeros fill the
    /// last block of a row.
    pub fn quantize(
        values: &[f32],
        outputs: usize,
        inputs: usize,
        weight_format: WeightFormat,
    ) -> Result<Self> {
        check_shape(weight_format, outputs, inputs)?;
        if outputs.checked_mul(inputs) != Some(values.len()) {
            bail!(
                "{} values do not fill a matrix of {outputs} x {inputs}",
                values.len()
            );
        }
        let format = weight_format.stored();
        let values = in_whole_blocks(values, inputs, weight_format.block());
        let mut blocks =
            vec![0; values.len() / weight_format.block() * weight_format.block_bytes()];
        let pieces = blocks
            .par_chunks_mut(TASK_NUMBERS / weight_format.block() * weight_format.block_bytes());
        pieces
            .zip(values.par_chunks(TASK_NUMBERS))
            .try_for_each(|(blocks, values)| {
                blocks.copy_from_slice(&format.round(values)?);
                Result::Ok(())
            })?;
        Self::from_blocks(weight_format, outputs, inputs, &blocks)
    }

    /// Takes ggml's row-major blocks as a GGUF file stores them.
    pub fn from_blocks(
        weight_format: WeightFormat,
        outputs: usize,
        inputs: usize,
        bytes: &[u8],
    ) -> Result<Self> {
        check_shape(weight_format, outputs, inputs)?;
        if weight_format.matrix_bytes(outputs, inputs) != Some(bytes.len()) {
            bail!(
                "{} bytes do not fill a {weight_format} matrix of {outputs} x {inputs}",
                bytes.len()
            );
        }
        let tiles = PackedTiles::pack(weight_format, outputs, inputs, bytes);
        Ok(Self {
            inputs,
            outputs,
            segments: vec![Arc::new(tiles)],
            in_two_terms: false,
        })
    }

    /// Makes a matrix strip by strip, so that the numbers of one strip at a time are in memory
    /// beside it: `read` gives the matrix of some rows, as many as were asked for, in this format.
    /// A strip but the last has `step` rows, a multiple of [`LANES`].
    ///
    /// # Errors
    /// Those of `read`, and when a strip does not fit.
    pub fn in_strips<E: From<candle_core::Error>>(
        weight_format: WeightFormat,
        [outputs, inputs]: [usize; 2],
        step: usize,
        mut read: impl FnMut(Range<usize>) -> std::result::Result<Self, E>,
    ) -> std::result::Result<Self, E> {
        check_shape(weight_format, outputs, inputs)?;
        let mut whole = PackedTiles::with_room(weight_format, outputs, inputs);
        for first in (0..outputs).step_by(step.max(1)) {
            let rows = first..outputs.min(first + step);
            let strip = read(rows.clone())?;
            let fits = match strip.segments.as_slice() {
                [segment] => segment.outputs() == rows.len() && whole.append(segment),
                _ => false,
            };
            if !fits {
                let problem = format!("a strip is no matrix of {} rows", rows.len());
                return Err(candle_core::Error::Msg(problem).into());
            }
        }
        Ok(Self {
            inputs,
            outputs,
            segments: vec![Arc::new(whole)],
            in_two_terms: false,
        })
    }

    /// Takes an f32 tensor of shape (outputs, inputs).
    pub fn from_tensor(tensor: &Tensor) -> Result<Self> {
        let (outputs, inputs) = tensor.dims2()?;
        let bytes = |values: &[f32]| {
            Ok(values
                .iter()
                .flat_map(|value| value.to_le_bytes())
                .collect::<Vec<u8>>())
        };
        Self::from_blocks(
            WeightFormat::F32,
            outputs,
            inputs,
            &with_values(tensor, bytes)?,
        )
    }

    /// Concatenates the outputs of matrices with the same inputs, so that one product replaces
    /// several. Their weight formats may differ.
    pub fn stack(matrices: Vec<Self>) -> Result<Self> {
        let Some(inputs) = matrices.first().map(|matrix| matrix.inputs) else {
            bail!("cannot stack zero matrices");
        };
        if let Some(other) = matrices.iter().find(|matrix| matrix.inputs != inputs) {
            bail!(
                "cannot stack matrices of {inputs} and {} inputs",
                other.inputs
            );
        }
        let outputs = matrices.iter().map(|matrix| matrix.outputs).sum();
        let in_two_terms = matrices.iter().any(|matrix| matrix.in_two_terms);
        let mut segments: Vec<Arc<PackedTiles>> = Vec::new();
        for segment in matrices.into_iter().flat_map(|matrix| matrix.segments) {
            let last = segments.last_mut().and_then(Arc::get_mut);
            if !last.is_some_and(|last| last.append(&segment)) {
                segments.push(segment);
            }
        }
        Ok(Self {
            inputs,
            outputs,
            segments,
            in_two_terms,
        })
    }

    /// Multiplies rounded activations and, in a second pass over the weights, what rounding takes
    /// from them: for activations with outliers (docs/decisions/131-two-terms.md). Products with
    /// floats round nothing and stay as they are.
    #[must_use]
    pub fn in_two_terms(self) -> Self {
        Self {
            in_two_terms: true,
            ..self
        }
    }

    /// Rows of the matrix: numbers of a product.
    pub fn outputs(&self) -> usize {
        self.outputs
    }

    /// Columns of the matrix: numbers of a row of activations.
    pub fn inputs(&self) -> usize {
        self.inputs
    }

    /// The weight format of the first segment.
    pub fn weight_format(&self) -> WeightFormat {
        self.segments
            .first()
            .map_or_else(WeightFormat::default, |segment| segment.weight_format())
    }

    /// Size in memory, bytes.
    pub fn bytes(&self) -> usize {
        self.segments.iter().map(|segment| segment.bytes()).sum()
    }

    /// Writes the row-major blocks that [`Self::from_blocks`] takes, bit for bit, segment after
    /// segment.
    pub fn write_blocks(&self, out: &mut dyn Write) -> io::Result<()> {
        self.segments
            .iter()
            .try_for_each(|segment| segment.write_blocks(out))
    }

    /// Reads rows of the matrix as f32, (ids, inputs), as an embedding needs them.
    pub fn rows(&self, ids: &[u32]) -> Result<Tensor> {
        let mut values = vec![0.0; ids.len() * self.inputs];
        for (id, row) in ids.iter().zip(values.chunks_exact_mut(self.inputs)) {
            let mut index = *id as usize;
            let segment = self.segments.iter().find(|segment| {
                let found = index < segment.outputs();
                if !found {
                    index -= segment.outputs();
                }
                found
            });
            let Some(segment) = segment else {
                bail!(
                    "row {id} is out of range: the matrix has {} rows",
                    self.outputs
                );
            };
            segment.read_row(index, row)?;
        }
        Tensor::from_vec(values, (ids.len(), self.inputs), &Device::Cpu)
    }

    /// Maps f32 rows (tokens, inputs) to (tokens, outputs).
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        self.forward_then(x, &Beside::default())
    }

    /// The product with rows (tokens, inputs), and what is computed beside it in one pass over the
    /// numbers.
    pub(crate) fn forward_then(&self, x: &Tensor, beside: &Beside<'_>) -> Result<Tensor> {
        let Beside {
            bias,
            scale,
            residual,
            bounds,
            activation,
        } = *beside;
        let (tokens, width) = x.dims2()?;
        if width != self.inputs {
            bail!(
                "cannot multiply rows of {width} numbers with a matrix of {} inputs",
                self.inputs
            );
        }
        let shape = [tokens, self.outputs];
        let of_shapes = [
            (bias, &shape[1..]),
            (scale, &shape[1..]),
            (residual, &shape[..]),
        ];
        for (tensor, expected) in of_shapes {
            if let Some(tensor) = tensor.filter(|tensor| tensor.dims() != expected) {
                let found = tensor.shape();
                bail!("cannot add a tensor of {found:?} to a product of {expected:?}");
            }
        }
        // After all checks, so that the work of a refused product is not counted.
        Work::count(tokens, self.inputs, self.outputs, self.bytes());
        with_values(x, |x| {
            with_optional(bias, |bias| {
                with_optional(scale, |scale| {
                    with_optional(residual, |residual| {
                        let onto = residual.map_or(Onto::Nothing, Onto::Residual);
                        let then = Then {
                            onto,
                            bias,
                            scale,
                            bounds: bounds.map(|[_, of_sums]| of_sums),
                            activation,
                        };
                        let bounds = bounds.map(|[of_activations, _]| of_activations);
                        self.product(Pass { x, bounds, then }, tokens)
                    })
                })
            })
        })
    }

    /// The result of [`Self::forward_then`].
    fn product(&self, pass: Pass<'_>, tokens: usize) -> Result<Tensor> {
        let Pass { x, bounds, then } = pass;
        let mut results = Results::with_room(tokens, self.outputs);
        for segment in &self.segments {
            let rounded = segment.weight_format().activations_a_scale();
            let lost = rounded
                .filter(|_| self.in_two_terms)
                .map(|scaled| quantized::lost_by_rounding(x, bounds, self.inputs, scaled));
            // The second pass completes the sums, so bounds and activation wait for it.
            let passes = match &lost {
                None => &[pass][..],
                Some(lost) => &[
                    Pass {
                        x,
                        bounds,
                        then: Then {
                            bounds: None,
                            activation: None,
                            ..then
                        },
                    },
                    Pass {
                        x: lost,
                        bounds: None,
                        then: Then {
                            onto: Onto::Written,
                            bias: None,
                            ..then
                        },
                    },
                ],
            };
            results.append(segment, passes, Instructions::best());
        }
        results.finish()
    }
}

/// The rows with zeros behind them, as far as these fill blocks.
fn in_whole_blocks(values: &[f32], inputs: usize, block: usize) -> Cow<'_, [f32]> {
    let whole = inputs.next_multiple_of(block);
    if whole == inputs {
        return values.into();
    }
    let mut filled = vec![0.0; values.len() / inputs * whole];
    for (filled, row) in filled.chunks_mut(whole).zip(values.chunks(inputs)) {
        filled[..inputs].copy_from_slice(row);
    }
    filled.into()
}

fn check_shape(weight_format: WeightFormat, outputs: usize, inputs: usize) -> Result<()> {
    if !Matrix::fits(weight_format, outputs, inputs) {
        bail!(
            "{weight_format} cannot hold a matrix of {outputs} x {inputs}: rows are in blocks of {}",
            weight_format.block()
        );
    }
    Ok(())
}
