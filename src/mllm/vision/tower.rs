//! The CLIP vision transformer.

use candle_core::{D, Tensor};
use candle_nn::{LayerNorm, Module};

use crate::mllm::MllmError;
use crate::mllm::checkpoint::{Activation, ClipVisionConfig, Weights};
use crate::mllm::linear::Linear;

/// A CLIP vision tower, as deep as its user needs it.
#[derive(Debug)]
pub(crate) struct ClipVisionTower {
    class_embedding: Tensor,
    patch_embedding: Linear,
    position_embedding: Tensor,
    pre_norm: LayerNorm,
    layers: Vec<Layer>,
    config: ClipVisionConfig,
}

#[derive(Debug)]
struct Layer {
    norm1: LayerNorm,
    qkv: Linear,
    out: Linear,
    norm2: LayerNorm,
    fc1: Linear,
    fc2: Linear,
    heads: usize,
    act: Activation,
}

impl ClipVisionTower {
    /// Takes the weights of the first `depth` layers, after checking that the others are there too.
    ///
    /// # Errors
    /// When a tensor is missing or misshapen.
    pub(crate) fn take(weights: &mut Weights, config: &ClipVisionConfig, depth: usize) -> Result<Self, MllmError> {
        let hidden = config.hidden;
        let patch = config.patch_size;
        let embeddings = "vision_tower.embeddings";
        let patch_kernel = weights.take(&format!("{embeddings}.patch_embedding.weight"), &[hidden, 3, patch, patch])?;
        let mut layers = Vec::with_capacity(config.layers);
        for index in 0..config.layers {
            layers.push(Layer::take(weights, config, &format!("vision_tower.encoder.layers.{index}"))?);
        }
        layers.truncate(depth);
        Ok(Self {
            class_embedding: weights.take(&format!("{embeddings}.class_embedding"), &[hidden])?.unsqueeze(0)?,
            patch_embedding: Linear::from_matrix(&patch_kernel.flatten_from(1)?)?,
            position_embedding: weights
                .take(&format!("{embeddings}.position_embedding.weight"), &[config.patches() + 1, hidden])?,
            // The misspelling is CLIP's own and stands in every checkpoint.
            pre_norm: layer_norm(weights, "vision_tower.pre_layrnorm", config)?,
            layers,
            config: config.clone(),
        })
    }

    /// The hidden states of shape (1 + patches, hidden): of the embeddings, then after each layer.
    ///
    /// `pixels` has shape (3, side, side).
    pub(crate) fn hidden_states(&self, pixels: &Tensor) -> candle_core::Result<Vec<Tensor>> {
        let patches = self.patch_embedding.forward(&self.unfold(pixels)?)?;
        let embedded = (Tensor::cat(&[&self.class_embedding, &patches], 0)? + &self.position_embedding)?;
        let mut states = vec![self.pre_norm.forward(&embedded)?];
        for layer in &self.layers {
            if let Some(last) = states.last() {
                states.push(layer.forward(last)?);
            }
        }
        Ok(states)
    }

    /// Cuts (3, side, side) into rows of one patch each: (patches, 3 · patch²), as the convolution's kernel is laid out.
    fn unfold(&self, pixels: &Tensor) -> candle_core::Result<Tensor> {
        let patch = self.config.patch_size;
        let grid = self.config.image_size / patch;
        let used = grid * patch;
        pixels
            .narrow(1, 0, used)?
            .narrow(2, 0, used)?
            .reshape(vec![3, grid, patch, grid, patch])?
            .permute(vec![1, 3, 0, 2, 4])?
            .reshape((grid * grid, 3 * patch * patch))
    }
}

impl Layer {
    fn take(weights: &mut Weights, config: &ClipVisionConfig, name: &str) -> Result<Self, MllmError> {
        let hidden = config.hidden;
        let qkv: Vec<(String, usize)> = ["q_proj", "k_proj", "v_proj"]
            .into_iter()
            .map(|part| (format!("{name}.self_attn.{part}"), hidden))
            .collect();
        Ok(Self {
            norm1: layer_norm(weights, &format!("{name}.layer_norm1"), config)?,
            qkv: Linear::take_fused(weights, &qkv, hidden, true)?,
            out: Linear::take(weights, &format!("{name}.self_attn.out_proj"), hidden, hidden, true)?,
            norm2: layer_norm(weights, &format!("{name}.layer_norm2"), config)?,
            fc1: Linear::take(weights, &format!("{name}.mlp.fc1"), hidden, config.intermediate, true)?,
            fc2: Linear::take(weights, &format!("{name}.mlp.fc2"), config.intermediate, hidden, true)?,
            heads: config.heads,
            act: config.act,
        })
    }

    fn forward(&self, x: &Tensor) -> candle_core::Result<Tensor> {
        let x = (x + self.attend(&self.norm1.forward(x)?)?)?;
        let wide = self.act.forward(&self.fc1.forward(&self.norm2.forward(&x)?)?)?;
        &x + self.fc2.forward(&wide)?
    }

    fn attend(&self, x: &Tensor) -> candle_core::Result<Tensor> {
        let (tokens, hidden) = x.dims2()?;
        let head_dim = hidden / self.heads;
        // (tokens, 3, heads, head_dim) to (3, heads, tokens, head_dim)
        let qkv =
            self.qkv.forward(x)?.reshape((tokens, 3, self.heads, head_dim))?.permute((1, 2, 0, 3))?.contiguous()?;
        let scale = 1.0 / (head_dim as f64).sqrt();
        let scores = (qkv.get(0)? * scale)?.matmul(&qkv.get(1)?.t()?)?;
        let mixed = candle_nn::ops::softmax(&scores, D::Minus1)?.matmul(&qkv.get(2)?)?;
        self.out.forward(&mixed.transpose(0, 1)?.reshape((tokens, hidden))?)
    }
}

fn layer_norm(weights: &mut Weights, name: &str, config: &ClipVisionConfig) -> Result<LayerNorm, MllmError> {
    Ok(LayerNorm::new(
        weights.take(&format!("{name}.weight"), &[config.hidden])?,
        weights.take(&format!("{name}.bias"), &[config.hidden])?,
        config.layer_norm_eps,
    ))
}
