//! Compositions of affine layers.

use super::{Linear, Weights, relu};
use candle_core::{Result, Tensor};

/// An affine layer of rows [row, common], where the rows of a group have the second part in common:
/// its product is computed once a group.
#[derive(Debug, Clone)]
pub(crate) struct GroupLinear {
    of_row: Linear,
    common: Linear,
}

impl GroupLinear {
    /// Of a weight (outputs, row + common) and a bias; both parts of a row have the same width.
    pub(crate) fn from_tensors(weight: &Tensor, bias: Tensor) -> Result<Self> {
        let width = weight.dim(1)? / 2;
        Ok(Self {
            of_row: Linear::from_tensors(&weight.narrow(1, 0, width)?, None)?,
            common: Linear::from_tensors(&weight.narrow(1, width, width)?, Some(bias))?,
        })
    }

    /// Maps rows (groups, rows, row) and what their groups have in common (groups, common) to
    /// (groups, rows, outputs).
    pub(crate) fn forward(&self, x: &Tensor, common: &Tensor) -> Result<Tensor> {
        let (groups, rows, _) = x.dims3()?;
        let common = self.common.forward(common)?.unsqueeze(1)?;
        self.of_row.forward_onto(
            x,
            &common.broadcast_as((groups, rows, self.of_row.outputs()))?,
        )
    }
}

/// Affine layers with ReLU between them, and none after the last.
#[derive(Debug, Clone)]
pub(crate) struct Mlp {
    layers: Vec<Linear>,
}

impl Mlp {
    /// Takes layers of these names between these widths.
    pub(crate) fn take(weights: &mut Weights, names: &[String], widths: &[usize]) -> Result<Self> {
        let layers = names.iter().zip(widths.windows(2));
        let layers = layers.map(|(name, width)| weights.linear(name, width[0], width[1]));
        Ok(Self {
            layers: layers.collect::<Result<_>>()?,
        })
    }

    /// Applies the layers to (…, inputs).
    pub(crate) fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let mut x = x.clone();
        for (i, layer) in self.layers.iter().enumerate() {
            x = if i == 0 {
                layer.forward(&x)?
            } else {
                layer.forward(&relu(&x)?)?
            };
        }
        Ok(x)
    }
}
