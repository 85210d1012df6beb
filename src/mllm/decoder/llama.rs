//! The layer of Llama, Mistral, Qwen 2, 3 and 3.5, Gemma 3 and 4 and LFM2.

use super::cache::{DecoderCache, LayerState};
use super::layer::{DecoderLayer, Pass, SwiGlu, rms_norm};
use super::layer_input::LayerInput;
use super::mixer::{self, Mixer};
use crate::MllmError;
use crate::checkpoint::{LlamaConfig, Weights};
use candle_core::Tensor;
use planagent_kernels::RmsNorm;
use planagent_kernels::attention::Precision;

/// A Llama layer: a part that mixes positions, and a feed-forward network, each added to the rows.
/// Gemma 3 also normalizes what they add, and Gemma 4 adds a part that reads the token once more.
#[derive(Debug)]
pub(crate) struct LlamaLayer {
    input_norm: RmsNorm,
    mixer: Box<dyn Mixer>,
    post_norm: RmsNorm,
    mlp: SwiGlu,
    /// Of the outputs of mixer and feed-forward network.
    output_norms: Option<[RmsNorm; 2]>,
    /// What is added of an input of its own.
    input: Option<LayerInput>,
    /// Factor of its result.
    scale: Option<f64>,
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
            mlp: SwiGlu::take_mlp(
                weights,
                &format!("{name}.mlp"),
                config,
                config.shape(layer).intermediate,
            )?,
            output_norms,
            input: LayerInput::take(weights, config, layer, name)?,
            scale: if config.layer_scales {
                layer_scale(weights, name)?
            } else {
                None
            },
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
        let mut x = (&x + of_mlp.forward(&added)?)?;
        if let Some(input) = &self.input {
            x = input.forward_onto(&x, pass)?;
        }
        match self.scale {
            Some(scale) => x * scale,
            None => Ok(x),
        }
    }
}

/// The factor of the result of the layer called `name`; none where the files have none, as in
/// transformers and llama.cpp.
fn layer_scale(weights: &mut Weights, name: &str) -> Result<Option<f64>, MllmError> {
    let name = format!("{name}.layer_scalar.weight");
    if weights.lacks(&name) {
        weights.note(format!("the files have no {name}: 1 is taken"));
        return Ok(None);
    }
    let scale = weights.take(&name, &[1])?.to_vec1::<f32>()?;
    Ok(scale.first().map(|scale| f64::from(*scale)))
}
