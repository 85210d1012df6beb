//! Shared parts of vision transformers.

use candle_core::{Result, Tensor};

use crate::mllm::attention::{AttentionMask, HeadShape, KeyValues, Precision, Projected, attend};
use crate::mllm::linear::Linear;

/// Attention among all tokens of an image. Query, key and value projections are one matrix.
#[derive(Debug)]
pub(crate) struct SelfAttention {
    /// (hidden) to (3, heads, head width).
    pub qkv: Linear,
    pub out: Linear,
    pub heads: usize,
}

impl SelfAttention {
    /// Maps (images · tokens, hidden) to the same shape.
    pub(crate) fn forward(&self, x: &Tensor, images: usize) -> Result<Tensor> {
        self.out.forward(&self.mix(x, images)?)
    }

    /// residual + attention(x), both (images · tokens, hidden).
    pub(crate) fn forward_onto(&self, x: &Tensor, images: usize, residual: &Tensor) -> Result<Tensor> {
        self.out.forward_onto(&self.mix(x, images)?, residual)
    }

    /// The concatenated results of the heads.
    fn mix(&self, x: &Tensor, images: usize) -> Result<Tensor> {
        let (rows, hidden) = x.dims2()?;
        let tokens = rows / images;
        let shape = HeadShape { query_heads: self.heads, key_heads: self.heads, width: hidden / self.heads };
        let qkv = self.qkv.forward(x)?;
        let partial = (0..images).map(|image| {
            Projected::of(&qkv.narrow(0, image * tokens, tokens)?, shape, None, |rows| {
                let mut held = KeyValues::new(shape, Precision::Single);
                held.write(rows, 0)?;
                attend(rows, &held, AttentionMask::All { positions: tokens })
            })
        });
        Tensor::cat(&partial.collect::<Result<Vec<_>>>()?, 0)
    }
}

/// Cuts pixels (3, side, side) into patches, (patches, 3 · patch²), in the layout of a convolution kernel. Drops the remainder
/// at the right and at the bottom.
pub(crate) fn unfold(pixels: &Tensor, patch: usize) -> Result<Tensor> {
    let grid = pixels.dim(1)? / patch;
    let used = grid * patch;
    pixels
        .narrow(1, 0, used)?
        .narrow(2, 0, used)?
        .reshape(vec![3, grid, patch, grid, patch])?
        .permute(vec![1, 3, 0, 2, 4])?
        .reshape((grid * grid, 3 * patch * patch))
}

/// Puts a class token, (1, hidden), before the patches of each image, (images · patches, hidden), and adds the position
/// embeddings, (1 + patches, hidden). Returns (images · (1 + patches), hidden).
pub(crate) fn embed(class: &Tensor, patches: &Tensor, positions: &Tensor) -> Result<Tensor> {
    let (tokens, hidden) = positions.dims2()?;
    let patches = patches.reshape(((), tokens - 1, hidden))?;
    let images = patches.dim(0)?;
    let class = class.unsqueeze(0)?.expand((images, 1, hidden))?;
    Tensor::cat(&[&class, &patches], 1)?.broadcast_add(positions)?.reshape((images * tokens, hidden))
}
