//! Affine layers; each row is a token.

use candle_core::{Result, Tensor};

use super::MllmError;
use super::checkpoint::Weights;
use super::matrix::Matrix;

/// y = x Wᵀ + b with x of shape (tokens, inputs).
#[derive(Debug, Clone)]
pub(crate) struct Linear {
    weight: Matrix,
    bias: Option<Tensor>,
}

impl Linear {
    /// Takes `NAME.weight` of shape (outputs, inputs), and `NAME.bias` if `bias` is set.
    pub(crate) fn take(
        weights: &mut Weights,
        name: &str,
        inputs: usize,
        outputs: usize,
        bias: bool,
    ) -> std::result::Result<Self, MllmError> {
        Self::take_fused(weights, &[(name.to_string(), outputs)], inputs, bias)
    }

    /// Takes layers with the same input as one layer with concatenated outputs, so that one product replaces several.
    pub(crate) fn take_fused(
        weights: &mut Weights,
        parts: &[(String, usize)],
        inputs: usize,
        bias: bool,
    ) -> std::result::Result<Self, MllmError> {
        let mut matrices = Vec::with_capacity(parts.len());
        let mut biases = Vec::with_capacity(parts.len());
        for (name, outputs) in parts {
            matrices.push(weights.take_matrix(&format!("{name}.weight"), [*outputs, inputs])?);
            if bias {
                biases.push(weights.take(&format!("{name}.bias"), &[*outputs])?);
            }
        }
        let bias = if bias { Some(Tensor::cat(&biases, 0)?) } else { None };
        Ok(Self { weight: Matrix::stack(matrices)?, bias })
    }

    pub(crate) fn from_matrix(weight: Matrix, bias: Option<Tensor>) -> Self {
        Self { weight, bias }
    }

    /// Applies the layer to (tokens, inputs).
    pub(crate) fn forward(&self, x: &Tensor) -> Result<Tensor> {
        self.weight.forward_onto(x, self.bias.as_ref(), None)
    }

    /// residual + layer(x), with a residual of shape (tokens, outputs).
    pub(crate) fn forward_onto(&self, x: &Tensor, residual: &Tensor) -> Result<Tensor> {
        self.weight.forward_onto(x, self.bias.as_ref(), Some(residual))
    }
}
