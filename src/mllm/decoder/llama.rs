//! The layer of Llama, Mistral, Qwen 2, 3 and 3.5, Gemma 3 and LFM2.

use super::cache::{DecoderCache, LayerState};
use super::layer::{DecoderLayer, Pass, SwiGlu, rms_norm};
use super::mixer::{self, Mixer};
use crate::MllmError;
use crate::checkpoint::{LlamaConfig, Weights};
use candle_core::Tensor;
use planagent_kernels::RmsNorm;
use planagent_kernels::attention::Precision;

/// A Llama layer: a part that mixes positions, and a feed-forward network, each added to the rows.
/// Gemma 3 also normalizes what they add.
#[derive(Debug)]
pub(crate) struct LlamaLayer {
    input_norm: RmsNorm,
    mixer: Box<dyn Mixer>,
    post_norm: RmsNorm,
    mlp: SwiGlu,
    /// Of the outputs of mixer and feed-forward network.
    output_norms: Option<[RmsNorm; 2]>,
}

impl DecoderLayer for LlamaLayer {
    fn take(
        weights: &mut Weights,
        config: &LlamaConfig,
        layer: usize,
        name: &str,
    ) -> Result<Self, MllmError> {
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
            mixer: mixer::take(weights, config, layer, name)?,
            post_norm: rms_norm(weights, &format!("{name}.{before_mlp}"), config)?,
            mlp: SwiGlu::take_mlp(weights, &format!("{name}.mlp"), config)?,
            output_norms,
        })
    }

    fn exact_pass(&self) -> usize {
        self.mixer.exact_pass()
    }

    fn new_state(&self, precision: Precision) -> LayerState {
        self.mixer.new_state(precision)
    }

    fn forward(
        &self,
        x: &Tensor,
        pass: &Pass,
        cache: &mut DecoderCache,
    ) -> candle_core::Result<Tensor> {
        let mixed = self.mixer.mix(&self.input_norm.forward(x)?, pass, cache)?;
        let out = self.mixer.out();
        let Some([of_mixer, of_mlp]) = &self.output_norms else {
            let x = out.forward_onto(&mixed, x)?;
            return self.mlp.forward_onto(&self.post_norm.forward(&x)?, &x);
        };
        let x = (x + of_mixer.forward(&out.forward(&mixed)?)?)?;
        let added = self.mlp.forward(&self.post_norm.forward(&x)?)?;
        &x + of_mlp.forward(&added)?
    }
}
