//! The image encoder: CLIP or `SigLIP` tower, selected hidden states, projector.

use super::config::{FeatureSelect, LlavaConfig};
use super::connector::Projector;
use crate::MllmError;
use crate::checkpoint::{TowerType, Weights};
use crate::vision::{ClipVisionTower, SiglipVisionTower};
use candle_core::{D, Tensor};

/// Vision tower and projector, from pixel values to input rows of the decoder.
#[derive(Debug)]
pub(crate) struct ImageEncoder {
    tower: Tower,
    feature_layers: Vec<usize>,
    feature_select: FeatureSelect,
    projector: Projector,
}

#[derive(Debug)]
enum Tower {
    Clip(ClipVisionTower),
    Siglip(SiglipVisionTower),
}

impl ImageEncoder {
    pub(crate) fn take(weights: &mut Weights, config: &LlavaConfig) -> Result<Self, MllmError> {
        let depth = config
            .feature_layers
            .iter()
            .copied()
            .max()
            .expect("the configuration names one layer at least");
        Ok(Self {
            tower: match config.tower {
                TowerType::Clip => {
                    Tower::Clip(ClipVisionTower::take(weights, &config.vision, depth)?)
                }
                TowerType::Siglip => {
                    Tower::Siglip(SiglipVisionTower::take(weights, &config.vision, depth)?)
                }
            },
            feature_layers: config.feature_layers.clone(),
            feature_select: config.feature_select,
            projector: Projector::take(weights, config)?,
        })
    }

    /// Encodes images, pixel values (3, side, side) each, to (images · image tokens, decoder
    /// width).
    pub(crate) fn encode(&self, images: &[Tensor]) -> candle_core::Result<Tensor> {
        let states = match &self.tower {
            Tower::Clip(tower) => tower.hidden_states(images, &self.feature_layers)?,
            Tower::Siglip(tower) => tower.hidden_states(images, &self.feature_layers)?,
        };
        let states = Tensor::cat(&states, D::Minus1)?;
        let selected = match self.feature_select {
            FeatureSelect::Default => states.narrow(1, 1, states.dim(1)? - 1)?,
            FeatureSelect::Full => states,
        };
        self.projector
            .forward(&selected.flatten_to(1)?.contiguous()?)
    }
}
