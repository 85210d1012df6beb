//! From an image to image tokens: preprocessing, vision tower, projector.

mod processor;
mod resample;
mod tower;

use candle_core::{D, Tensor};

pub(crate) use processor::ClipImageProcessor;
pub(crate) use tower::ClipVisionTower;

use super::MllmError;
use super::checkpoint::{Activation, FeatureSelect, LlavaConfig, Weights};
use super::linear::Linear;

/// Vision tower and projector: pixels in, rows for the decoder's input out.
#[derive(Debug)]
pub(crate) struct ImageEncoder {
    tower: ClipVisionTower,
    feature_layers: Vec<usize>,
    feature_select: FeatureSelect,
    linear1: Linear,
    act: Activation,
    linear2: Linear,
}

impl ImageEncoder {
    /// Takes the weights of tower and projector.
    ///
    /// # Errors
    /// When a tensor is missing or misshapen.
    pub(crate) fn take(weights: &mut Weights, config: &LlavaConfig) -> Result<Self, MllmError> {
        let depth = config.feature_layers.iter().copied().max().unwrap_or(0);
        let hidden = config.text.hidden;
        let features = config.vision.hidden * config.feature_layers.len();
        let bias = config.projector_bias;
        Ok(Self {
            tower: ClipVisionTower::take(weights, &config.vision, depth)?,
            feature_layers: config.feature_layers.clone(),
            feature_select: config.feature_select,
            linear1: Linear::take(weights, "multi_modal_projector.linear_1", features, hidden, bias)?,
            act: config.projector_act,
            linear2: Linear::take(weights, "multi_modal_projector.linear_2", hidden, hidden, bias)?,
        })
    }

    /// Encodes pixel values (3, side, side) to (image tokens, decoder width).
    pub(crate) fn encode(&self, pixels: &Tensor) -> candle_core::Result<Tensor> {
        let states = self.tower.hidden_states(pixels)?;
        let selected = self
            .feature_layers
            .iter()
            .map(|index| {
                let state =
                    states.get(*index).ok_or_else(|| candle_core::Error::Msg(format!("no hidden state {index}")))?;
                match self.feature_select {
                    FeatureSelect::Default => state.narrow(0, 1, state.dim(0)? - 1),
                    FeatureSelect::Full => Ok(state.clone()),
                }
            })
            .collect::<candle_core::Result<Vec<_>>>()?;
        let features = Tensor::cat(&selected, D::Minus1)?.contiguous()?;
        self.linear2.forward(&self.act.forward(&self.linear1.forward(&features)?)?)
    }
}
