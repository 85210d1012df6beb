//! The vision tower of Gemma 4, and its projector.

use super::config::{Gemma4Config, TowerConfig};
use crate::MllmError;
use crate::checkpoint::Weights;
use crate::family::{ImageFeatures, ImageLayout};
use crate::vision::{take_patch_embedding, unfold};
use candle_core::{Device, Result, Tensor};
use planagent_kernels::attention::{
    AttentionMask, HeadShape, KeyValues, Precision, Projected, RotaryRows, attend,
};
use planagent_kernels::matrix::Matrix;
use planagent_kernels::{Activation, Linear, RmsNorm};

/// Tower and projector, from pixel values to input rows of the decoder.
#[derive(Debug)]
pub(super) struct ImageEncoder {
    patches: Linear,
    /// Positions by column, then by row: (2, positions, hidden).
    positions: Tensor,
    layers: Vec<Layer>,
    /// What is taken from the averages of blocks, and their factors.
    standard: Option<[Tensor; 2]>,
    norm: RmsNorm,
    projection: Linear,
    config: TowerConfig,
}

const TOWER: &str = "vision_tower";

impl ImageEncoder {
    pub(super) fn take(
        weights: &mut Weights,
        config: &Gemma4Config,
        tower: &TowerConfig,
    ) -> std::result::Result<Self, MllmError> {
        let hidden = tower.hidden;
        let positions = format!("{TOWER}.patch_embedder.position_embedding_table");
        let mut standard = |part: &str| weights.take(&format!("{TOWER}.std_{part}"), &[hidden]);
        let standard = if tower.standardized {
            Some([standard("bias")?, standard("scale")?])
        } else {
            None
        };
        Ok(Self {
            patches: patch_embedding(weights, tower)?,
            positions: weights.take(&positions, &[2, tower.positions, hidden])?,
            layers: (0..tower.layers)
                .map(|index| Layer::take(weights, tower, index))
                .collect::<std::result::Result<_, _>>()?,
            standard,
            norm: RmsNorm::new(vec![1.0; hidden], tower.eps),
            projection: weights.take_linear(
                "multi_modal_projector.embedding_projection",
                hidden,
                config.text.hidden,
                false,
            )?,
            config: tower.clone(),
        })
    }

    /// Encodes pixel values (3, height, width) from 0 to 1, of whole tokens.
    pub(super) fn encode(&self, pixels: &Tensor) -> Result<ImageFeatures> {
        let grid = [1, 2].map(|axis| {
            pixels
                .dims()
                .get(axis)
                .map_or(0, |side| side / self.config.patch)
        });
        let pooled = self.pooled(&self.patch_states(pixels, grid)?, grid)?;
        let rows = self.projected(&pooled)?;
        let [rows_of_tokens, columns] = grid.map(|side| side / self.config.pool);
        Ok(ImageFeatures {
            rows,
            deep: Vec::new(),
            layouts: vec![ImageLayout {
                tokens: rows_of_tokens * columns,
                rows: rows_of_tokens,
                columns,
            }],
        })
    }

    /// Maps (tokens, tower width) to (tokens, decoder width).
    pub(super) fn projected(&self, pooled: &Tensor) -> Result<Tensor> {
        self.projection.forward(&self.norm.forward(pooled)?)
    }

    /// The states of patches behind the last layer, (patches, hidden).
    pub(super) fn patch_states(
        &self,
        pixels: &Tensor,
        [rows, columns]: [usize; 2],
    ) -> Result<Tensor> {
        let centered = ((pixels - 0.5)? * 2.0)?;
        let places = || (0..rows).flat_map(|row| (0..columns).map(move |column| [column, row]));
        let learned = |axis: usize| {
            let at: Vec<u32> = places().map(|place| place[axis] as u32).collect();
            let at = Tensor::new(at, &Device::Cpu)?;
            self.positions.get(axis)?.index_select(&at, 0)
        };
        let patches = self
            .patches
            .forward(&unfold(&centered, self.config.patch)?)?;
        let mut x = (patches + (learned(0)? + learned(1)?)?)?;
        let rotary = RotaryRows::of_patches(places(), self.config.head_dim, self.config.theta);
        for layer in &self.layers {
            x = layer.forward(&x, &rotary)?;
        }
        Ok(x)
    }

