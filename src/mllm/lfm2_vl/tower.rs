//! The `SigLIP2` tower for views of any size (`NaFlex`: Tschannen et al., arXiv:2502.14786), and
//! the projector behind it.

use super::config::Lfm2VlConfig;
use crate::MllmError;
use crate::checkpoint::{VisionConfig, Weights};
use crate::tiled::TileEncoder;
use crate::vision::{Part, VisionLayer, merge_blocks, unfold};
use candle_core::{Device, Tensor};
use planagent_kernels::matrix::Matrix;
use planagent_kernels::{Activation, LayerNorm, Linear};

/// Of the norm before the projector (the default of `torch.nn.LayerNorm`).
const PROJECTOR_EPS: f64 = 1e-5;
const PATCHES: &str = "vision_tower.embeddings.patch_embedding";
const PROJECTOR: &str = "multi_modal_projector";

/// Tower and projector, from the pixels of a view to input rows of the decoder.
#[derive(Debug)]
pub(super) struct ViewEncoder {
    patch_embedding: Linear,
    /// (side · side, hidden)
    position_embedding: Vec<f32>,
    /// Learned positions along a side.
    side: usize,
    layers: Vec<VisionLayer>,
    post_norm: LayerNorm,
    projector_norm: Option<LayerNorm>,
    first: Linear,
    act: Activation,
    second: Linear,
    patch_size: usize,
    hidden: usize,
    downsample: usize,
}

impl ViewEncoder {
    pub(super) fn take(weights: &mut Weights, config: &Lfm2VlConfig) -> Result<Self, MllmError> {
        let vision = &config.vision;
        let (hidden, block) = (vision.hidden, config.block());
        let learned = weights.take(
            "vision_tower.embeddings.position_embedding.weight",
            &[config.positions * config.positions, hidden],
        )?;
        let layer = |index| format!("vision_tower.encoder.layers.{index}");
        // Unlike in LLaVA, features are the states behind the last norm of the tower.
        Ok(Self {
            patch_embedding: take_patch_embedding(weights, vision)?,
            position_embedding: learned.flatten_all()?.to_vec1()?,
            side: config.positions,
            layers: (0..vision.layers)
                .map(|index| VisionLayer::take(weights, vision, &layer(index)))
                .collect::<Result<_, _>>()?,
            post_norm: weights.take_layer_norm(
                "vision_tower.post_layernorm",
                hidden,
                vision.layer_norm_eps,
            )?,
            projector_norm: if config.projector_norm {
                let name = format!("{PROJECTOR}.layer_norm");
                Some(weights.take_layer_norm(&name, block, PROJECTOR_EPS)?)
            } else {
                None
            },
            first: weights.take_linear(
                &format!("{PROJECTOR}.linear_1"),
                block,
                config.projector,
                config.projector_bias,
            )?,
            act: config.projector_act,
            second: weights.take_linear(
                &format!("{PROJECTOR}.linear_2"),
                config.projector,
                config.text.hidden,
                config.projector_bias,
            )?,
            patch_size: vision.patch_size,
            hidden,
            downsample: config.downsample,
        })
    }

    /// The learned positions of a grid of patches: interpolated, and averaged where the grid is
    /// smaller than the learned one (bilinear with antialias).
    fn positions(&self, [rows, columns]: [usize; 2]) -> candle_core::Result<Tensor> {
        let (vertical, horizontal) = (shares(self.side, rows), shares(self.side, columns));
        let mut positions = vec![0f32; rows * columns * self.hidden];
        let width = columns * self.hidden;
        for (row, line) in vertical
            .iter()
            .zip(positions.chunks_exact_mut(width.max(1)))
        {
            for (column, out) in horizontal.iter().zip(line.chunks_exact_mut(self.hidden)) {
                for (above, by) in row {
                    for (left, share) in column {
                        let start = (above * self.side + left) * self.hidden;
                        let learned = self
                            .position_embedding
                            .get(start..start + self.hidden)
                            .expect("shares lie within the learned grid");
                        out.iter_mut()
                            .zip(learned)
                            .for_each(|(out, value)| *out += by * share * value);
                    }
                }
            }
        }
        Tensor::from_vec(positions, (rows * columns, self.hidden), &Device::Cpu)
    }
}

