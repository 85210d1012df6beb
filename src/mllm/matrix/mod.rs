//! Weight matrices in their stored weight format, and their products with rows of activations.
#![allow(clippy::inline_always, reason = "kernels must be inlined into the functions that enable the instructions")]

mod blocks;
mod float;
mod format;
mod line;
mod packed_tiles;
mod product;
mod quantized;
mod simd;
mod stored_format;
#[cfg(test)]
mod tests;
mod weight_format;

use std::io::{self, Write};
use std::sync::Arc;

use candle_core::quantized::QTensor;
use candle_core::{Device, Result, Tensor, bail};
use rayon::prelude::*;

pub(crate) use blocks::widen;
pub(crate) use line::LANES;
use packed_tiles::PackedTiles;
use product::Columns;
pub(crate) use simd::{Instructions, Kernel, Simd};
pub(crate) use stored_format::StoredFormat;
pub use weight_format::{UnknownWeightFormat, WeightFormat};

use super::values::{PIECE, with_values};

/// A matrix W of shape (outputs, inputs); its product with rows x is x Wᵀ. Clones share one copy of the weights.
#[derive(Debug, Clone)]
pub struct Matrix {
    inputs: usize,
    outputs: usize,
    /// Their outputs are concatenated. A stack of matrices has more than one segment.
    segments: Vec<Arc<Segment>>,
}

/// Consecutive rows of a matrix in one weight format.
#[derive(Debug)]
enum Segment {
    /// f32 of shape (outputs, inputs), multiplied by candle.
    Tensor(Tensor),
    /// Any other weight format.
    Tiles(PackedTiles),
}

impl Matrix {
    /// Whether a weight format can hold a matrix of this shape.
    pub fn fits(weight_format: WeightFormat, outputs: usize, inputs: usize) -> bool {
        outputs > 0 && inputs > 0 && weight_format.matrix_bytes(outputs, inputs).is_some()
    }

    /// Quantizes row-major values with ggml's reference quantizers.
    pub fn quantize(values: &[f32], outputs: usize, inputs: usize, weight_format: WeightFormat) -> Result<Self> {
        check_shape(weight_format, outputs, inputs)?;
        if outputs.checked_mul(inputs) != Some(values.len()) {
            bail!("{} values do not fill a matrix of {outputs} x {inputs}", values.len());
        }
        if weight_format == WeightFormat::F32 {
            let tensor = Tensor::from_slice(values, (outputs, inputs), &Device::Cpu)?;
            return Self::from_tensor(&tensor);
        }
        let mut blocks = vec![0; values.len() / weight_format.block() * weight_format.block_bytes()];
        let pieces = blocks.par_chunks_mut(PIECE / weight_format.block() * weight_format.block_bytes());
        pieces.zip(values.par_chunks(PIECE)).try_for_each(|(blocks, values)| {
            let tensor = Tensor::from_slice(values, values.len(), &Device::Cpu)?;
            blocks.copy_from_slice(&QTensor::quantize(&tensor, weight_format.ggml())?.data()?);
            Result::Ok(())
        })?;
        Self::from_blocks(weight_format, outputs, inputs, &blocks)
    }

    /// Takes ggml's row-major blocks as a GGUF file stores them.
    pub fn from_blocks(weight_format: WeightFormat, outputs: usize, inputs: usize, bytes: &[u8]) -> Result<Self> {
        check_shape(weight_format, outputs, inputs)?;
        if weight_format.matrix_bytes(outputs, inputs) != Some(bytes.len()) {
            bail!("{} bytes do not fill a {weight_format} matrix of {outputs} x {inputs}", bytes.len());
        }
        if weight_format == WeightFormat::F32 {
            let values = widen(weight_format.ggml(), bytes.to_vec())?;
            return Self::from_tensor(&Tensor::from_vec(values, (outputs, inputs), &Device::Cpu)?);
        }
        Ok(Self {
            inputs,
            outputs,
            segments: vec![Arc::new(Segment::Tiles(PackedTiles::pack(weight_format, outputs, inputs, bytes)))],
        })
    }

    /// Takes an f32 tensor of shape (outputs, inputs).
    pub fn from_tensor(tensor: &Tensor) -> Result<Self> {
        let (outputs, inputs) = tensor.dims2()?;
        Ok(Self { inputs, outputs, segments: vec![Arc::new(Segment::Tensor(tensor.contiguous()?))] })
    }

    /// Concatenates the outputs of matrices with the same inputs, so that one product replaces several. Their weight
    /// formats may differ.
    pub fn stack(matrices: Vec<Self>) -> Result<Self> {
        let Some(inputs) = matrices.first().map(|matrix| matrix.inputs) else {
            bail!("cannot stack zero matrices");
        };
        if let Some(other) = matrices.iter().find(|matrix| matrix.inputs != inputs) {
            bail!("cannot stack matrices of {inputs} and {} inputs", other.inputs);
        }
        let outputs = matrices.iter().map(|matrix| matrix.outputs).sum();
        let mut segments: Vec<Arc<Segment>> = Vec::new();
        for segment in matrices.into_iter().flat_map(|matrix| matrix.segments) {
            let apart = match segments.last_mut().and_then(Arc::get_mut) {
                Some(last) => last.append(segment)?,
                None => Some(segment),
            };
            segments.extend(apart);
        }
        Ok(Self { inputs, outputs, segments })
    }

    pub fn outputs(&self) -> usize {
        self.outputs
    }

    pub fn inputs(&self) -> usize {
        self.inputs
    }

