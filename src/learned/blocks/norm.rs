//! Batch normalization.

use super::Weights;
use candle_core::{Result, Tensor};

/// PyTorch's default ε, of layer normalization too.
pub(super) const EPSILON: f64 = 1e-5;

/// Batch normalization with its running statistics, as one factor and one summand a channel.
#[derive(Debug, Clone)]
pub(crate) struct BatchNorm {
    factor: Tensor,
    summand: Tensor,
}

impl BatchNorm {
    /// Takes the four vectors of `NAME` and its counter of batches.
    pub(crate) fn take(weights: &mut Weights, name: &str, width: usize) -> Result<Self> {
        let mut vector = |part: &str| weights.take(&format!("{name}.{part}"), &[width]);
        let (weight, bias) = (vector("weight")?, vector("bias")?);
        let (mean, variance) = (vector("running_mean")?, vector("running_var")?);
        weights.skip(&format!("{name}.num_batches_tracked"), &[])?;
        let factor = (weight / (variance + EPSILON)?.sqrt()?)?;
        let summand = (bias - (mean * &factor)?)?;
        Ok(Self { factor, summand })
    }

    /// A layer's weight (channels, …) and bias with the norm behind the layer folded in.
    pub(crate) fn folded(self, weight: &Tensor, bias: Option<&Tensor>) -> Result<(Tensor, Tensor)> {
        let (channels, rank) = (weight.dim(0)?, weight.rank());
        let factor = self
            .factor
            .reshape([&[channels], vec![1; rank - 1].as_slice()].concat())?;
        let bias = match bias {
            Some(bias) => ((bias * &self.factor)? + self.summand)?,
            None => self.summand,
        };
        Ok((weight.broadcast_mul(&factor)?, bias))
    }
}
