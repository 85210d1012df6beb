//! Grouped-query attention over the cache.

use candle_core::{Device, Tensor};

use super::cache::KvCache;
use super::layer::Pass;
use crate::mllm::checkpoint::LlamaConfig;

/// Query rows whose scores are computed at once: bounds the score matrix for long prompts.
const QUERY_BLOCK: usize = 256;

/// Causal attention of one layer, between its projections: it has no weights of its own.
#[derive(Debug, Clone, Copy)]
pub(crate) struct CausalAttention {
    heads: usize,
    kv_heads: usize,
    head_dim: usize,
    window: Option<usize>,
}

impl CausalAttention {
    /// The attention of a decoder's layers.
    pub(crate) fn new(config: &LlamaConfig) -> Self {
        Self { heads: config.heads, kv_heads: config.kv_heads, head_dim: config.head_dim, window: config.window }
    }

    /// Attends from rows that follow what the cache holds to all positions up to their own. `qkv` are their queries, keys
    /// and values side by side, (tokens, (heads + 2 · key heads) · head width); the result is (tokens, heads · head width).
    pub(crate) fn forward(&self, qkv: &Tensor, pass: &Pass, cache: &mut KvCache) -> candle_core::Result<Tensor> {
        let tokens = qkv.dim(0)?;
        let start = cache.len();
        let qkv = qkv.reshape((1, tokens, self.heads + 2 * self.kv_heads, self.head_dim))?;
        let queries = qkv.narrow(2, 0, self.heads)?.contiguous()?;
        let keys = qkv.narrow(2, self.heads, self.kv_heads)?.contiguous()?;
        let values = qkv.narrow(2, self.heads + self.kv_heads, self.kv_heads)?.contiguous()?;
        let queries = pass.rotary.rotate(&queries)?;
        let keys = pass.rotary.rotate(&keys)?;
        let (keys, values) = cache.write(pass.layer, &keys, &values)?;
        let mixed = self.attend(&queries, &keys, &values, start)?;
        mixed.reshape((tokens, self.heads * self.head_dim))
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
            if rows > 1 || self.window.is_some_and(|window| window < seen) {
                let mask = causal_mask(rows, seen, self.window)?;
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

/// Minus infinity where a row would look ahead, or back beyond the window: the last `rows` of `seen` positions are the
/// rows' own.
fn causal_mask(rows: usize, seen: usize, window: Option<usize>) -> candle_core::Result<Tensor> {
    let before = seen - rows;
    let mut mask = vec![0f32; rows * seen];
    for (row, columns) in mask.chunks_exact_mut(seen).enumerate() {
        let own = before + row;
        columns[own + 1..].fill(f32::NEG_INFINITY);
        if let Some(window) = window {
            columns[..(own + 1).saturating_sub(window)].fill(f32::NEG_INFINITY);
        }
    }
    Tensor::from_vec(mask, (rows, seen), &Device::Cpu)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_sees_its_window_and_nothing_ahead() {
        let open = |rows, seen, window| -> Vec<Vec<u8>> {
            let mask = causal_mask(rows, seen, window).unwrap().to_vec2::<f32>().unwrap();
            mask.iter().map(|row| row.iter().map(|value| u8::from(*value == 0.0)).collect()).collect()
        };
        assert_eq!(open(2, 4, None), [[1, 1, 1, 0], [1, 1, 1, 1]]);
        assert_eq!(open(2, 4, Some(2)), [[0, 1, 1, 0], [0, 0, 1, 1]]);
        assert_eq!(open(1, 3, Some(9)), [[1, 1, 1]]);
    }
}
