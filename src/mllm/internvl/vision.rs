//! `InternViT` and the projector.

use super::config::InternVlConfig;
use crate::MllmError;
use crate::checkpoint::Weights;
use crate::tiled::TileEncoder;
use crate::vision::{Part, VisionLayer, embed, merge_blocks, take_patch_embedding, unfold};
use candle_core::Tensor;
use planagent_kernels::Activation;
use planagent_kernels::LayerNorm;
use planagent_kernels::Linear;

/// Epsilon of the projector's norm, torch's default.
const PROJECTOR_EPS: f64 = 1e-5;

/// Vision tower and projector, from the pixel values of a tile to input rows of the decoder.
#[derive(Debug)]
pub(crate) struct ImageEncoder {
    class_embedding: Tensor,
    patch_embedding: Linear,
    position_embedding: Tensor,
    layers: Vec<VisionLayer>,
    projector_norm: LayerNorm,
    linear1: Linear,
    linear2: Linear,
    patch_size: usize,
    /// Patches along a side.
    side: usize,
    scale: usize,
}

impl ImageEncoder {
    pub(super) fn take(weights: &mut Weights, config: &InternVlConfig) -> Result<Self, MllmError> {
        let vision = &config.vision;
        let (hidden, decoder) = (vision.hidden, config.text.hidden);
        let merged = hidden * config.scale * config.scale;
        let embeddings = "vision_tower.embeddings";
        let positions = format!("{embeddings}.position_embedding.weight");
        let projector = |layer: &str| format!("multi_modal_projector.{layer}");
        let patches = format!("{embeddings}.patch_embedding");
        // One literal, in the order of the forward pass.
        Ok(Self {
            class_embedding: weights
                .take_of_any_rank(&format!("{embeddings}.class_embedding"), &[1, hidden])?,
            patch_embedding: take_patch_embedding(
                weights,
                &patches,
                hidden,
                vision.patch_size,
                true,
            )?,
            position_embedding: weights
                .take_of_any_rank(&positions, &[vision.patches() + 1, hidden])?,
            layers: (0..vision.layers)
                .map(|index| {
                    VisionLayer::take_scaled(
                        weights,
                        vision,
                        &format!("vision_tower.encoder.layers.{index}"),
                    )
                })
                .collect::<Result<_, _>>()?,
            projector_norm: weights.take_layer_norm(
                &projector("layer_norm"),
                merged,
                PROJECTOR_EPS,
            )?,
            linear1: weights.take_linear(&projector("linear_1"), merged, decoder, true)?,
            linear2: weights.take_linear(&projector("linear_2"), decoder, decoder, true)?,
            patch_size: vision.patch_size,
            side: vision.image_size / vision.patch_size,
            scale: config.scale,
        })
    }

    /// The tower's output without its class token: (patches, tower width). No norm follows the last
    /// layer.
    pub(super) fn patches(&self, pixels: &Tensor) -> candle_core::Result<Tensor> {
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

    /// Maps merged patches to input rows of the decoder.
    pub(super) fn project(&self, merged: &Tensor) -> candle_core::Result<Tensor> {
        let normed = self.projector_norm.forward(merged)?;
        self.linear2
            .forward(&self.linear1.forward_then(&normed, Activation::Gelu)?)
    }
}

impl TileEncoder for ImageEncoder {
    fn encode(&self, pixels: &Tensor) -> candle_core::Result<Tensor> {
        self.project(&merge_blocks(
            &self.patches(pixels)?,
            [self.side, self.side],
            self.scale,
        )?)
    }
}
