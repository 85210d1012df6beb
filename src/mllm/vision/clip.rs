//! The CLIP vision transformer.

use candle_core::Tensor;

use super::attention::{Part, embed};
use super::layer::VisionLayer;
use super::patches::{take_patch_embedding, unfold};
use crate::mllm::MllmError;
use crate::mllm::checkpoint::{VisionConfig, Weights};
use crate::mllm::layer_norm::LayerNorm;
use crate::mllm::linear::Linear;

/// The first layers of a CLIP vision tower.
#[derive(Debug)]
pub(crate) struct ClipVisionTower {
    class_embedding: Tensor,
    patch_embedding: Linear,
    position_embedding: Tensor,
    pre_norm: LayerNorm,
    layers: Vec<VisionLayer>,
    config: VisionConfig,
}

impl ClipVisionTower {
    /// Takes the weights of the first `depth` layers. The other layers must be in the checkpoint too.
    pub(crate) fn take(weights: &mut Weights, config: &VisionConfig, depth: usize) -> Result<Self, MllmError> {
        let hidden = config.hidden;
        let patch = config.patch_size;
        let embeddings = "vision_tower.embeddings";
        let patch_embedding =
            take_patch_embedding(weights, &format!("{embeddings}.patch_embedding"), hidden, patch, false)?;
        let mut layers = Vec::with_capacity(config.layers.min(depth));
        for index in 0..config.layers {
            let layer = VisionLayer::take(weights, config, &format!("vision_tower.encoder.layers.{index}"))?;
            if index < depth {
                layers.push(layer);
            }
        }
        Ok(Self {
            class_embedding: weights.take(&format!("{embeddings}.class_embedding"), &[hidden])?.unsqueeze(0)?,
            patch_embedding,
            position_embedding: weights
                .take(&format!("{embeddings}.position_embedding.weight"), &[config.patches() + 1, hidden])?,
            // The misspelling is CLIP's own and is in every checkpoint.
            pre_norm: LayerNorm::take(weights, "vision_tower.pre_layrnorm", hidden, config.layer_norm_eps)?,
            layers,
            config: config.clone(),
        })
    }

    /// The `wanted` hidden states of images with pixels (3, side, side): 0 are the embeddings, n is the state after layer n.
    /// Each has shape (images, 1 + patches, hidden).
    pub(crate) fn hidden_states(&self, images: &[Tensor], wanted: &[usize]) -> candle_core::Result<Vec<Tensor>> {
        let patches = images.iter().map(|pixels| unfold(pixels, self.config.patch_size));
        let patches = Tensor::cat(&patches.collect::<candle_core::Result<Vec<_>>>()?, 0)?;
        let patches = self.patch_embedding.forward(&patches)?;
        let embedded = embed(&self.class_embedding, &patches, &self.position_embedding)?;
        let mut state = self.pre_norm.forward(&embedded)?;
        let parts = Part::images(images.len(), self.config.patches() + 1);
        let mut found = vec![None; wanted.len()];
        for index in 0..=self.layers.len() {
            for (found, _) in found.iter_mut().zip(wanted).filter(|(_, wanted)| **wanted == index) {
                *found = Some(state.reshape((images.len(), (), self.config.hidden))?);
            }
            if let Some(layer) = self.layers.get(index) {
                state = layer.forward(&state, &parts)?;
            }
        }
        found
            .into_iter()
            .collect::<Option<_>>()
            .ok_or_else(|| candle_core::Error::Msg(format!("the vision tower has no hidden states {wanted:?}")))
    }
}
