//! The projector, from the vision tower's hidden states to input rows of the decoder.

use super::config::LlavaConfig;
use crate::MllmError;
use crate::checkpoint::Weights;
use candle_core::{Result, Tensor};
use planagent_kernels::Activation;
use planagent_kernels::Linear;

/// The projector of LLaVA: two linear layers with an activation between (`multi_modal_projector`).
#[derive(Debug)]
pub(crate) struct Projector {
    linear1: Linear,
    act: Activation,
    linear2: Linear,
}

impl Projector {
    pub(crate) fn take(
        weights: &mut Weights,
        config: &LlavaConfig,
    ) -> std::result::Result<Self, MllmError> {
        let hidden = config.text.hidden;
        let features = config.vision.hidden * config.feature_layers.len();
        let bias = config.projector_bias;
        Ok(Self {
            linear1: weights.take_linear(
                "multi_modal_projector.linear_1",
                features,
                hidden,
                bias,
            )?,
            act: config.projector_act,
            linear2: weights.take_linear("multi_modal_projector.linear_2", hidden, hidden, bias)?,
        })
    }

    /// Maps (rows, tower width) to (rows, decoder width).
    pub(crate) fn forward(&self, features: &Tensor) -> Result<Tensor> {
        self.linear2
            .forward(&self.linear1.forward_then(features, self.act)?)
    }
}
