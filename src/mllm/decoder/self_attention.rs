//! The attention of a Llama layer: projections, norms of heads, causal attention.

use super::attention::CausalAttention;
use super::cache::{DecoderCache, LayerState};
use super::head_norms::HeadNorms;
use super::layer::Pass;
use super::mixer::Mixer;
use super::output_gate::OutputGate;
use crate::MllmError;
use crate::checkpoint::{LayerKeys, LlamaConfig, Weights};
use candle_core::Tensor;
use planagent_kernels::Linear;
use planagent_kernels::attention::Precision;
use planagent_kernels::pointwise::sigmoid_gated;

/// Causal attention with its projections. Those of queries, keys and values are one matrix. Qwen 3
/// normalizes the queries and keys of each head, and Qwen 3.5 gates what the heads give. In Gemma 4,
/// some layers have no projection to values, or none to keys either.
#[derive(Debug)]
pub(super) struct SelfAttention {
    qkv: Linear,
    /// Of what the heads give, by gates beside the queries.
    gate: Option<OutputGate>,
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
        let shape = config.shape(layer);
        let queries = config.heads * shape.head_dim;
        let keys = shape.kv_heads * shape.head_dim;
        let gate = config.output_gate.then(|| OutputGate::new(config));
        let rows = queries + gate.as_ref().map_or(0, OutputGate::width);
        // A layer that lacks projections lacks the last ones.
        let all = [("q_proj", rows), ("k_proj", keys), ("v_proj", keys)];
        let projected = match shape.keys {
            LayerKeys::Projected => 3,
            LayerKeys::AsValues => 2,
            LayerKeys::Of(_) => 1,
        };
        let parts: Vec<(String, usize)> = all
            .into_iter()
            .take(projected)
            .map(|(part, width)| (format!("{name}.self_attn.{part}"), width))
            .collect();
        Ok(Self {
            qkv: weights.take_fused(&parts, config.hidden, config.attention_bias)?,
            gate,
            head_norms: if config.head_norms {
                Some(HeadNorms::take(weights, config, shape, name)?)
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
        let mut qkv = self.qkv.forward(x)?;
        let mut gates = None;
        if let Some(gate) = &self.gate {
            let parts = gate.split(&qkv)?;
            (qkv, gates) = (parts.0, Some(parts.1));
        }
        if let Some(norms) = &self.head_norms {
            qkv = norms.forward(&qkv)?;
        }
        let mixed = self.attention.forward(&qkv, pass, cache)?;
        match gates {
            Some(gates) => sigmoid_gated(&Tensor::cat(&[gates, mixed], 1)?),
            None => Ok(mixed),
        }
    }

    fn out(&self) -> &Linear {
        &self.out
    }
}
