//! Affine layers; each row is a token.

use super::matrix::Matrix;
use candle_core::{Result, Tensor};

/// y = x Wᵀ + b with x of shape (tokens, inputs).
#[derive(Debug, Clone)]
pub struct Linear {
    weight: Matrix,
    bias: Option<Tensor>,
}

impl Linear {
    /// Of a matrix of shape (outputs, inputs), and a bias of as many numbers as outputs.
    pub fn from_matrix(weight: Matrix, bias: Option<Tensor>) -> Self {
        Self { weight, bias }
    }

    /// Applies the layer to (tokens, inputs).
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        self.weight.forward_onto(x, self.bias.as_ref(), None)
    }

    /// residual + layer(x), with a residual of shape (tokens, outputs).
    pub fn forward_onto(&self, x: &Tensor, residual: &Tensor) -> Result<Tensor> {
        self.weight
            .forward_onto(x, self.bias.as_ref(), Some(residual))
    }
}
