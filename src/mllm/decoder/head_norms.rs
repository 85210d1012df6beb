//! Normalization of each head's queries and keys.

use super::layer::scaled_norm;
use crate::MllmError;
use crate::checkpoint::{LlamaConfig, Weights};
use candle_core::Tensor;
use planagent_kernels::RmsNorm;

/// RMS norms of the queries and keys of a layer, before their rotation (`q_norm`, `k_norm`).
#[derive(Debug)]
pub(super) struct HeadNorms {
    query: RmsNorm,
    key: RmsNorm,
    /// Numbers of a token's queries, and of its keys.
    widths: [usize; 2],
}

impl HeadNorms {
    /// Takes the norms of the layer called `name`.
    pub(super) fn take(
        weights: &mut Weights,
        config: &LlamaConfig,
        name: &str,
    ) -> Result<Self, MllmError> {
        let mut norm = |part: &str, scale| {
            let name = format!("{name}.self_attn.{part}");
            scaled_norm(weights, &name, config.head_dim, config, scale)
        };
        // The attention divides by the root of the head's width.
        let query_scale = config.gemma.as_ref().map_or(1.0, |gemma| {
            (config.head_dim as f64 / gemma.query_scalar).sqrt() as f32
        });
        let widths = [config.heads, config.kv_heads].map(|heads| heads * config.head_dim);
        Ok(Self {
            query: norm("q_norm", query_scale)?,
            key: norm("k_norm", 1.0)?,
            widths,
        })
    }

    /// Normalizes queries and keys in rows of queries, keys and values.
    pub(super) fn forward(&self, qkv: &Tensor) -> candle_core::Result<Tensor> {
        let rows = qkv.dim(0)?;
        let [queries, keys] = self.widths;
        let normed = |norm: &RmsNorm, start, width| {
            let heads = qkv.narrow(1, start, width)?.reshape(((), norm.width()))?;
            norm.forward(&heads)?.reshape((rows, width))
        };
        let values = qkv.narrow(1, queries + keys, keys)?;
        Tensor::cat(
            &[
                normed(&self.query, 0, queries)?,
                normed(&self.key, queries, keys)?,
                values,
            ],
            1,
        )?
        .contiguous()
    }
}
