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
        self.hear(query, &self.memory(key, value)?, bias)
    }

    /// Keys and values (B, K, E) that several queries may hear.
    pub(in crate::planner::learned) fn memory(&self, key: &Tensor, value: &Tensor) -> Result<Memory> {
        let keys = self.heads_of(key, 1)?.transpose(2, 3)?.contiguous()?;
        Ok(Memory { keys, values: self.heads_of(value, 2)?.contiguous()? })
    }

    /// As [`Self::forward`], of queries that hear a memory.
    pub(in crate::planner::learned) fn hear(
        &self,
        query: &Tensor,
        memory: &Memory,
        bias: Option<&Tensor>,
    ) -> Result<Tensor> {
        let (batch, queries, width) = query.dims3()?;
        let scale = 1.0 / ((width / self.heads) as f64).sqrt();
        let logits = (self.heads_of(query, 0)? * scale)?.contiguous()?.matmul(&memory.keys)?;
        let logits = match bias {
            Some(bias) => logits.broadcast_add(bias)?,
            None => logits,
        };
        let mixed = softmax(&logits)?.matmul(&memory.values)?.transpose(1, 2)?.reshape((batch, queries, width))?;
        self.output.forward(&mixed)
    }

    /// A projection of rows (B, rows, E), split into heads (B, heads, rows, E / heads).
    fn heads_of(&self, x: &Tensor, projection: usize) -> Result<Tensor> {
        let (batch, rows, width) = x.dims3()?;
        let projected = self.projections[projection].forward(x)?;
        projected.reshape((batch, rows, self.heads, width / self.heads))?.transpose(1, 2)
    }
}

/// Projected keys (B, heads, E / heads, K) and values (B, heads, K, E / heads).
#[derive(Debug)]
pub(in crate::planner::learned) struct Memory {
    keys: Tensor,
    values: Tensor,
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
