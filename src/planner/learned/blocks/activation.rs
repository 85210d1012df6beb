//! Functions without parameters.

use candle_core::{D, DType, Result, Tensor};

/// max(x, 0).
pub(in crate::planner::learned) fn relu(x: &Tensor) -> Result<Tensor> {
    x.relu()
}

/// x where it is positive, else x / 100.
pub(in crate::planner::learned) fn leaky_relu(x: &Tensor) -> Result<Tensor> {
    x.maximum(&(x * 0.01)?)
}

/// Softmax over the last dimension.
pub(in crate::planner::learned) fn softmax(x: &Tensor) -> Result<Tensor> {
    let raised = x.broadcast_sub(&x.max_keepdim(D::Minus1)?)?.exp()?;
    raised.broadcast_div(&raised.sum_keepdim(D::Minus1)?)
}

/// `x` with zeros where `mask` (1 or 0, without the last dimension) is 0.
pub(in crate::planner::learned) fn masked(x: &Tensor, mask: &Tensor) -> Result<Tensor> {
    x.broadcast_mul(&mask.to_dtype(DType::F32)?.unsqueeze(D::Minus1)?)
}
