//! What the vision transformers of all families have in common.

use candle_core::{D, Result, Tensor};

use crate::mllm::linear::Linear;

/// Attention of every row to every row; query, key and value projections are one matrix.
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
    /// Maps (tokens, hidden) to as much.
    pub(crate) fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let (tokens, hidden) = x.dims2()?;
        let head_dim = hidden / self.heads;
        // (tokens, 3, heads, head_dim) to (3, heads, tokens, head_dim)
        let qkv =
            self.qkv.forward(x)?.reshape((tokens, 3, self.heads, head_dim))?.permute((1, 2, 0, 3))?.contiguous()?;
        let scale = 1.0 / (head_dim as f64).sqrt();
        let scores = (qkv.get(0)? * scale)?.matmul(&qkv.get(1)?.t()?)?;
        let mixed = candle_nn::ops::softmax(&scores, D::Minus1)?.matmul(&qkv.get(2)?)?;
        self.out.forward(&mixed.transpose(0, 1)?.reshape((tokens, hidden))?)
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
