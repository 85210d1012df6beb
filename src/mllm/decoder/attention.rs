//! Grouped-query attention over the cache.

use candle_core::{Device, Tensor};

use super::cache::KvCache;
use super::rotary::RotaryTable;
use crate::mllm::MllmError;
use crate::mllm::checkpoint::{LlamaConfig, Weights};
use crate::mllm::linear::Linear;

/// Query rows whose scores are computed at once: bounds the score matrix for long prompts.
const QUERY_BLOCK: usize = 256;

/// The attention of one layer; query, key and value projections are one matrix.
#[derive(Debug)]
pub(super) struct Attention {
    qkv: Linear,
    out: Linear,
    heads: usize,
    kv_heads: usize,
    head_dim: usize,
}

impl Attention {
    /// Takes the weights of the attention called `name`.
    ///
    /// # Errors
    /// When a tensor is missing or misshapen.
    pub(super) fn take(weights: &mut Weights, config: &LlamaConfig, name: &str) -> Result<Self, MllmError> {
        let queries = config.heads * config.head_dim;
        let keys = config.kv_heads * config.head_dim;
        let parts =
            [(format!("{name}.q_proj"), queries), (format!("{name}.k_proj"), keys), (format!("{name}.v_proj"), keys)];
        let bias = config.attention_bias;
        Ok(Self {
            qkv: Linear::take_fused(weights, &parts, config.hidden, bias)?,
            out: Linear::take(weights, &format!("{name}.o_proj"), queries, config.hidden, bias)?,
            heads: config.heads,
            kv_heads: config.kv_heads,
            head_dim: config.head_dim,
        })
    }

    /// Attends from rows (tokens, hidden) that follow what the cache holds to all positions up to their own.
    pub(super) fn forward(
        &self,
        x: &Tensor,
        layer: usize,
        rotary: &RotaryTable,
        cache: &mut KvCache,
    ) -> candle_core::Result<Tensor> {
        let tokens = x.dim(0)?;
        let start = cache.len();
        let qkv = self.qkv.forward(x)?.reshape((1, tokens, self.heads + 2 * self.kv_heads, self.head_dim))?;
        let queries = qkv.narrow(2, 0, self.heads)?.contiguous()?;
        let keys = qkv.narrow(2, self.heads, self.kv_heads)?.contiguous()?;
        let values = qkv.narrow(2, self.heads + self.kv_heads, self.kv_heads)?.contiguous()?;
        let queries = rotary.rotate(&queries, start)?;
        let keys = rotary.rotate(&keys, start)?;
        let (keys, values) = cache.write(layer, &keys, &values)?;
        let mixed = self.attend(&queries, &keys, &values, start)?;
        self.out.forward(&mixed.reshape((tokens, self.heads * self.head_dim))?)
    }

    /// Attention of queries (1, tokens, heads, width) as matrix products, a block of queries at a time. The query heads
    /// that share a key head are stacked as rows, so keys and values are never repeated.
    ///
    /// candle-nn's `flash_attn` is not used: its kernels run on a pool of spinning threads, which costs a decoding step of
    /// a small model twenty times its own time as soon as another process wants a core.
    fn attend(&self, queries: &Tensor, keys: &Tensor, values: &Tensor, start: usize) -> candle_core::Result<Tensor> {
        let tokens = queries.dim(1)?;
        let scale = 1.0 / (self.head_dim as f64).sqrt();
        // (heads, tokens, width), (key heads, positions, width)
        let queries = (queries.squeeze(0)?.transpose(0, 1)?.contiguous()? * scale)?;
        let keys = keys.squeeze(0)?.transpose(0, 1)?;
        let values = values.squeeze(0)?.transpose(0, 1)?;
        let mut blocks = Vec::with_capacity(tokens.div_ceil(QUERY_BLOCK));
        for first in (0..tokens).step_by(QUERY_BLOCK) {
            let rows = QUERY_BLOCK.min(tokens - first);
            let seen = start + first + rows;
            let stacked = (self.kv_heads, self.heads / self.kv_heads * rows, self.head_dim);
            let block = queries.narrow(1, first, rows)?.reshape(stacked)?;
            let mut scores = block.matmul(&keys.narrow(1, 0, seen)?.t()?)?;
            if rows > 1 {
                let mask = causal_mask(rows, seen)?;
                scores = scores.reshape((self.heads, rows, seen))?.broadcast_add(&mask)?;
            }
            let weights = candle_nn::ops::softmax_last_dim(&scores)?;
            let mixed = weights.reshape((self.kv_heads, stacked.1, seen))?.matmul(&values.narrow(1, 0, seen)?)?;
            blocks.push(mixed.reshape((self.heads, rows, self.head_dim))?.transpose(0, 1)?);
        }
        if let [block] = blocks.as_slice() {
            return block.contiguous();
        }
        Tensor::cat(&blocks, 0)
    }
}

/// Minus infinity where a row would look ahead: the last `rows` of `seen` positions are the rows' own.
fn causal_mask(rows: usize, seen: usize) -> candle_core::Result<Tensor> {
    let before = seen - rows;
    let mut mask = vec![0f32; rows * seen];
    for (row, columns) in mask.chunks_exact_mut(seen).enumerate() {
        columns[before + row + 1..].fill(f32::NEG_INFINITY);
    }
    Tensor::from_vec(mask, (rows, seen), &Device::Cpu)
}
