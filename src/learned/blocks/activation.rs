//! Functions without parameters.

pub(crate) use planagent_kernels::pointwise::softmax;

use candle_core::{Result, Tensor};
use planagent_kernels::Activation;

/// max(x, 0).
pub(crate) fn relu(x: &Tensor) -> Result<Tensor> {
    Activation::Relu.forward(x)
}

/// x Φ(x), Φ the normal distribution.
pub(crate) fn gelu(x: &Tensor) -> Result<Tensor> {
    Activation::Gelu.forward(x)
}

/// x where it is positive, else x / 100.
pub(crate) fn leaky_relu(x: &Tensor) -> Result<Tensor> {
    x.maximum(&(x * 0.01)?)
}
