//! The adapter from the vision tower to the decoder: a gated linear unit, and learned rows around
//! the image.

use super::config::CogVlmConfig;
use crate::MllmError;
use crate::checkpoint::Weights;
use crate::decoder::{SwiGlu, SwiGluShape};
use candle_core::{Result, Tensor};
use planagent_kernels::Activation;
use planagent_kernels::LayerNorm;
use planagent_kernels::Linear;

/// Epsilon of the adapter's layer norm, torch's default.
const NORM_EPS: f64 = 1e-5;

/// The adapter of `CogVLM` (`linear_proj`, `boi`, `eoi`).
#[derive(Debug)]
pub(super) struct GluAdapter {
    projection: Linear,
    norm: LayerNorm,
    glu: SwiGlu,
    begin: Tensor,
    end: Tensor,
}

impl GluAdapter {
    pub(super) fn take(
        weights: &mut Weights,
        config: &CogVlmConfig,
    ) -> std::result::Result<Self, MllmError> {
        const NAME: &str = "vision.linear_proj";
        let hidden = config.text.hidden;
        let shape = SwiGluShape {
            names: ["gate_proj", "dense_h_to_4h", "dense_4h_to_h"],
            hidden,
            intermediate: config.text.intermediate,
            bias: false,
        };
        Ok(Self {
            projection: weights.take_linear(
                &format!("{NAME}.linear_proj"),
                config.vision.hidden,
                hidden,
                false,
            )?,
            norm: weights.take_layer_norm(&format!("{NAME}.norm1"), hidden, NORM_EPS)?,
            glu: SwiGlu::take(weights, NAME, shape)?,
            begin: weights.take("vision.boi", &[1, 1, hidden])?.squeeze(0)?,
            end: weights.take("vision.eoi", &[1, 1, hidden])?.squeeze(0)?,
        })
    }

    /// Maps (patches, tower width) to (2 + patches, decoder width).
    pub(super) fn forward(&self, patches: &Tensor) -> Result<Tensor> {
        let x =
            Activation::Gelu.forward(&self.norm.forward(&self.projection.forward(patches)?)?)?;
        Tensor::cat(&[&self.begin, &self.glu.forward(&x)?, &self.end], 0)
    }
}