    /// Averages of blocks of patches times the root of the width, (tokens, hidden).
    pub(super) fn pooled(&self, x: &Tensor, grid: [usize; 2]) -> Result<Tensor> {
        let (pool, hidden) = (self.config.pool, self.config.hidden);
        let [rows, columns] = grid.map(|side| side / pool);
        let averages = x
            .reshape(vec![rows, pool, columns, pool, hidden])?
            .mean(3)?
            .mean(1)?
            .reshape((rows * columns, hidden))?;
        let scaled = (averages * (hidden as f64).sqrt())?;
        match &self.standard {
            Some([bias, scale]) => scaled.broadcast_sub(bias)?.broadcast_mul(scale),
            None => Ok(scaled),
        }
    }
}

/// Takes the embedding of patches. Folders have a patch's numbers by pixel, then by channel, and
/// llama.cpp's files those of a convolution.
fn patch_embedding(
    weights: &mut Weights,
    tower: &TowerConfig,
) -> std::result::Result<Linear, MllmError> {
    const CONVOLUTION: &str = "vision_tower.embeddings.patch_embedding";
    let (hidden, side) = (tower.hidden, tower.patch);
    if weights.contains(&format!("{CONVOLUTION}.weight")) {
        return take_patch_embedding(weights, CONVOLUTION, hidden, side, false);
    }
    let name = format!("{TOWER}.patch_embedder.input_proj.weight");
    let numbers = 3 * side * side;
    let by_channel = weights
        .take(&name, &[hidden, numbers])?
        .reshape((hidden, side * side, 3))?
        .transpose(1, 2)?
        .reshape((hidden, numbers))?;
    Ok(Linear::from_matrix(Matrix::from_tensor(&by_channel)?, None))
}

/// x + norm(attention(norm(x))), then x + norm(mlp(norm(x))).
#[derive(Debug)]
struct Layer {
    /// Before and behind the attention, before and behind the feed-forward network.
    norms: [RmsNorm; 4],
    attention: Attention,
    gate: ClampedLinear,
    up: ClampedLinear,
    down: ClampedLinear,
}

impl Layer {
    fn take(
        weights: &mut Weights,
        config: &TowerConfig,
        index: usize,
    ) -> std::result::Result<Self, MllmError> {
        let name = format!("{TOWER}.encoder.layers.{index}");
        let (hidden, wide) = (config.hidden, config.intermediate);
        let mut norm = |part: &str| {
            weights.take_rms_norm(&format!("{name}.{part}_layernorm"), hidden, config.eps)
        };
        let norms = [
            norm("input")?,
            norm("post_attention")?,
            norm("pre_feedforward")?,
            norm("post_feedforward")?,
        ];
        // Gate and up projection are two matrices, because each has bounds of its own.
        let mut linear = |part: &str, [inputs, outputs]: [usize; 2]| {
            ClampedLinear::take(
                weights,
                config,
                &format!("{name}.mlp.{part}_proj"),
                [inputs, outputs],
            )
        };
        Ok(Self {
            norms,
            gate: linear("gate", [hidden, wide])?,
            up: linear("up", [hidden, wide])?,
            down: linear("down", [wide, hidden])?,
            attention: Attention::take(weights, config, &format!("{name}.self_attn"))?,
        })
    }

    fn forward(&self, x: &Tensor, rotary: &RotaryRows) -> Result<Tensor> {
        let [before, behind, before_mlp, behind_mlp] = &self.norms;
        let mixed = self.attention.forward(&before.forward(x)?, rotary)?;
        let x = (x + behind.forward(&mixed)?)?;
        let normed = before_mlp.forward(&x)?;
        let both = [self.gate.forward(&normed)?, self.up.forward(&normed)?];
        let gated = Activation::GeluTanh.gated(&Tensor::cat(&both, 1)?)?;
        &x + behind_mlp.forward(&self.down.forward(&gated)?)?
    }
}

/// Attention among all patches, without a scale.
#[derive(Debug)]
struct Attention {
    query: ClampedLinear,
    key: ClampedLinear,
    value: ClampedLinear,
    out: ClampedLinear,
    /// Of the heads of queries, keys and values.
    norms: [RmsNorm; 3],
    shape: HeadShape,
}

