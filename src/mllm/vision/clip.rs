//! The CLIP vision transformer.

use candle_core::Tensor;

use super::attention::{SelfAttention, embed, unfold};
use crate::mllm::MllmError;
use crate::mllm::checkpoint::{Activation, VisionConfig, Weights};
use crate::mllm::layer_norm::LayerNorm;
use crate::mllm::linear::Linear;
use crate::mllm::matrix::Matrix;

/// The first layers of a CLIP vision tower.
#[derive(Debug)]
pub(crate) struct ClipVisionTower {
    class_embedding: Tensor,
    patch_embedding: Linear,
    position_embedding: Tensor,
    pre_norm: LayerNorm,
    layers: Vec<Layer>,
    config: VisionConfig,
}

#[derive(Debug)]
struct Layer {
    norm1: LayerNorm,
    attention: SelfAttention,
    norm2: LayerNorm,
    fc1: Linear,
    fc2: Linear,
    act: Activation,
}

impl ClipVisionTower {
    /// Takes the weights of the first `depth` layers. The other layers must be in the checkpoint too.
    pub(crate) fn take(weights: &mut Weights, config: &VisionConfig, depth: usize) -> Result<Self, MllmError> {
        let hidden = config.hidden;
        let patch = config.patch_size;
        let embeddings = "vision_tower.embeddings";
        let patch_kernel = weights.take(&format!("{embeddings}.patch_embedding.weight"), &[hidden, 3, patch, patch])?;
        let mut layers = Vec::with_capacity(config.layers.min(depth));
        for index in 0..config.layers {
            let layer = Layer::take(weights, config, &format!("vision_tower.encoder.layers.{index}"))?;
            if index < depth {
                layers.push(layer);
            }
        }
        Ok(Self {
            class_embedding: weights.take(&format!("{embeddings}.class_embedding"), &[hidden])?.unsqueeze(0)?,
            patch_embedding: Linear::from_matrix(Matrix::from_tensor(&patch_kernel.flatten_from(1)?)?, None),
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
        let mut found = vec![None; wanted.len()];
        for index in 0..=self.layers.len() {
            for (found, _) in found.iter_mut().zip(wanted).filter(|(_, wanted)| **wanted == index) {
                *found = Some(state.reshape((images.len(), (), self.config.hidden))?);
            }
            if let Some(layer) = self.layers.get(index) {
                state = layer.forward(&state, images.len())?;
            }
        }
        found
            .into_iter()
            .collect::<Option<_>>()
            .ok_or_else(|| candle_core::Error::Msg(format!("the vision tower has no hidden states {wanted:?}")))
    }
}

impl Layer {
    fn take(weights: &mut Weights, config: &VisionConfig, name: &str) -> Result<Self, MllmError> {
        let (hidden, wide, eps) = (config.hidden, config.intermediate, config.layer_norm_eps);
        let qkv = ["q_proj", "k_proj", "v_proj"].map(|part| (format!("{name}.self_attn.{part}"), hidden));
        Ok(Self {
            norm1: LayerNorm::take(weights, &format!("{name}.layer_norm1"), hidden, eps)?,
            attention: SelfAttention {
                qkv: Linear::take_fused(weights, &qkv, hidden, true)?,
                out: Linear::take(weights, &format!("{name}.self_attn.out_proj"), hidden, hidden, true)?,
                heads: config.heads,
            },
            norm2: LayerNorm::take(weights, &format!("{name}.layer_norm2"), hidden, eps)?,
            fc1: Linear::take(weights, &format!("{name}.mlp.fc1"), hidden, wide, true)?,
            fc2: Linear::take(weights, &format!("{name}.mlp.fc2"), wide, hidden, true)?,
            act: config.act,
        })
    }

    fn forward(&self, x: &Tensor, images: usize) -> candle_core::Result<Tensor> {
        let x = self.attention.forward_onto(&self.norm1.forward(x)?, images, x)?;
        let wide = self.act.forward(&self.fc1.forward(&self.norm2.forward(&x)?)?)?;
        self.fc2.forward_onto(&wide, &x)
    }
}
