//! The layer of Llama, Mistral, Qwen 2 and Qwen 3.

use super::attention::CausalAttention;
use super::cache::KvCache;
use super::head_norms::HeadNorms;
use super::layer::{DecoderLayer, Pass, SwiGlu, rms_norm};
use crate::MllmError;
use crate::checkpoint::{LlamaConfig, Weights};
use candle_core::Tensor;
use planagent_kernels::Linear;
use planagent_kernels::RmsNorm;

/// A Llama layer. Query, key and value projections are one matrix. Qwen 3 normalizes the queries
/// and keys of each head.
#[derive(Debug)]
pub(crate) struct LlamaLayer {
    input_norm: RmsNorm,
    qkv: Linear,
    head_norms: Option<HeadNorms>,
    attention: CausalAttention,
    out: Linear,
    post_norm: RmsNorm,
    mlp: SwiGlu,
}

impl DecoderLayer for LlamaLayer {
    fn take(weights: &mut Weights, config: &LlamaConfig, name: &str) -> Result<Self, MllmError> {
        let queries = config.heads * config.head_dim;
        let keys = config.kv_heads * config.head_dim;
        let parts = [("q_proj", queries), ("k_proj", keys), ("v_proj", keys)]
            .map(|(part, width)| (format!("{name}.self_attn.{part}"), width));
        Ok(Self {
            input_norm: rms_norm(weights, &format!("{name}.input_layernorm"), config)?,
            qkv: weights.take_fused(&parts, config.hidden, config.attention_bias)?,
            head_norms: if config.head_norms {
                Some(HeadNorms::take(weights, config, name)?)
            } else {
                None
            },
            attention: CausalAttention::new(config),
            out: weights.take_linear(
                &format!("{name}.self_attn.o_proj"),
                queries,
                config.hidden,
                config.output_bias,
            )?,
            post_norm: rms_norm(weights, &format!("{name}.post_attention_layernorm"), config)?,
            mlp: SwiGlu::take_mlp(weights, &format!("{name}.mlp"), config)?,
        })
    }

    fn exact_pass(&self) -> usize {
        self.attention.exact_pass()
    }

    fn forward(&self, x: &Tensor, pass: &Pass, cache: &mut KvCache) -> candle_core::Result<Tensor> {
        let qkv = self.qkv.forward(&self.input_norm.forward(x)?)?;
        let qkv = match &self.head_norms {
            Some(norms) => norms.forward(&qkv)?,
            None => qkv,
        };
        let x = self
            .out
            .forward_onto(&self.attention.forward(&qkv, pass, cache)?, x)?;
        self.mlp.forward_onto(&self.post_norm.forward(&x)?, &x)
    }
}
