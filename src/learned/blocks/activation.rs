//! Functions without parameters.

use candle_core::{Result, Tensor};
use planagent_kernels::Activation;
pub(in crate::learned) use planagent_kernels::pointwise::softmax;

/// max(x, 0).
pub(in crate::learned) fn relu(x: &Tensor) -> Result<Tensor> {
    Activation::Relu.forward(x)
}

/// x Φ(x), Φ the normal distribution.
pub(in crate::learned) fn gelu(x: &Tensor) -> Result<Tensor> {
    Activation::Gelu.forward(x)
}

/// x where it is positive, else x / 100.
pub(in crate::learned) fn leaky_relu(x: &Tensor) -> Result<Tensor> {
    x.maximum(&(x * 0.01)?)
}
