//! What the vision transformers of all families have in common.

use candle_core::{Result, Tensor};

use crate::mllm::attention::{AttentionMask, HeadShape, KeyValues, Precision, Projected, attend};
use crate::mllm::linear::Linear;

/// Attention of every row of an image to every row of it; query, key and value projections are one matrix.
#[derive(Debug)]
pub(crate) struct SelfAttention {
    /// (hidden) to (3, heads, head width).
    pub qkv: Linear,
    /// The output projection.
    pub out: Linear,
    /// Number of heads.
    pub heads: usize,
}

impl SelfAttention {
    /// Maps rows of as many tokens each image, (images · tokens, hidden), to as many.
    pub(crate) fn forward(&self, x: &Tensor, images: usize) -> Result<Tensor> {
        self.out.forward(&self.mix(x, images)?)
    }

    /// residual + what it makes of x, both (images · tokens, hidden).
    pub(crate) fn forward_onto(&self, x: &Tensor, images: usize, residual: &Tensor) -> Result<Tensor> {
        self.out.forward_onto(&self.mix(x, images)?, residual)
    }

    /// The heads' results side by side.
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

/// Cuts pixels (3, side, side) into rows of one patch each, (patches, 3 · patch²), as a convolution's kernel is laid out;
/// what is left over at the right and the bottom is dropped.
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

/// Puts a class token, (1, hidden), before the patches of each image, (images · patches, hidden), and adds the embeddings of
/// their positions, (1 + patches, hidden); gives (images · (1 + patches), hidden).
pub(crate) fn embed(class: &Tensor, patches: &Tensor, positions: &Tensor) -> Result<Tensor> {
    let (tokens, hidden) = positions.dims2()?;
    let patches = patches.reshape(((), tokens - 1, hidden))?;
    let images = patches.dim(0)?;
    let class = class.unsqueeze(0)?.expand((images, 1, hidden))?;
    Tensor::cat(&[&class, &patches], 1)?.broadcast_add(positions)?.reshape((images * tokens, hidden))
}
