//! The `SigLIP` vision transformer (Zhai et al., arXiv:2303.15343), whose layers are CLIP's. It has no class token.

use candle_core::Tensor;

use super::attention::Part;
use super::layer::VisionLayer;
use super::patches::{take_patch_embedding, unfold};
use crate::mllm::MllmError;
use crate::mllm::checkpoint::{VisionConfig, Weights};
use crate::mllm::layer_norm::LayerNorm;
use crate::mllm::linear::Linear;

/// A `SigLIP` tower.
#[derive(Debug)]
pub(crate) struct SiglipVisionTower {
    patch_embedding: Linear,
    position_embedding: Tensor,
    layers: Vec<VisionLayer>,
    post_norm: LayerNorm,
    patch_size: usize,
}

impl SiglipVisionTower {
    pub(crate) fn take(weights: &mut Weights, config: &VisionConfig) -> Result<Self, MllmError> {
        let hidden = config.hidden;
        let embeddings = "vision_tower.embeddings";
        let patches = format!("{embeddings}.patch_embedding");
        Ok(Self {
            patch_embedding: take_patch_embedding(weights, &patches, hidden, config.patch_size, true)?,
            position_embedding: weights
                .take(&format!("{embeddings}.position_embedding.weight"), &[config.patches(), hidden])?,
            layers: (0..config.layers)
                .map(|index| VisionLayer::take(weights, config, &format!("vision_tower.encoder.layers.{index}")))
                .collect::<Result<_, _>>()?,
            post_norm: LayerNorm::take(weights, "vision_tower.post_layernorm", hidden, config.layer_norm_eps)?,
            patch_size: config.patch_size,
        })
    }

    /// Encodes pixel values (3, side, side) to (patches, hidden).
    pub(crate) fn forward(&self, pixels: &Tensor) -> candle_core::Result<Tensor> {
        let patches = self.patch_embedding.forward(&unfold(pixels, self.patch_size)?)?;
        let mut x = (patches + &self.position_embedding)?;
        let parts = Part::images(1, x.dim(0)?);
        for layer in &self.layers {
            x = layer.forward(&x, &parts)?;
        }
        self.post_norm.forward(&x)
    }
}
