//! The merger: blocks of patches to rows of the decoder's width.

use crate::MllmError;
use crate::checkpoint::Weights;
use candle_core::{Result, Tensor};
use planagent_kernels::Activation;
use planagent_kernels::Linear;

/// Two layers with GELU between, over the patches of a block side by side.
#[derive(Debug)]
pub(crate) struct PatchMerger {
    linear1: Linear,
    linear2: Linear,
}

impl PatchMerger {
    /// Takes the layers of the merger called `name`, from blocks of `merged` numbers to rows of
    /// `hidden`.
    pub(crate) fn take(
        weights: &mut Weights,
        name: &str,
        merged: usize,
        hidden: usize,
    ) -> std::result::Result<Self, MllmError> {
        Ok(Self {
            linear1: weights.take_linear(&format!("{name}.linear_fc1"), merged, merged, true)?,
            linear2: weights.take_linear(&format!("{name}.linear_fc2"), merged, hidden, true)?,
        })
    }

    /// Maps (tokens, merged) to (tokens, hidden).
    pub(crate) fn forward(&self, merged: &Tensor) -> Result<Tensor> {
        self.linear2
            .forward(&self.linear1.forward_then(merged, Activation::Gelu)?)
    }
}
