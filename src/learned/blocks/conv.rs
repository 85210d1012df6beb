//! Convolution along time.

use super::Weights;
use candle_core::{Result, Tensor};

/// A convolution with kernel 3 and padding 1 over (batch, channels, length).
#[derive(Debug, Clone)]
pub(crate) struct Conv1d {
    weight: Tensor,
    bias: Option<Tensor>,
    stride: usize,
}

/// Width of the kernel.
const KERNEL: usize = 3;

impl Conv1d {
    /// Takes `NAME.weight` and `NAME.bias`.
    pub(crate) fn take(
        weights: &mut Weights,
        name: &str,
        inputs: usize,
        outputs: usize,
    ) -> Result<Self> {
        let weight = weights.take(&format!("{name}.weight"), &[outputs, inputs, KERNEL])?;
        let bias = weights.take(&format!("{name}.bias"), &[outputs])?;
        Ok(Self {
            weight,
            bias: Some(bias.reshape((1, outputs, 1))?),
            stride: 1,
        })
    }

    /// Takes `NAME.weight` of a layer that halves the length.
    pub(crate) fn halving(
        weights: &mut Weights,
        name: &str,
        inputs: usize,
        outputs: usize,
    ) -> Result<Self> {
        let weight = weights.take(&format!("{name}.weight"), &[outputs, inputs, KERNEL])?;
        Ok(Self {
            weight,
            bias: None,
            stride: 2,
        })
    }

    /// Applies the layer.
    pub(crate) fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let y = x.contiguous()?.conv1d(&self.weight, 1, self.stride, 1, 1)?;
        match &self.bias {
            Some(bias) => y.broadcast_add(bias),
            None => Ok(y),
        }
    }
}
