//! The layer of Gemma 3n: it works on one of several streams of hidden states.

use super::cache::{DecoderCache, LayerState};
use super::layer::{DecoderLayer, Pass, SwiGlu, rms_norm};
use super::layer_input::LayerInput;
use super::mixer::{self, Mixer};
use super::streams::StreamUpdate;
use crate::MllmError;
use crate::checkpoint::{LlamaConfig, Weights};
use candle_core::Tensor;
use planagent_kernels::attention::Precision;
use planagent_kernels::{Linear, RmsNorm};
use std::f64::consts::FRAC_1_SQRT_2;

/// A layer that works on one stream of rows (tokens, streams · hidden) as a Gemma does, with a
/// low-rank part beside attention. The other streams are predicted, corrected by what it made, and
/// read the layer's own input.
#[derive(Debug)]
pub(crate) struct StreamLayer {
    update: StreamUpdate,
    input_norm: RmsNorm,
    mixer: Box<dyn Mixer>,
    mixer_norm: RmsNorm,
    low_rank: LowRank,
    mlp_input_norm: RmsNorm,
    mlp: SwiGlu,
    mlp_norm: RmsNorm,
    input: Option<LayerInput>,
    /// Factors of the active stream where it reads the input; none where they are 1.
    input_scale: Option<Tensor>,
}

impl DecoderLayer for StreamLayer {
    fn take(
        weights: &mut Weights,
        config: &LlamaConfig,
        layer: usize,
        name: &str,
    ) -> Result<Self, MllmError> {
        let streams = config.streams.as_ref();
        let cutoff = streams.and_then(|streams| *streams.cutoffs.get(layer)?);
        let width = config.shape(layer).intermediate;
        let mlp = SwiGlu::take_mlp(weights, &format!("{name}.mlp"), config, width)?;
        let mixer = mixer::take(weights, config, layer, name)?;
        let mut norm = |part: &str| rms_norm(weights, &format!("{name}.{part}"), config);
        Ok(Self {
            input_norm: norm("input_layernorm")?,
            mixer_norm: norm("post_attention_layernorm")?,
            mlp_input_norm: norm("pre_feedforward_layernorm")?,
            mlp_norm: norm("post_feedforward_layernorm")?,
            mlp: mlp.with_cutoff(cutoff.map(|cutoff| cutoff as f32)),
            mixer,
            update: StreamUpdate::take(weights, config, &format!("{name}.altup"))?,
            low_rank: LowRank::take(weights, config, &format!("{name}.laurel"))?,
            input: LayerInput::take(weights, config, layer, name)?,
            input_scale: input_scale(weights, config, name)?,
        })
    }

    fn new_state(&self, precision: Precision) -> LayerState {
        self.mixer.new_state(precision)
    }

    fn exact_pass(&self) -> usize {
        self.mixer.exact_pass()
    }

    fn forward(
        &self,
        x: &Tensor,
        pass: &Pass,
        cache: &mut DecoderCache,
    ) -> candle_core::Result<Tensor> {
        let predicted = self.update.predict(x)?;
        let active = self.update.active(&predicted)?;
        let normed = self.input_norm.forward(&active)?;
        let mixed = self.mixer.mix(&normed, pass, cache)?;
        let mixed = self
            .mixer_norm
            .forward(&self.mixer.out().forward(&mixed)?)?;
        let both = ((active + mixed)? + self.low_rank.forward(&normed)?)?;
        let x = (both * FRAC_1_SQRT_2)?;
        let added = self.mlp.forward(&self.mlp_input_norm.forward(&x)?)?;
        let made = (&x + self.mlp_norm.forward(&added)?)?;
        let corrected = self.update.correct(&predicted, &made)?;
        let Some(input) = &self.input else {
            return Ok(corrected);
        };
        let reading = self.update.active(&corrected)?;
        let reading = match &self.input_scale {
            Some(scale) => reading.broadcast_mul(scale)?,
            None => reading,
        };
        self.update
            .add_to_others(&corrected, &input.forward(&reading, pass)?)
    }
}

/// The factors of the active stream of the layer called `name` where it reads the layer's own input;
/// none where the configuration says that there are none.
fn input_scale(
    weights: &mut Weights,
    config: &LlamaConfig,
    name: &str,
) -> Result<Option<Tensor>, MllmError> {
    let streams = config.streams.as_ref();
    if !streams.is_some_and(|streams| streams.scaled) {
        return Ok(None);
    }
    let name = format!("{name}.altup.correct_output_scale.weight");
    Ok(Some(weights.take(&name, &[config.hidden])?))
}

/// A part beside attention: x and the normalized product with a matrix of low rank (Learned
/// Augmented Residual Layer: Menghani et al., `arXiv:2411.07501`).
#[derive(Debug)]
struct LowRank {
    left: Linear,
    right: Linear,
    norm: RmsNorm,
}

impl LowRank {
    /// Takes that of a layer, by its name.
    fn take(weights: &mut Weights, config: &LlamaConfig, name: &str) -> Result<Self, MllmError> {
        let rank = config.streams.as_ref().map_or(1, |streams| streams.rank);
        let hidden = config.hidden;
        let right = weights.take_linear(&format!("{name}.linear_right"), rank, hidden, false)?;
        Ok(Self {
            left: weights.take_linear(&format!("{name}.linear_left"), hidden, rank, false)?,
            right: config.without_norm_before(right),
            norm: rms_norm(weights, &format!("{name}.post_laurel_norm"), config)?,
        })
    }

    fn forward(&self, x: &Tensor) -> candle_core::Result<Tensor> {
        let product = self.right.forward(&self.left.forward(x)?)?;
        x + self.norm.forward(&product)?
    }
}
