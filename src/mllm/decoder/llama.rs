//! The layer of Llama and Mistral.

use candle_core::Tensor;

use super::attention::CausalAttention;
use super::cache::KvCache;
use super::layer::{DecoderLayer, Pass, SwiGlu, rms_norm};
use crate::mllm::MllmError;
use crate::mllm::checkpoint::{LlamaConfig, Weights};
use crate::mllm::linear::Linear;
use crate::mllm::rms_norm::RmsNorm;

/// A Llama layer. Query, key and value projections are one matrix.
#[derive(Debug)]
pub(crate) struct LlamaLayer {
    input_norm: RmsNorm,
    qkv: Linear,
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
        let bias = config.attention_bias;
        Ok(Self {
            input_norm: rms_norm(weights, &format!("{name}.input_layernorm"), config)?,
            qkv: Linear::take_fused(weights, &parts, config.hidden, bias)?,
            attention: CausalAttention::new(config),
            out: Linear::take(weights, &format!("{name}.self_attn.o_proj"), queries, config.hidden, bias)?,
            post_norm: rms_norm(weights, &format!("{name}.post_attention_layernorm"), config)?,
            mlp: SwiGlu::take_mlp(weights, &format!("{name}.mlp"), config)?,
        })
    }

    fn forward(&self, x: &Tensor, pass: &Pass, cache: &mut KvCache) -> candle_core::Result<Tensor> {
        let qkv = self.qkv.forward(&self.input_norm.forward(x)?)?;
        let x = self.out.forward_onto(&self.attention.forward(&qkv, pass, cache)?, x)?;
        self.mlp.forward_onto(&self.post_norm.forward(&x)?, &x)
    }
}