impl Attention {
    fn take(
        weights: &mut Weights,
        config: &TowerConfig,
        name: &str,
    ) -> std::result::Result<Self, MllmError> {
        let (hidden, width) = (config.hidden, config.head_dim);
        let [queries, keys] = config.heads.map(|heads| heads * width);
        // The attention divides by the root of the head's width.
        let scaled: Vec<f32> = weights
            .take(&format!("{name}.q_norm.weight"), &[width])?
            .affine((width as f64).sqrt(), 0.0)?
            .to_vec1()?;
        let key_norm = weights.take_rms_norm(&format!("{name}.k_norm"), width, config.eps)?;
        // Each has bounds of its own, so that they are no single matrix.
        let mut linear = |part: &str, sides: [usize; 2]| {
            ClampedLinear::take(weights, config, &format!("{name}.{part}_proj"), sides)
        };
        Ok(Self {
            query: linear("q", [hidden, queries])?,
            key: linear("k", [hidden, keys])?,
            value: linear("v", [hidden, keys])?,
            out: linear("o", [queries, hidden])?,
            norms: [
                RmsNorm::new(scaled, config.eps),
                key_norm,
                RmsNorm::new(vec![1.0; width], config.eps),
            ],
            shape: HeadShape {
                query_heads: config.heads[0],
                key_heads: config.heads[1],
                width,
            },
        })
    }

    fn forward(&self, x: &Tensor, rotary: &RotaryRows) -> Result<Tensor> {
        let patches = x.dim(0)?;
        let [of_queries, of_keys, of_values] = &self.norms;
        let normed = |norm: &RmsNorm, rows: Tensor| {
            norm.forward(&rows.reshape(((), norm.width()))?)?
                .reshape((patches, ()))
        };
        let rows = [
            halves_apart(
                &normed(of_queries, self.query.forward(x)?)?,
                self.shape.width,
            )?,
            halves_apart(&normed(of_keys, self.key.forward(x)?)?, self.shape.width)?,
            normed(of_values, self.value.forward(x)?)?,
        ];
        let rows = Tensor::cat(&rows, 1)?.contiguous()?;
        let mixed = Projected::read(&rows, self.shape, Some(rotary), |rows| {
            let mut held = KeyValues::new(self.shape, Precision::Single);
            held.write(rows, 0)?;
            attend(rows, &held, AttentionMask::All { positions: patches })
        })?;
        self.out.forward(&mixed)
    }
}

/// Heads whose first half turns by the column and whose second half by the row, each half by half,
/// in the order of a head that turns as a whole: first quarters, then second ones.
fn halves_apart(rows: &Tensor, width: usize) -> Result<Tensor> {
    let (patches, all) = rows.dims2()?;
    rows.reshape(vec![patches, all / width, 2, 2, width / 4])?
        .transpose(2, 3)?
        .reshape((patches, all))
}

/// A layer that may clamp what goes into it and comes out.
#[derive(Debug)]
struct ClampedLinear {
    linear: Linear,
    /// Least and greatest of the input, and of the output.
    bounds: Option<[[f32; 2]; 2]>,
}

impl ClampedLinear {
    fn take(
        weights: &mut Weights,
        config: &TowerConfig,
        name: &str,
        [inputs, outputs]: [usize; 2],
    ) -> std::result::Result<Self, MllmError> {
        let mut bound = |part: &str| weights.take_bound(&format!("{name}.{part}"));
        let bounds = if config.clamped {
            Some([
                [bound("input_min")?, bound("input_max")?],
                [bound("output_min")?, bound("output_max")?],
            ])
        } else {
            None
        };
        Ok(Self {
            linear: weights.take_linear(name, inputs, outputs, false)?,
            bounds,
        })
    }

    fn forward(&self, x: &Tensor) -> Result<Tensor> {
        match self.bounds {
            None => self.linear.forward(x),
            Some([[low, high], [least, most]]) => self
                .linear
                .forward(&x.clamp(low, high)?)?
                .clamp(least, most),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halves_of_a_head_are_laid_apart() {
        let rows = Tensor::arange(0_f32, 16.0, &Device::Cpu).unwrap();
        let apart = halves_apart(&rows.reshape((1, 16)).unwrap(), 8).unwrap();
        let found = apart.to_vec2::<f32>().unwrap().remove(0);
        assert_eq!(found[..8], [0.0, 1.0, 4.0, 5.0, 2.0, 3.0, 6.0, 7.0]);
        assert_eq!(found[8..], [8.0, 9.0, 12.0, 13.0, 10.0, 11.0, 14.0, 15.0]);
    }
}
