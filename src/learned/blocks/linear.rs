//! Affine layers.

use super::{Weights, relu};
use candle_core::{Result, Tensor};
use planagent_kernels::matrix::Matrix;

/// y = x Wᵀ + b over the last dimension.
#[derive(Debug, Clone)]
pub(crate) struct Linear {
    weight: Matrix,
    bias: Option<Tensor>,
}

impl Linear {
    /// Takes `NAME.weight` and `NAME.bias`.
    pub(crate) fn take(
        weights: &mut Weights,
        name: &str,
        inputs: usize,
        outputs: usize,
    ) -> Result<Self> {
        let layer = Self::without_bias(weights, name, inputs, outputs)?;
        Ok(Self {
            bias: Some(weights.take(&format!("{name}.bias"), &[outputs])?),
            ..layer
        })
    }

    /// Takes `NAME.weight`.
    pub(crate) fn without_bias(
        weights: &mut Weights,
        name: &str,
        inputs: usize,
        outputs: usize,
    ) -> Result<Self> {
        Self::from_tensors(
            &weights.take(&format!("{name}.weight"), &[outputs, inputs])?,
            None,
        )
    }

    /// Of a weight (outputs, inputs) and a bias.
    pub(crate) fn from_tensors(weight: &Tensor, bias: Option<Tensor>) -> Result<Self> {
        Ok(Self {
            weight: Matrix::from_tensor(weight)?,
            bias,
        })
    }

    /// Applies the layer to (…, inputs).
    pub(crate) fn forward(&self, x: &Tensor) -> Result<Tensor> {
        self.sum(x, None)
    }

    /// residual (…, outputs) + layer(x).
    pub(crate) fn forward_onto(&self, x: &Tensor, residual: &Tensor) -> Result<Tensor> {
        self.sum(x, Some(residual))
    }

    fn sum(&self, x: &Tensor, residual: Option<&Tensor>) -> Result<Tensor> {
        let mut shape = x.dims().to_vec();
        if let Some(last) = shape.last_mut() {
            *last = self.weight.outputs();
        }
        let rows = x.elem_count() / self.weight.inputs();
        let x = x.reshape((rows, self.weight.inputs()))?;
        let residual = residual
            .map(|residual| residual.reshape((rows, self.weight.outputs())))
            .transpose()?;
        self.weight
            .forward_onto(&x, self.bias.as_ref(), residual.as_ref())?
            .reshape(shape)
    }
}

/// An affine layer of rows [own, common], where the rows of a group have the second part in common:
/// its product is computed once a group.
#[derive(Debug, Clone)]
pub(crate) struct GroupLinear {
    own: Linear,
    common: Linear,
}

impl GroupLinear {
    /// Of a weight (outputs, own + common) and a bias; both parts of a row have the same width.
    pub(crate) fn from_tensors(weight: &Tensor, bias: Tensor) -> Result<Self> {
        let width = weight.dim(1)? / 2;
        Ok(Self {
            own: Linear::from_tensors(&weight.narrow(1, 0, width)?, None)?,
            common: Linear::from_tensors(&weight.narrow(1, width, width)?, Some(bias))?,
        })
    }

    /// Maps rows (groups, rows, own) and what their groups have in common (groups, common) to
    /// (groups, rows, outputs).
    pub(crate) fn forward(&self, x: &Tensor, common: &Tensor) -> Result<Tensor> {
        let (groups, rows, _) = x.dims3()?;
        let common = self.common.forward(common)?.unsqueeze(1)?;
        self.own.forward_onto(
            x,
            &common.broadcast_as((groups, rows, self.own.weight.outputs()))?,
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
        let layers = layers.map(|(name, width)| Linear::take(weights, name, width[0], width[1]));
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
