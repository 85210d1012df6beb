//! Normalization of each head's queries, keys and values.

use super::layer::scaled_norm;
use crate::MllmError;
use crate::checkpoint::{LayerKeys, LayerShape, LlamaConfig, Weights};
use candle_core::Tensor;
use planagent_kernels::RmsNorm;

/// RMS norms of the queries and keys of a layer, before their rotation (`q_norm`, `k_norm`), and in
/// some families of its values, without a weight.
#[derive(Debug)]
pub(super) struct HeadNorms {
    query: RmsNorm,
    /// None in a layer that uses the keys of an earlier one.
    key: Option<RmsNorm>,
    value: Option<RmsNorm>,
    /// Whether the projected keys are the values too.
    keys_as_values: bool,
    /// Numbers of a token's queries, and of its keys.
    widths: [usize; 2],
}

impl HeadNorms {
    /// Takes the norms of the layer called `name`.
    pub(super) fn take(
        weights: &mut Weights,
        config: &LlamaConfig,
        shape: LayerShape,
        name: &str,
    ) -> Result<Self, MllmError> {
        let width = shape.head_dim;
        let mut norm = |part: &str, scale| {
            let name = format!("{name}.self_attn.{part}");
            scaled_norm(weights, &name, width, config, scale)
        };
        // The attention divides by the root of the head's width.
        let query_scale = config.gemma.as_ref().map_or(1.0, |gemma| {
            (width as f64 / gemma.query_scalar).sqrt() as f32
        });
        let has_keys = !matches!(shape.keys, LayerKeys::Of(_));
        Ok(Self {
            query: norm("q_norm", query_scale)?,
            key: has_keys.then(|| norm("k_norm", 1.0)).transpose()?,
            value: (config.value_norms && has_keys)
                .then(|| RmsNorm::new(vec![1.0; width], config.rms_norm_eps)),
            keys_as_values: shape.keys == LayerKeys::AsValues,
            widths: [config.heads, shape.kv_heads].map(|heads| heads * width),
        })
    }

    /// Normalizes rows of queries, keys and values; what a row lacks is not there in the result,
    /// but for values that are keys.
    pub(super) fn forward(&self, qkv: &Tensor) -> candle_core::Result<Tensor> {
        let rows = qkv.dim(0)?;
        let [queries, keys] = self.widths;
        let normed = |norm: &RmsNorm, start, width| {
            let heads = qkv.narrow(1, start, width)?.reshape(((), norm.width()))?;
            norm.forward(&heads)?.reshape((rows, width))
        };
        let query = normed(&self.query, 0, queries)?;
        let Some(key) = &self.key else {
            return Ok(query);
        };
        let values = if self.keys_as_values {
            queries
        } else {
            queries + keys
        };
        let value = match &self.value {
            Some(norm) => normed(norm, values, keys)?,
            None => qkv.narrow(1, values, keys)?,
        };
        Tensor::cat(&[query, normed(key, queries, keys)?, value], 1)?.contiguous()
    }
}
