//! Layers of a checkpoint by their names.

use super::weights::Weights;
use crate::MllmError;
use candle_core::Tensor;
use planagent_kernels::matrix::Matrix;
use planagent_kernels::{LayerNorm, Linear, RmsNorm};

impl Weights {
    /// Takes `NAME.weight` of shape (outputs, inputs), and `NAME.bias` if `bias` is set.
    pub(crate) fn take_linear(
        &mut self,
        name: &str,
        inputs: usize,
        outputs: usize,
        bias: bool,
    ) -> Result<Linear, MllmError> {
        self.take_fused(&[(name.to_string(), outputs)], inputs, bias)
    }

    /// Takes layers with the same input as one layer with concatenated outputs, so that one product
    /// replaces several.
    pub(crate) fn take_fused(
        &mut self,
        parts: &[(String, usize)],
        inputs: usize,
        bias: bool,
    ) -> Result<Linear, MllmError> {
        let mut matrices = Vec::with_capacity(parts.len());
        let mut biases = Vec::with_capacity(parts.len());
        for (name, outputs) in parts {
            matrices.push(self.take_matrix(&format!("{name}.weight"), [*outputs, inputs])?);
            if bias {
                biases.push(self.take(&format!("{name}.bias"), &[*outputs])?);
            }
        }
        let bias = if bias {
            Some(Tensor::cat(&biases, 0)?)
        } else {
            None
        };
        Ok(Linear::from_matrix(Matrix::stack(matrices)?, bias))
    }

    /// Takes `NAME.weight` and `NAME.bias`.
    pub(crate) fn take_layer_norm(
        &mut self,
        name: &str,
        width: usize,
        eps: f64,
    ) -> Result<LayerNorm, MllmError> {
        let mut vector = |part: &str| -> Result<Vec<f32>, MllmError> {
            Ok(self.take(&format!("{name}.{part}"), &[width])?.to_vec1()?)
        };
        Ok(LayerNorm::new(vector("weight")?, vector("bias")?, eps))
    }

    /// Takes `NAME.weight`.
    pub(crate) fn take_rms_norm(
        &mut self,
        name: &str,
        width: usize,
        eps: f64,
    ) -> Result<RmsNorm, MllmError> {
        Ok(RmsNorm::new(
            self.take(&format!("{name}.weight"), &[width])?.to_vec1()?,
            eps,
        ))
    }
}
