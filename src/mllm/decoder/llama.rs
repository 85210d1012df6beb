//! The layer of Llama, Mistral, Qwen 2, Qwen 3 and Gemma 3.

use super::attention::CausalAttention;
use super::cache::{DecoderCache, LayerState};
use super::head_norms::HeadNorms;
use super::layer::{DecoderLayer, Pass, SwiGlu, rms_norm};
use crate::MllmError;
use crate::checkpoint::{LlamaConfig, Weights};
use candle_core::Tensor;
use planagent_kernels::Linear;
use planagent_kernels::RmsNorm;
use planagent_kernels::attention::Precision;

/// A Llama layer. Query, key and value projections are one matrix. Qwen 3 normalizes the queries
/// and keys of each head, and Gemma 3 also what attention and feed-forward network add.
#[derive(Debug)]
pub(crate) struct LlamaLayer {
    input_norm: RmsNorm,
    qkv: Linear,
    head_norms: Option<HeadNorms>,
    attention: CausalAttention,
    out: Linear,
    post_norm: RmsNorm,
    mlp: SwiGlu,
    /// Of the outputs of attention and feed-forward network.
    output_norms: Option<[RmsNorm; 2]>,
}

impl DecoderLayer for LlamaLayer {
    fn take(
        weights: &mut Weights,
        config: &LlamaConfig,
        layer: usize,
        name: &str,
    ) -> Result<Self, MllmError> {
        let queries = config.heads * config.head_dim;
        let keys = config.kv_heads * config.head_dim;
        let parts = [("q_proj", queries), ("k_proj", keys), ("v_proj", keys)]
            .map(|(part, width)| (format!("{name}.self_attn.{part}"), width));
        // Where what attention adds has a norm, that has the name of Llama's second one.
        let before_mlp = if config.gemma.is_some() {
            "pre_feedforward_layernorm"
        } else {
            "post_attention_layernorm"
        };
        let output_norms = if config.gemma.is_some() {
            let mut norm = |part: &str| rms_norm(weights, &format!("{name}.{part}"), config);
            Some([
                norm("post_attention_layernorm")?,
                norm("post_feedforward_layernorm")?,
            ])
        } else {
            None
        };
        Ok(Self {
            input_norm: rms_norm(weights, &format!("{name}.input_layernorm"), config)?,
            qkv: weights.take_fused(&parts, config.hidden, config.attention_bias)?,
            head_norms: if config.head_norms {
                Some(HeadNorms::take(weights, config, name)?)
            } else {
                None
            },
            attention: CausalAttention::new(config, layer),
            out: weights.take_linear(
                &format!("{name}.self_attn.o_proj"),
                queries,
                config.hidden,
                config.output_bias,
            )?,
            post_norm: rms_norm(weights, &format!("{name}.{before_mlp}"), config)?,
            mlp: SwiGlu::take_mlp(weights, &format!("{name}.mlp"), config)?,
            output_norms,
        })
    }

    fn exact_pass(&self) -> usize {
        self.attention.exact_pass()
    }

    fn new_state(&self, precision: Precision) -> LayerState {
        self.attention.new_state(precision)
    }

    fn forward(
        &self,
        x: &Tensor,
        pass: &Pass,
        cache: &mut DecoderCache,
    ) -> candle_core::Result<Tensor> {
        let qkv = self.qkv.forward(&self.input_norm.forward(x)?)?;
        let qkv = match &self.head_norms {
            Some(norms) => norms.forward(&qkv)?,
            None => qkv,
        };
        let mixed = self.attention.forward(&qkv, pass, cache)?;
        let Some([of_attention, of_mlp]) = &self.output_norms else {
            let x = self.out.forward_onto(&mixed, x)?;
            return self.mlp.forward_onto(&self.post_norm.forward(&x)?, &x);
        };
        let x = (x + of_attention.forward(&self.out.forward(&mixed)?)?)?;
        let added = self.mlp.forward(&self.post_norm.forward(&x)?)?;
        &x + of_mlp.forward(&added)?
    }
}
