//! The EVA2-CLIP vision transformer. Each branch ends with a norm, and the last layer's output has
//! no further norm.

use crate::MllmError;
use crate::checkpoint::{VisionConfig, Weights};
use crate::vision::{Part, SelfAttention, embed, take_patch_embedding, unfold};
use candle_core::Tensor;
use planagent_kernels::Activation;
use planagent_kernels::LayerNorm;
use planagent_kernels::Linear;

#[derive(Debug)]
pub(super) struct EvaVisionTower {
    class_embedding: Tensor,
    patch_embedding: Linear,
    position_embedding: Tensor,
    layers: Vec<Layer>,
    patch_size: usize,
}

#[derive(Debug)]
struct Layer {
    attention: SelfAttention,
    attention_norm: LayerNorm,
    fc1: Linear,
    act: Activation,
    fc2: Linear,
    mlp_norm: LayerNorm,
}

impl EvaVisionTower {
    pub(super) fn take(weights: &mut Weights, config: &VisionConfig) -> Result<Self, MllmError> {
        let (hidden, patch) = (config.hidden, config.patch_size);
        let embeddings = "vision.patch_embedding";
        let patch_embedding =
            take_patch_embedding(weights, &format!("{embeddings}.proj"), hidden, patch, true)?;
        Ok(Self {
            class_embedding: weights.take(&format!("{embeddings}.cls_embedding"), &[1, hidden])?,
            patch_embedding,
            position_embedding: weights.take(
                &format!("{embeddings}.position_embedding.weight"),
                &[config.patches() + 1, hidden],
            )?,
            layers: (0..config.layers)
                .map(|index| {
                    Layer::take(
                        weights,
                        config,
                        &format!("vision.transformer.layers.{index}"),
                    )
                })
                .collect::<Result<_, _>>()?,
            patch_size: patch,
        })
    }

    /// Encodes pixel values (3, side, side) to (patches, hidden), without the class token.
    pub(super) fn forward(&self, pixels: &Tensor) -> candle_core::Result<Tensor> {
        let patches = self
            .patch_embedding
            .forward(&unfold(pixels, self.patch_size)?)?;
        let mut x = embed(&self.class_embedding, &patches, &self.position_embedding)?;
        let parts = Part::images(1, x.dim(0)?);
        for layer in &self.layers {
            x = layer.forward(&x, &parts)?;
        }
        x.narrow(0, 1, x.dim(0)? - 1)
    }
}

impl Layer {
    fn take(weights: &mut Weights, config: &VisionConfig, name: &str) -> Result<Self, MllmError> {
        let (hidden, wide, eps) = (config.hidden, config.intermediate, config.layer_norm_eps);
        let attention = SelfAttention {
            qkv: weights.take_linear(
                &format!("{name}.attention.query_key_value"),
                hidden,
                3 * hidden,
                true,
            )?,
            out: weights.take_linear(&format!("{name}.attention.dense"), hidden, hidden, true)?,
            heads: config.heads,
        };
        Ok(Self {
            attention,
            attention_norm: weights.take_layer_norm(
                &format!("{name}.input_layernorm"),
                hidden,
                eps,
            )?,
            fc1: weights.take_linear(&format!("{name}.mlp.fc1"), hidden, wide, true)?,
            act: config.act,
            fc2: weights.take_linear(&format!("{name}.mlp.fc2"), wide, hidden, true)?,
            mlp_norm: weights.take_layer_norm(
                &format!("{name}.post_attention_layernorm"),
                hidden,
                eps,
            )?,
        })
    }

    /// x + norm(attention(x)), then x + norm(mlp(x)).
    fn forward(&self, x: &Tensor, parts: &[Part]) -> candle_core::Result<Tensor> {
        let x = (x + self
            .attention_norm
            .forward(&self.attention.forward(x, parts)?)?)?;
        let wide = self.fc1.forward_then(&x, self.act)?;
        &x + self.mlp_norm.forward(&self.fc2.forward(&wide)?)?
    }
}
