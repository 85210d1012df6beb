//! The vision tower of Gemma 4, and its projector.

use super::config::{Gemma4Config, TowerConfig};
use crate::MllmError;
use crate::checkpoint::Weights;
use crate::family::{ImageFeatures, ImageLayout};
use crate::vision::{take_patch_embedding, unfold};
use candle_core::{Device, Result, Tensor};
use planagent_kernels::attention::{
    AttentionMask, HeadShape, KeyValues, Precision, Projected, RotaryRows, attend, attend_rounded,
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
        let (width, theta) = (self.config.head_dim, self.config.theta);
        let rotary = RotaryRows::of_patches(places(), width, theta).by_halves();
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
    gate: Linear,
    up: Linear,
    down: Linear,
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
            take_linear(
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
        let x = behind.forward_onto(&mixed, x)?;
        let normed = before_mlp.forward(&x)?;
        let gate = self.gate.forward(&normed)?;
        let gated = Activation::GeluTanh.gated_by(&gate, &self.up.forward(&normed)?)?;
        behind_mlp.forward_onto(&self.down.forward(&gated)?, &x)
    }
}

/// Attention among all patches, without a scale.
#[derive(Debug)]
struct Attention {
    query: Linear,
    key: Linear,
    value: Linear,
    out: Linear,
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
            take_linear(weights, config, &format!("{name}.{part}_proj"), sides)
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
        let queries = normed(of_queries, self.query.forward(x)?)?;
        let keys = normed(of_keys, self.key.forward(x)?)?;
        let values = normed(of_values, self.value.forward(x)?)?;
        let parts = [&queries, &keys, &values];
        let mixed = Projected::read_apart(parts, self.shape, Some(rotary), |rows| {
            // Where products round their inputs anyway, f32 would keep nothing.
            if self.query.rounds_inputs() {
                return attend_rounded(rows);
            }
            let mut held = KeyValues::new(self.shape, Precision::Single);
            held.write(rows, 0)?;
            attend(rows, &held, AttentionMask::All { positions: patches })
        })?;
        self.out.forward(&mixed)
    }
}

/// Takes a layer that may clamp what goes into it and comes out.
fn take_linear(
    weights: &mut Weights,
    config: &TowerConfig,
    name: &str,
    [inputs, outputs]: [usize; 2],
) -> std::result::Result<Linear, MllmError> {
    let linear = weights.take_linear(name, inputs, outputs, false)?;
    if !config.clamped {
        return Ok(linear);
    }
    let mut bound = |part: &str| weights.take_bound(&format!("{name}.{part}"));
    let bounds = [
        [bound("input_min")?, bound("input_max")?],
        [bound("output_min")?, bound("output_max")?],
    ];
    Ok(linear.clamped(bounds))
}