    /// The weight format of the first segment.
    pub fn weight_format(&self) -> WeightFormat {
        self.segments.first().map_or_else(WeightFormat::default, |segment| segment.weight_format())
    }

    /// Whether the product of a row has the same bits whatever rows are multiplied with it. candle sums a single row in another
    /// order than several.
    pub(crate) fn is_exact_by_row(&self) -> bool {
        self.segments.iter().all(|segment| matches!(**segment, Segment::Tiles(_)))
    }

    /// Size in memory, bytes.
    pub fn bytes(&self) -> usize {
        self.segments.iter().map(|segment| segment.bytes()).sum()
    }

    /// Writes the row-major blocks that [`Self::from_blocks`] takes, bit for bit, segment after segment.
    pub fn write_blocks(&self, out: &mut dyn Write) -> io::Result<()> {
        self.segments.iter().try_for_each(|segment| segment.write_blocks(out))
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
                bail!("row {id} is out of range: the matrix has {} rows", self.outputs);
            };
            segment.read_row(index, row)?;
        }
        Tensor::from_vec(values, (ids.len(), self.inputs), &Device::Cpu)
    }

    /// Maps f32 rows (tokens, inputs) to (tokens, outputs).
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        self.forward_onto(x, None, None)
    }

    /// The product with rows (tokens, inputs) plus a bias (outputs) plus a residual (tokens, outputs).
    pub(crate) fn forward_onto(&self, x: &Tensor, bias: Option<&Tensor>, residual: Option<&Tensor>) -> Result<Tensor> {
        let (tokens, width) = x.dims2()?;
        if width != self.inputs {
            bail!("cannot multiply rows of {width} numbers with a matrix of {} inputs", self.inputs);
        }
        if let [segment] = self.segments.as_slice()
            && let Segment::Tensor(weights) = &**segment
        {
            let product = x.matmul(&weights.t()?)?;
            let product = bias.map_or(Ok(product.clone()), |bias| product.broadcast_add(bias))?;
            return residual.map_or(Ok(product.clone()), |residual| residual + &product);
        }
        let read = |tensor: &Tensor, shape: &[usize]| {
            if tensor.dims() == shape {
                with_values(tensor, |values| Ok(values.to_vec()))
            } else {
                bail!("cannot add a tensor of {:?} to a product of {shape:?}", tensor.shape())
            }
        };
        let bias = bias.map(|bias| read(bias, &[self.outputs])).transpose()?;
        let mut result = match residual {
            Some(residual) => read(residual, &[tokens, self.outputs])?,
            None => vec![0.0; tokens * self.outputs],
        };
        with_values(x, |x| {
            let mut first = 0;
            for segment in &self.segments {
                let bias = bias.as_deref().and_then(|bias| bias.get(first..first + segment.outputs()));
                let columns = Columns::new(&mut result, self.outputs, first, segment.outputs(), bias);
                first += segment.outputs();
                if let Some(columns) = columns {
                    segment.multiply(x, &columns)?;
                }
            }
            Ok(())
        })?;
        Tensor::from_vec(result, (tokens, self.outputs), &Device::Cpu)
    }
}

impl Segment {
    fn weight_format(&self) -> WeightFormat {
        match self {
            Self::Tensor(_) => WeightFormat::F32,
            Self::Tiles(tiles) => tiles.weight_format(),
        }
    }

    fn outputs(&self) -> usize {
        match self {
            Self::Tensor(weights) => weights.dims().first().copied().unwrap_or(0),
            Self::Tiles(tiles) => tiles.outputs(),
        }
    }

    fn bytes(&self) -> usize {
        match self {
            Self::Tensor(weights) => weights.elem_count() * size_of::<f32>(),
            Self::Tiles(tiles) => tiles.bytes(),
        }
    }

    /// Appends another segment to this one, or returns it if their weight formats differ.
    fn append(&mut self, other: Arc<Self>) -> Result<Option<Arc<Self>>> {
        let appended = match (self, &*other) {
            (Self::Tensor(weights), Self::Tensor(others)) => {
                *weights = Tensor::cat(&[&*weights, others], 0)?;
                true
            }
            (Self::Tiles(tiles), Self::Tiles(others)) => tiles.append(others),
            _ => false,
        };
        Ok((!appended).then_some(other))
    }

    fn write_blocks(&self, out: &mut dyn Write) -> io::Result<()> {
        match self {
            Self::Tiles(tiles) => tiles.write_blocks(out),
            Self::Tensor(weights) => with_values(weights, |values| {
                Ok(values.iter().try_for_each(|value| out.write_all(&value.to_le_bytes())))
            })
            .map_err(io::Error::other)?,
        }
    }

    fn read_row(&self, index: usize, row: &mut [f32]) -> Result<()> {
        match self {
            Self::Tensor(weights) => with_values(&weights.get(index)?, |values| {
                row.copy_from_slice(values);
                Ok(())
            }),
            Self::Tiles(tiles) => tiles.read_row(index, row),
        }
    }

    /// Adds the products with row-major activations to columns of a result.
    fn multiply(&self, x: &[f32], columns: &Columns<'_>) -> Result<()> {
        match self {
            Self::Tiles(tiles) => product::multiply(tiles, x, columns, Instructions::best()),
            Self::Tensor(weights) => {
                let inputs = weights.dim(1)?;
                let product = Tensor::from_slice(x, (x.len() / inputs, inputs), &Device::Cpu)?.matmul(&weights.t()?)?;
                with_values(&product, |product| {
                    columns.add_all(product);
                    Ok(())
                })?;
            }
        }
        Ok(())
    }
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
