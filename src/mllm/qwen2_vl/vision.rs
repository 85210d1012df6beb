//! The vision tower of Qwen2-VL and its merger.

use super::config::Qwen2VlConfig;
use crate::MllmError;
use crate::checkpoint::Weights;
use crate::family::{ImageFeatures, ImageLayout};
use crate::qwen3_vl::{PatchEncoder, PatchMerger, take_patch_embedding};
use crate::vision::{Part, VisionLayer, merge_blocks, unfold};
use candle_core::Tensor;
use planagent_kernels::LayerNorm;
use planagent_kernels::Linear;
use planagent_kernels::attention::RotaryRows;

/// Base of the rotary embedding of patches.
const ROTARY_BASE: f64 = 10_000.0;

/// Tower and merger, from pixel values to input rows of the decoder. The patches stay in raster
/// order: no layer but the merger depends on it.
#[derive(Debug)]
pub(crate) struct ImageEncoder {
    patch_embedding: Linear,
    layers: Vec<VisionLayer>,
    norm: LayerNorm,
    merger: PatchMerger,
    patch_size: usize,
    head: usize,
    merge: usize,
}

impl ImageEncoder {
    pub(super) fn take(weights: &mut Weights, config: &Qwen2VlConfig) -> Result<Self, MllmError> {
        const PROJECTOR: &str = "multi_modal_projector";
        let vision = &config.vision;
        let hidden = vision.hidden;
        let merged = hidden * config.merge * config.merge;
        let layer = |index: usize| format!("vision_tower.encoder.layers.{index}");
        Ok(Self {
            patch_embedding: take_patch_embedding(
                weights,
                hidden,
                vision.patch_size,
                config.frames,
                false,
            )?,
            layers: (0..vision.layers)
                .map(|index| VisionLayer::take(weights, vision, &layer(index)))
                .collect::<Result<_, _>>()?,
            norm: weights.take_layer_norm(
                &format!("{PROJECTOR}.norm"),
                hidden,
                vision.layer_norm_eps,
            )?,
            merger: PatchMerger::take(weights, PROJECTOR, merged, config.text.hidden)?,
            patch_size: vision.patch_size,
            head: hidden / vision.heads,
            merge: config.merge,
        })
    }
}

impl PatchEncoder for ImageEncoder {
    fn encode(&self, pixels: &Tensor) -> candle_core::Result<ImageFeatures> {
        let grid = [
            pixels.dim(1)? / self.patch_size,
            pixels.dim(2)? / self.patch_size,
        ];
        let [rows, columns] = grid;
        let mut x = self
            .patch_embedding
            .forward(&unfold(pixels, self.patch_size)?)?;
        let places = (0..rows * columns).map(|patch| [patch / columns, patch % columns]);
        // One part: unlike those of Qwen2.5-VL, all layers attend to the whole image.
        let parts = [Part {
            tokens: rows * columns,
            rotary: Some(RotaryRows::of_patches(places, self.head, ROTARY_BASE)),
        }];
        for layer in &self.layers {
            x = layer.forward(&x, &parts)?;
        }
        let normed = self.norm.forward(&x)?;
        let features = self
            .merger
            .forward(&merge_blocks(&normed, grid, self.merge)?)?;
        let [rows, columns] = grid.map(|side| side / self.merge);
        Ok(ImageFeatures {
            rows: features,
            deep: Vec::new(),
            layouts: vec![ImageLayout {
                tokens: rows * columns,
                rows,
                columns,
            }],
        })
    }
}
