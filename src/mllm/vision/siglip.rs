//! The `SigLIP` vision transformer (Zhai et al., arXiv:2303.15343), whose layers are CLIP's. It has
//! no class token.

use super::attention::Part;
use super::layer::{VisionLayer, hidden_states, take_layers};
use super::patches::{take_patch_embedding, unfold};
use crate::MllmError;
use crate::checkpoint::{VisionConfig, Weights};
use candle_core::Tensor;
use planagent_kernels::LayerNorm;
use planagent_kernels::Linear;

/// A `SigLIP` tower.
#[derive(Debug)]
pub(crate) struct SiglipVisionTower {
    patch_embedding: Linear,
    position_embedding: Tensor,
    layers: Vec<VisionLayer>,
    /// Behind the last layer; none for a tower whose hidden states are the features.
    post_norm: Option<LayerNorm>,
    patch_size: usize,
}

impl SiglipVisionTower {
    /// Takes the first `depth` layers for their hidden states.
    pub(crate) fn take(
        weights: &mut Weights,
        config: &VisionConfig,
        depth: usize,
    ) -> Result<Self, MllmError> {
        let hidden = config.hidden;
        let embeddings = "vision_tower.embeddings";
        let patches = format!("{embeddings}.patch_embedding");
        Ok(Self {
            patch_embedding: take_patch_embedding(
                weights,
                &patches,
                hidden,
                config.patch_size,
                true,
            )?,
            position_embedding: weights.take(
                &format!("{embeddings}.position_embedding.weight"),
                &[config.patches(), hidden],
            )?,
            layers: take_layers(weights, config, depth)?,
            post_norm: None,
            patch_size: config.patch_size,
        })
    }

    /// Takes all layers and the norm behind them.
    pub(crate) fn take_whole(
        weights: &mut Weights,
        config: &VisionConfig,
    ) -> Result<Self, MllmError> {
        let tower = Self::take(weights, config, config.layers)?;
        let norm = weights.take_layer_norm(
            "vision_tower.post_layernorm",
            config.hidden,
            config.layer_norm_eps,
        )?;
        Ok(Self {
            post_norm: Some(norm),
            ..tower
        })
    }

    /// The `wanted` hidden states of images with pixels (3, side, side): 0 are the embeddings, n is
    /// the state after layer n. Each has shape (images, patches, hidden).
    pub(crate) fn hidden_states(
        &self,
        images: &[Tensor],
        wanted: &[usize],
    ) -> candle_core::Result<Vec<Tensor>> {
        let embedded = images
            .iter()
            .map(|pixels| self.embed(pixels))
            .collect::<candle_core::Result<Vec<_>>>()?;
        hidden_states(
            &self.layers,
            Tensor::cat(&embedded, 0)?,
            images.len(),
            wanted,
        )
    }

    fn embed(&self, pixels: &Tensor) -> candle_core::Result<Tensor> {
        self.patch_embedding
            .forward(&unfold(pixels, self.patch_size)?)?
            + &self.position_embedding
    }

    /// Encodes pixel values (3, side, side) to (patches, hidden).
    pub(crate) fn forward(&self, pixels: &Tensor) -> candle_core::Result<Tensor> {
        let mut x = self.embed(pixels)?;
        let parts = Part::images(1, x.dim(0)?);
        for layer in &self.layers {
            x = layer.forward(&x, &parts)?;
        }
        self.post_norm
            .as_ref()
            .map_or(Ok(x.clone()), |norm| norm.forward(&x))
    }
}
