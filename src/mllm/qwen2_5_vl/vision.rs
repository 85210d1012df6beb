//! The vision tower of Qwen2.5-VL and its merger.

use super::config::Qwen25VlConfig;
use crate::MllmError;
use crate::checkpoint::{VisionConfig, Weights};
use crate::decoder::{SwiGlu, SwiGluShape};
use crate::family::{ImageFeatures, ImageLayout};
use crate::qwen3_vl::{PatchEncoder, PatchMerger, take_patch_embedding};
use crate::vision::{Part, SelfAttention, merge_blocks, unfold};
use candle_core::{Device, Tensor};
use planagent_kernels::Linear;
use planagent_kernels::RmsNorm;
use planagent_kernels::attention::RotaryRows;

/// Base of the rotary embedding of patches.
const ROTARY_BASE: f64 = 10_000.0;

/// Tower and merger, from pixel values to input rows of the decoder.
#[derive(Debug)]
pub(crate) struct ImageEncoder {
    patch_embedding: Linear,
    layers: Vec<Layer>,
    norm: RmsNorm,
    merger: PatchMerger,
    patch_size: usize,
    head: usize,
    merge: usize,
    window: usize,
}

#[derive(Debug)]
struct Layer {
    norm1: RmsNorm,
    attention: SelfAttention,
    norm2: RmsNorm,
    mlp: SwiGlu,
    /// Whether it attends to the whole image; otherwise within windows.
    whole: bool,
}

/// The patches of an image in the order of their windows.
struct Windows {
    /// The patch of each row, in raster order of the image.
    order: Vec<u32>,
    /// Rows of each window.
    lengths: Vec<usize>,
}

impl Windows {
    fn new([rows, columns]: [usize; 2], side: usize) -> Self {
        let mut windows = Self {
            order: Vec::with_capacity(rows * columns),
            lengths: Vec::new(),
        };
        for top in (0..rows).step_by(side) {
            for left in (0..columns).step_by(side) {
                let before = windows.order.len();
                for row in top..rows.min(top + side) {
                    windows.order.extend(
                        (left..columns.min(left + side))
                            .map(|column| (row * columns + column) as u32),
                    );
                }
                windows.lengths.push(windows.order.len() - before);
            }
        }
        windows
    }

    /// The row of each patch.
    fn back(&self) -> Vec<u32> {
        let mut back = vec![0; self.order.len()];
        for (row, patch) in self.order.iter().enumerate() {
            if let Some(place) = back.get_mut(*patch as usize) {
                *place = row as u32;
            }
        }
        back
    }
}

impl ImageEncoder {
    pub(super) fn take(weights: &mut Weights, config: &Qwen25VlConfig) -> Result<Self, MllmError> {
        const PROJECTOR: &str = "multi_modal_projector";
        let vision = &config.vision;
        let hidden = vision.hidden;
        let merged = hidden * config.merge * config.merge;
        Ok(Self {
            patch_embedding: take_patch_embedding(
                weights,
                hidden,
                vision.patch_size,
                config.frames,
                false,
            )?,
            layers: (0..vision.layers)
                .map(|index| Layer::take(weights, vision, index, config.whole.contains(&index)))
                .collect::<Result<_, _>>()?,
            norm: weights.take_rms_norm(
                &format!("{PROJECTOR}.norm"),
                hidden,
                vision.layer_norm_eps,
            )?,
            merger: PatchMerger::take(weights, PROJECTOR, merged, config.text.hidden)?,
            patch_size: vision.patch_size,
            head: hidden / vision.heads,
            merge: config.merge,
            window: config.window,
        })
    }
}

impl PatchEncoder for ImageEncoder {
    fn encode(&self, pixels: &Tensor) -> candle_core::Result<ImageFeatures> {
        let grid = [
            pixels.dim(1)? / self.patch_size,
            pixels.dim(2)? / self.patch_size,
        ];
        let windows = Windows::new(grid, self.window);
        let select =
            |x: &Tensor, rows: Vec<u32>| x.index_select(&Tensor::new(rows, &Device::Cpu)?, 0);
        let patches = self
            .patch_embedding
            .forward(&unfold(pixels, self.patch_size)?)?;
        // Patches are sorted by window once, so that both kinds of layers attend to runs of rows.
        let mut x = select(&patches, windows.order.clone())?;
        let places = windows
            .order
            .iter()
            .map(|patch| [*patch as usize / grid[1], *patch as usize % grid[1]]);
        let rotary = RotaryRows::of_patches(places, self.head, ROTARY_BASE);
        let mut first = 0;
        let within: Vec<Part> = windows
            .lengths
            .iter()
            .map(|tokens| {
                first += tokens;
                Part {
                    tokens: *tokens,
                    rotary: Some(rotary.of_rows(first - tokens..first)),
                }
            })
            .collect();
        let whole = [Part {
            tokens: first,
            rotary: Some(rotary),
        }];
        for layer in &self.layers {
            x = layer.forward(&x, if layer.whole { &whole } else { &within })?;
        }
        let x = select(&self.norm.forward(&x)?, windows.back())?;
        let features = self.merger.forward(&merge_blocks(&x, grid, self.merge)?)?;
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

impl Layer {
    fn take(
        weights: &mut Weights,
        config: &VisionConfig,
        index: usize,
        whole: bool,
    ) -> Result<Self, MllmError> {
        let name = format!("vision_tower.encoder.layers.{index}");
        let (hidden, eps) = (config.hidden, config.layer_norm_eps);
        let shape = SwiGluShape {
            names: ["gate_proj", "up_proj", "down_proj"],
            hidden,
            intermediate: config.intermediate,
            bias: true,
        };
        Ok(Self {
            norm1: weights.take_rms_norm(&format!("{name}.layer_norm1"), hidden, eps)?,
            attention: SelfAttention::take(
                weights,
                &format!("{name}.self_attn"),
                hidden,
                config.heads,
            )?,
            norm2: weights.take_rms_norm(&format!("{name}.layer_norm2"), hidden, eps)?,
            mlp: SwiGlu::take(weights, &format!("{name}.mlp"), shape)?,
            whole,
        })
    }

    fn forward(&self, x: &Tensor, parts: &[Part]) -> candle_core::Result<Tensor> {
        let x = self
            .attention
            .forward_onto(&self.norm1.forward(x)?, parts, x)?;
        self.mlp.forward_onto(&self.norm2.forward(&x)?, &x)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_are_cut_from_the_top_left() {
        let windows = Windows::new([3, 4], 2);
        assert_eq!(windows.lengths, [4, 4, 2, 2]);
        assert_eq!(windows.order, [0, 1, 4, 5, 2, 3, 6, 7, 8, 9, 10, 11]);
        let back = windows.back();
        assert!(
            windows
                .order
                .iter()
                .enumerate()
                .all(|(row, patch)| back[*patch as usize] == row as u32)
        );
    }
}
