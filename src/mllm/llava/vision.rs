//! The image encoder: CLIP tower, selected hidden states, projector.

use candle_core::{D, Tensor};

use super::config::{FeatureSelect, LlavaConfig};
use super::connector::Projector;
use crate::mllm::MllmError;
use crate::mllm::checkpoint::Weights;
use crate::mllm::vision::ClipVisionTower;

/// Vision tower and projector, from pixel values to input rows of the decoder.
#[derive(Debug)]
pub(crate) struct ImageEncoder {
    tower: ClipVisionTower,
    feature_layers: Vec<usize>,
    feature_select: FeatureSelect,
    projector: Projector,
}

impl ImageEncoder {
    pub(crate) fn take(weights: &mut Weights, config: &LlavaConfig) -> Result<Self, MllmError> {
        let depth = config.feature_layers.iter().copied().max().unwrap_or(0);
        Ok(Self {
            tower: ClipVisionTower::take(weights, &config.vision, depth)?,
            feature_layers: config.feature_layers.clone(),
            feature_select: config.feature_select,
            projector: Projector::take(weights, config)?,
        })
    }

    /// Encodes images, pixel values (3, side, side) each, to (images · image tokens, decoder width).
    pub(crate) fn encode(&self, images: &[Tensor]) -> candle_core::Result<Tensor> {
        let states = Tensor::cat(&self.tower.hidden_states(images, &self.feature_layers)?, D::Minus1)?;
        let selected = match self.feature_select {
            FeatureSelect::Default => states.narrow(1, 1, states.dim(1)? - 1)?,
            FeatureSelect::Full => states,
        };
        self.projector.forward(&selected.flatten_to(1)?.contiguous()?)
    }
}
