//! The attention of a Llama layer: projections, norms of heads, causal attention.

use super::attention::CausalAttention;
use super::cache::{DecoderCache, LayerState};
use super::head_norms::HeadNorms;
use super::layer::Pass;
use super::mixer::Mixer;
use crate::MllmError;
use crate::checkpoint::{LlamaConfig, Weights};
use candle_core::Tensor;
use planagent_kernels::Linear;
use planagent_kernels::attention::Precision;

/// Causal attention with its projections. Those of queries, keys and values are one matrix. Qwen 3
/// normalizes the queries and keys of each head.
#[derive(Debug)]
pub(super) struct SelfAttention {
    qkv: Linear,
    head_norms: Option<HeadNorms>,
    attention: CausalAttention,
    out: Linear,
}

impl SelfAttention {
    /// Takes that of a layer, by its number from 0 and its name.
    pub(super) fn take(
        weights: &mut Weights,
        config: &LlamaConfig,
        layer: usize,
        name: &str,
    ) -> Result<Self, MllmError> {
        let queries = config.heads * config.head_dim;
        let keys = config.kv_heads * config.head_dim;
        let parts = [("q_proj", queries), ("k_proj", keys), ("v_proj", keys)]
            .map(|(part, width)| (format!("{name}.self_attn.{part}"), width));
        Ok(Self {
            qkv: weights.take_fused(&parts, config.hidden, config.attention_bias)?,
            head_norms: if config.head_norms {
                Some(HeadNorms::take(weights, config, name)?)
            } else {
                None
            },
            attention: CausalAttention::new(config, layer),
            out: config.without_norm_before(weights.take_linear(
                &format!("{name}.self_attn.o_proj"),
                queries,
                config.hidden,
                config.output_bias,
            )?),
        })
    }
}

impl Mixer for SelfAttention {
    fn new_state(&self, precision: Precision) -> LayerState {
        self.attention.new_state(precision)
    }

    fn exact_pass(&self) -> usize {
        self.attention.exact_pass()
    }

    fn mix(
        &self,
        x: &Tensor,
        pass: &Pass,
        cache: &mut DecoderCache,
    ) -> candle_core::Result<Tensor> {
        let qkv = self.qkv.forward(x)?;
        let qkv = match &self.head_norms {
            Some(norms) => norms.forward(&qkv)?,
            None => qkv,
        };
        self.attention.forward(&qkv, pass, cache)
    }

    fn out(&self) -> &Linear {
        &self.out
    }
}
