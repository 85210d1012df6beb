//! PyTorch's `MultiheadAttention`, batch first.

use super::{Linear, PackedKeyValues, Weights};
use candle_core::{Device, Result, Tensor};

/// Attention of several heads with projections of queries, keys, values and the result.
#[derive(Debug, Clone)]
pub(crate) struct MultiheadAttention {
    heads: usize,
    projections: [Linear; 3],
    output: Linear,
}

impl MultiheadAttention {
    /// Takes `NAME.in_proj_weight`, `NAME.in_proj_bias` and `NAME.out_proj`.
    pub(crate) fn take(
        weights: &mut Weights,
        name: &str,
        width: usize,
        heads: usize,
    ) -> Result<Self> {
        let weight = weights.take(&format!("{name}.in_proj_weight"), &[3 * width, width])?;
        let bias = weights.take(&format!("{name}.in_proj_bias"), &[3 * width])?;
        let part = |i: usize| {
            Linear::from_tensors(
                &weight.narrow(0, i * width, width)?,
                Some(bias.narrow(0, i * width, width)?.contiguous()?),
            )
        };
        let projections = [part(0)?, part(1)?, part(2)?];
        Ok(Self {
            heads,
            projections,
            output: weights.linear(&format!("{name}.out_proj"), width, width)?,
        })
    }

    /// Queries (B, Q, E), keys and values (B, K, E); `bias`, which has the shape (B, heads, Q, K)
    /// or ones in the place of the first three, is added to the logits.
    pub(crate) fn forward(
        &self,
        [query, key, value]: [&Tensor; 3],
        bias: Option<&Tensor>,
    ) -> Result<Tensor> {
        self.attended(query, &self.memory(key, value)?, bias)
    }

    /// Keys and values (B, K, E) that several queries may attend to.
    pub(crate) fn memory(&self, key: &Tensor, value: &Tensor) -> Result<PackedKeyValues> {
        PackedKeyValues::pack(
            &self.projected(1, key)?,
            &self.projected(2, value)?,
            self.heads,
        )
    }

    /// As [`Self::forward`], of queries that attend to a memory.
    pub(crate) fn attended(
        &self,
        query: &Tensor,
        memory: &PackedKeyValues,
        bias: Option<&Tensor>,
    ) -> Result<Tensor> {
        self.output(&memory.attend(&self.projected(0, query)?, bias)?)
    }

    /// Rows (…, E) as queries (0), keys (1) or values (2) of all heads.
    pub(crate) fn projected(&self, part: usize, x: &Tensor) -> Result<Tensor> {
        self.projections[part].forward(x)
    }

    /// The output projection of the heads' weighted values (…, E), which are zeros where all keys
    /// are hidden.
    pub(crate) fn output(&self, weighted_values: &Tensor) -> Result<Tensor> {
        self.output.forward(weighted_values)
    }
}

/// The bias (B, 1, 1, K) that hides the keys whose mask (B, K) is 0.
pub(crate) fn key_bias(valid: &Tensor) -> Result<Tensor> {
    let (batch, keys) = valid.dims2()?;
    let hidden = Tensor::full(f32::NEG_INFINITY, (batch, keys), &Device::Cpu)?;
    valid
        .where_cond(&hidden.zeros_like()?, &hidden)?
        .reshape((batch, 1, 1, keys))
}
