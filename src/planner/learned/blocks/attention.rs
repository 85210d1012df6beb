//! PyTorch's `MultiheadAttention`, batch first.

use super::{Linear, Weights, softmax};
use candle_core::{Device, Result, Tensor};

/// Attention of several heads with projections of queries, keys, values and the result.
#[derive(Debug, Clone)]
pub(in crate::planner::learned) struct MultiheadAttention {
    heads: usize,
    projections: [Linear; 3],
    output: Linear,
}

impl MultiheadAttention {
    /// Takes `NAME.in_proj_weight`, `NAME.in_proj_bias` and `NAME.out_proj`.
    pub(in crate::planner::learned) fn take(
        weights: &mut Weights,
        name: &str,
        width: usize,
        heads: usize,
    ) -> Result<Self> {
        let weight = weights.take(&format!("{name}.in_proj_weight"), &[3 * width, width])?;
        let bias = weights.take(&format!("{name}.in_proj_bias"), &[3 * width])?;
        let part = |i: usize| {
            Linear::of(&weight.narrow(0, i * width, width)?, Some(bias.narrow(0, i * width, width)?.contiguous()?))
        };
        let projections = [part(0)?, part(1)?, part(2)?];
        Ok(Self { heads, projections, output: Linear::take(weights, &format!("{name}.out_proj"), width, width)? })
    }

    /// Queries (B, Q, E), keys and values (B, K, E); `bias`, which has the shape (B, heads, Q, K) or can be broadcast to it, is
    /// added to the logits.
    pub(in crate::planner::learned) fn forward(
        &self,
        [query, key, value]: [&Tensor; 3],
        bias: Option<&Tensor>,
    ) -> Result<Tensor> {
        let (batch, queries, width) = query.dims3()?;
        let head = width / self.heads;
        let split = |x: &Tensor, layer: &Linear| -> Result<Tensor> {
            let rows = x.dim(1)?;
            layer.forward(x)?.reshape((batch, rows, self.heads, head))?.transpose(1, 2)?.contiguous()
        };
        let [q, k, v] = [(query, 0), (key, 1), (value, 2)].map(|(x, i)| split(x, &self.projections[i]));
        let logits = (q? * (1.0 / (head as f64).sqrt()))?.matmul(&k?.transpose(2, 3)?.contiguous()?)?;
        let logits = match bias {
            Some(bias) => logits.broadcast_add(bias)?,
            None => logits,
        };
        let mixed = softmax(&logits)?.matmul(&v?)?.transpose(1, 2)?.reshape((batch, queries, width))?;
        self.output.forward(&mixed)
    }
}

impl MultiheadAttention {
    /// The result where all keys are hidden: the output layer of zeros.
    pub(in crate::planner::learned) fn output_of(&self, nothing: &Tensor) -> Result<Tensor> {
        self.output.forward(&nothing.zeros_like()?)
    }
}

/// The bias (B, 1, 1, K) that hides the keys whose mask (B, K) is 0.
pub(in crate::planner::learned) fn key_bias(valid: &Tensor) -> Result<Tensor> {
    let (batch, keys) = valid.dims2()?;
    let hidden = Tensor::full(f32::NEG_INFINITY, (batch, keys), &Device::Cpu)?;
    valid.where_cond(&hidden.zeros_like()?, &hidden)?.reshape((batch, 1, 1, keys))
}