impl TileEncoder for ViewEncoder {
    /// The pixel values are those of whole tokens.
    fn encode(&self, pixels: &Tensor) -> candle_core::Result<Tensor> {
        let grid = [1, 2].map(|side| {
            pixels
                .dims()
                .get(side)
                .map_or(0, |side| side / self.patch_size)
        });
        let [rows, columns] = grid;
        let patches = self
            .patch_embedding
            .forward(&unfold(pixels, self.patch_size)?)?;
        let mut x = (patches + self.positions(grid)?)?;
        let parts = Part::images(1, rows * columns);
        for layer in &self.layers {
            x = layer.forward(&x, &parts)?;
        }
        let blocks = merge_blocks(&self.post_norm.forward(&x)?, grid, self.downsample)?;
        let blocks = match &self.projector_norm {
            Some(norm) => norm.forward(&blocks)?,
            None => blocks,
        };
        self.second
            .forward(&self.first.forward_then(&blocks, self.act)?)
    }
}

/// Takes the embedding of patches: a matrix whose rows are (y, x, channel), or, in llama.cpp's
/// files, a kernel (channel, y, x).
fn take_patch_embedding(weights: &mut Weights, vision: &VisionConfig) -> Result<Linear, MllmError> {
    let (hidden, side) = (vision.hidden, vision.patch_size);
    let name = format!("{PATCHES}.weight");
    let rank = weights
        .shapes()
        .find(|(known, _)| *known == name)
        .map(|(_, shape)| shape.len());
    let kernel = if rank == Some(4) {
        weights.take(&name, &[hidden, 3, side, side])?
    } else {
        weights
            .take(&name, &[hidden, side * side * 3])?
            .reshape((hidden, side, side, 3))?
            .permute((0, 3, 1, 2))?
            .contiguous()?
    };
    let bias = weights.take(&format!("{PATCHES}.bias"), &[hidden])?;
    let matrix = Matrix::from_tensor(&kernel.flatten_from(1)?)?;
    Ok(Linear::from_matrix(matrix, Some(bias)))
}

/// The shares of `side` learned positions in each of `places`: a triangle about its center, as wide
/// as the steps between places where these are wider than one. Centers of the outer halves do not
/// agree.
fn shares(side: usize, places: usize) -> Vec<Vec<(usize, f32)>> {
    let step = side as f64 / places.max(1) as f64;
    let reach = step.max(1.0);
    (0..places)
        .map(|place| {
            let center = (place as f64 + 0.5) * step - 0.5;
            let share = |at: usize| 1.0 - (at as f64 - center).abs() / reach;
            let near: Vec<(usize, f64)> = (0..side)
                .map(|at| (at, share(at)))
                .filter(|(_, share)| *share > 0.0)
                .collect();
            let sum: f64 = near.iter().map(|(_, share)| share).sum();
            near.into_iter()
                .map(|(at, share)| (at, (share / sum) as f32))
                .collect()
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::shares;

    #[test]
    fn positions_are_averaged_where_there_are_fewer_and_kept_at_the_borders() {
        assert_eq!(shares(2, 2), [[(0, 1.0)], [(1, 1.0)]]);
        assert_eq!(
            shares(4, 2)[0],
            [(0, 0.428_571_43), (1, 0.428_571_43), (2, 0.142_857_15)]
        );
        let wide = shares(2, 4);
        assert_eq!(wide[0], [(0, 1.0)]);
        assert_eq!(wide[1], [(0, 0.75), (1, 0.25)]);
        assert!(shares(16, 23).iter().flatten().all(|(at, _)| *at < 16));
    }
}
