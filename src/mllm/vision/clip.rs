//! The CLIP vision transformer.

use super::attention::embed;
use super::layer::{VisionLayer, hidden_states, take_layers};
use super::patches::{take_patch_embedding, unfold};
use crate::MllmError;
use crate::checkpoint::{VisionConfig, Weights};
use candle_core::Tensor;
use planagent_kernels::LayerNorm;
use planagent_kernels::Linear;

/// The first layers of a CLIP vision tower.
#[derive(Debug)]
pub(crate) struct ClipVisionTower {
    class_embedding: Tensor,
    patch_embedding: Linear,
    position_embedding: Tensor,
    pre_norm: LayerNorm,
    layers: Vec<VisionLayer>,
    patch_size: usize,
}

impl ClipVisionTower {
    /// Takes the weights of the first `depth` layers. The other layers must be in the checkpoint
    /// too.
    pub(crate) fn take(
        weights: &mut Weights,
        config: &VisionConfig,
        depth: usize,
    ) -> Result<Self, MllmError> {
        let hidden = config.hidden;
        let patch = config.patch_size;
        let embeddings = "vision_tower.embeddings";
        let patch_embedding = take_patch_embedding(
            weights,
            &format!("{embeddings}.patch_embedding"),
            hidden,
            patch,
            false,
        )?;
        let layers = take_layers(weights, config, depth)?;
        Ok(Self {
            class_embedding: weights
                .take(&format!("{embeddings}.class_embedding"), &[hidden])?
                .unsqueeze(0)?,
            patch_embedding,
            position_embedding: weights.take(
                &format!("{embeddings}.position_embedding.weight"),
                &[config.patches() + 1, hidden],
            )?,
            // The misspelling is CLIP's own and is in every checkpoint.
            pre_norm: weights.take_layer_norm(
                "vision_tower.pre_layrnorm",
                hidden,
                config.layer_norm_eps,
            )?,
            layers,
            patch_size: patch,
        })
    }

    /// The `wanted` hidden states of images with pixels (3, side, side): 0 are the embeddings, n is
    /// the state after layer n. Each has shape (images, 1 + patches, hidden).
    pub(crate) fn hidden_states(
        &self,
        images: &[Tensor],
        wanted: &[usize],
    ) -> candle_core::Result<Vec<Tensor>> {
        let patches = images.iter().map(|pixels| unfold(pixels, self.patch_size));
        let patches = Tensor::cat(&patches.collect::<candle_core::Result<Vec<_>>>()?, 0)?;
        let patches = self.patch_embedding.forward(&patches)?;
        let embedded = embed(&self.class_embedding, &patches, &self.position_embedding)?;
        hidden_states(
            &self.layers,
            self.pre_norm.forward(&embedded)?,
            images.len(),
            wanted,
        )
    }
}
