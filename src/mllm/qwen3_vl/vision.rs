//! The vision tower of Qwen3-VL and its mergers.

use super::config::Qwen3VlConfig;
use super::merger::PatchMerger;
use super::model::PatchEncoder;
use super::patches::take_patch_embedding;
use crate::MllmError;
use crate::checkpoint::Weights;
use crate::family::{ImageFeatures, ImageLayout};
use crate::vision::{Part, VisionLayer, merge_blocks, unfold};
use candle_core::{Device, Tensor};
use planagent_kernels::LayerNorm;
use planagent_kernels::Linear;
use planagent_kernels::attention::RotaryRows;

/// Base of the rotary embedding of patches.
const ROTARY_BASE: f64 = 10_000.0;

/// Tower and mergers, from pixel values to input rows of the decoder. The patches stay in raster
/// order.
#[derive(Debug)]
pub(crate) struct ImageEncoder {
    patch_embedding: Linear,
    /// (side · side, hidden)
    position_embedding: Vec<f32>,
    /// Learned positions along a side.
    side: usize,
    layers: Vec<VisionLayer>,
    norm: LayerNorm,
    merger: PatchMerger,
    /// Layer of the tower, norm over a whole block, merger.
    deep: Vec<(usize, LayerNorm, PatchMerger)>,
    patch_size: usize,
    hidden: usize,
    head: usize,
    merge: usize,
}

impl ImageEncoder {
    pub(crate) fn take(weights: &mut Weights, config: &Qwen3VlConfig) -> Result<Self, MllmError> {
        const PROJECTOR: &str = "multi_modal_projector";
        let vision = &config.vision;
        let (hidden, decoder, eps) = (vision.hidden, config.text.hidden, vision.layer_norm_eps);
        let merged = hidden * config.merge * config.merge;
        let positions = [config.positions * config.positions, hidden];
        let learned = weights.take(
            "vision_tower.embeddings.position_embedding.weight",
            &positions,
        )?;
        // A merger that reads a layer inside the tower, with its own norm, for an early layer of
        // the decoder.
        let deep = config.deep.iter().enumerate().map(|(index, layer)| {
            let name = format!("{PROJECTOR}.deepstack.{index}");
            let norm = weights.take_layer_norm(&format!("{name}.norm"), merged, eps)?;
            Ok((
                *layer,
                norm,
                PatchMerger::take(weights, &name, merged, decoder)?,
            ))
        });
        Ok(Self {
            deep: deep.collect::<Result<_, MllmError>>()?,
            patch_embedding: take_patch_embedding(
                weights,
                hidden,
                vision.patch_size,
                config.frames,
                true,
            )?,
            position_embedding: learned.flatten_all()?.to_vec1()?,
            side: config.positions,
            layers: (0..vision.layers)
                .map(|index| {
                    VisionLayer::take(
                        weights,
                        vision,
                        &format!("vision_tower.encoder.layers.{index}"),
                    )
                })
                .collect::<Result<_, _>>()?,
            norm: weights.take_layer_norm(&format!("{PROJECTOR}.norm"), hidden, eps)?,
            merger: PatchMerger::take(weights, PROJECTOR, merged, decoder)?,
            patch_size: vision.patch_size,
            hidden,
            head: hidden / vision.heads,
            merge: config.merge,
        })
    }

    /// The learned positions of a grid of patches, interpolated between the four nearest.
    fn positions(&self, [rows, columns]: [usize; 2]) -> candle_core::Result<Tensor> {
        let mut positions = vec![0f32; rows * columns * self.hidden];
        let (vertical, horizontal) = (taps(self.side, rows), taps(self.side, columns));
        let places = vertical
            .iter()
            .flat_map(|row| horizontal.iter().map(move |column| (row, column)));
        for (out, (row, column)) in positions.chunks_exact_mut(self.hidden).zip(places) {
            for (above, by) in row {
                for (left, weight) in column {
                    let start = (above * self.side + left) * self.hidden;
                    let learned = self
                        .position_embedding
                        .get(start..start + self.hidden)
                        .expect("taps lie within the learned grid");
                    out.iter_mut()
                        .zip(learned)
                        .for_each(|(out, value)| *out += by * weight * value);
                }
            }
        }
        Tensor::from_vec(positions, (rows * columns, self.hidden), &Device::Cpu)
    }
}

impl PatchEncoder for ImageEncoder {
    fn encode(&self, pixels: &Tensor) -> candle_core::Result<ImageFeatures> {
        let grid = [
            pixels.dim(1)? / self.patch_size,
            pixels.dim(2)? / self.patch_size,
        ];
        let [rows, columns] = grid;
        let patches = self
            .patch_embedding
            .forward(&unfold(pixels, self.patch_size)?)?;
        let mut x = (patches + self.positions(grid)?)?;
        let places = (0..rows * columns).map(|patch| [patch / columns, patch % columns]);
        let rotary = Some(RotaryRows::of_patches(places, self.head, ROTARY_BASE));
        let parts = [Part {
            tokens: rows * columns,
            rotary,
        }];
        let mut deep = Vec::with_capacity(self.deep.len());
        for (index, layer) in self.layers.iter().enumerate() {
            x = layer.forward(&x, &parts)?;
            // In the loop, since the mergers read the states between the layers, which are not
            // kept.
            for (_, norm, merger) in self.deep.iter().filter(|(layer, ..)| *layer == index) {
                deep.push(merger.forward(&norm.forward(&merge_blocks(&x, grid, self.merge)?)?)?);
            }
        }
        let features =
            self.merger
                .forward(&merge_blocks(&self.norm.forward(&x)?, grid, self.merge)?)?;
        let [rows, columns] = grid.map(|side| side / self.merge);
        Ok(ImageFeatures {
            rows: features,
            deep,
            layouts: vec![ImageLayout {
                tokens: rows * columns,
                rows,
                columns,
            }],
        })
    }
}

/// The two nearest of `side` learned positions of each of `places`, with their weights. The corners
/// of both grids agree.
fn taps(side: usize, places: usize) -> Vec<[(usize, f32); 2]> {
    let last = side - 1;
    let step = if places > 1 {
        last as f32 / (places - 1) as f32
    } else {
        0.0
    };
    (0..places)
        .map(|place| {
            let at = (place as f32 * step).min(last as f32);
            let lower = at as usize;
            let part = at - lower as f32;
            [(lower, 1.0 - part), ((lower + 1).min(last), part)]
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::taps;

    #[test]
    fn corners_of_both_grids_agree() {
        assert_eq!(
            taps(3, 5),
            [
                [(0, 1.0), (1, 0.0)],
                [(0, 0.5), (1, 0.5)],
                [(1, 1.0), (2, 0.0)],
                [(1, 0.5), (2, 0.5)],
                [(2, 1.0), (2, 0.0)]
            ]
        );
        assert_eq!(taps(3, 1), [[(0, 1.0), (1, 0.0)]]);
    }
}
