//! Attention and class tokens of vision transformers.

use crate::MllmError;
use crate::checkpoint::Weights;
use candle_core::{Result, Tensor};
use planagent_kernels::Linear;
use planagent_kernels::attention::{
    AttentionMask, HeadShape, KeyValues, Precision, Projected, RotaryRows, attend, attend_rounded,
};

/// Attention among the tokens of each part of a batch. Query, key and value projections are one
/// matrix.
#[derive(Debug)]
pub(crate) struct SelfAttention {
    /// (hidden) to (3, heads, head width).
    pub qkv: Linear,
    pub out: Linear,
    pub heads: usize,
}

/// Consecutive tokens of a batch that attend to one another: an image, a tile or a window.
#[derive(Debug)]
pub(crate) struct Part {
    pub tokens: usize,
    /// The angles of the tokens' queries and keys; none for towers that learn their positions.
    pub rotary: Option<RotaryRows>,
}

impl Part {
    /// Images of `tokens` tokens each, without rotary embeddings.
    pub(crate) fn images(images: usize, tokens: usize) -> Vec<Self> {
        (0..images)
            .map(|_| Self {
                tokens,
                rotary: None,
            })
            .collect()
    }
}

impl SelfAttention {
    /// Takes the projections of a layer called `name`: those to queries, keys and values are three
    /// matrices, or one.
    pub(crate) fn take(
        weights: &mut Weights,
        name: &str,
        hidden: usize,
        heads: usize,
    ) -> std::result::Result<Self, MllmError> {
        let fused = format!("{name}.qkv");
        let parts = if weights.contains(&format!("{fused}.weight")) {
            vec![(fused, 3 * hidden)]
        } else {
            ["q_proj", "k_proj", "v_proj"]
                .map(|part| (format!("{name}.{part}"), hidden))
                .to_vec()
        };
        Ok(Self {
            qkv: weights.take_fused(&parts, hidden, true)?,
            out: weights.take_linear(&format!("{name}.out_proj"), hidden, hidden, true)?,
            heads,
        })
    }

    /// The attention with a factor for each channel of its result.
    pub(super) fn scaled(self, scale: Tensor) -> Self {
        Self {
            out: self.out.scaled(scale),
            ..self
        }
    }

    /// Maps (tokens of all parts, hidden) to the same shape.
    pub(crate) fn forward(&self, x: &Tensor, parts: &[Part]) -> Result<Tensor> {
        self.out.forward(&self.mix(x, parts)?)
    }

    /// residual + attention(x), both (tokens of all parts, hidden).
    pub(crate) fn forward_onto(
        &self,
        x: &Tensor,
        parts: &[Part],
        residual: &Tensor,
    ) -> Result<Tensor> {
        self.out.forward_onto(&self.mix(x, parts)?, residual)
    }

    /// The concatenated results of the heads.
    fn mix(&self, x: &Tensor, parts: &[Part]) -> Result<Tensor> {
        let (_, hidden) = x.dims2()?;
        let shape = HeadShape {
            query_heads: self.heads,
            key_heads: self.heads,
            width: hidden / self.heads,
        };
        let qkv = self.qkv.forward(x)?;
        let mut first = 0;
        let mut mixed = Vec::with_capacity(parts.len());
        for Part { tokens, rotary } in parts {
            let rows = qkv.narrow(0, first, *tokens)?;
            mixed.push(Projected::read(&rows, shape, rotary.as_ref(), |rows| {
                // Where products round their inputs anyway, f32 would keep nothing.
                if self.qkv.rounds_inputs() {
                    return attend_rounded(rows);
                }
                let mut held = KeyValues::new(shape, Precision::Single);
                held.write(rows, 0)?;
                attend(rows, &held, AttentionMask::All { positions: *tokens })
            })?);
            first += tokens;
        }
        Tensor::cat(&mixed, 0)
    }
}

/// Puts a class token, (1, hidden), before the patches of each image, (images · patches, hidden),
/// and adds the position embeddings, (1 + patches, hidden). Returns (images · (1 + patches),
/// hidden).
pub(crate) fn embed(class: &Tensor, patches: &Tensor, positions: &Tensor) -> Result<Tensor> {
    let (tokens, hidden) = positions.dims2()?;
    let patches = patches.reshape(((), tokens - 1, hidden))?;
    let images = patches.dim(0)?;
    let class = class.unsqueeze(0)?.expand((images, 1, hidden))?;
    Tensor::cat(&[&class, &patches], 1)?
        .broadcast_add(positions)?
        .reshape((images * tokens, hidden))
}
