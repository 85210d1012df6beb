//! Shared parts of decoder layers.

use super::cache::{DecoderCache, LayerState};
use crate::MllmError;
use crate::checkpoint::{LlamaConfig, Weights};
use candle_core::Tensor;
use planagent_kernels::Activation;
use planagent_kernels::Linear;
use planagent_kernels::RmsNorm;
use planagent_kernels::above_cutoff;
use planagent_kernels::attention::{Precision, RotaryRows};
use std::ops::Range;

pub(crate) trait DecoderLayer: Sized {
    /// Takes the weights of a layer, by its number from 0 and its name.
    fn take(
        weights: &mut Weights,
        config: &LlamaConfig,
        layer: usize,
        name: &str,
    ) -> Result<Self, MllmError>;

    /// What it keeps of a sequence that is empty; keys and values have this precision.
    fn new_state(&self, precision: Precision) -> LayerState;

    /// Maps (tokens, hidden) to the same shape and writes what it keeps to the cache.
    fn forward(
        &self,
        x: &Tensor,
        pass: &Pass,
        cache: &mut DecoderCache,
    ) -> candle_core::Result<Tensor>;

    /// As [`LanguageModel::exact_pass`](super::LanguageModel::exact_pass).
    fn exact_pass(&self) -> usize;
}

/// The data of a forward pass that a layer needs.
#[derive(Debug)]
pub(crate) struct Pass {
    pub layer: usize,
    /// Angles of the rows' positions.
    pub rotary: RotaryRows,
    /// Those of local layers; none where they have the same.
    pub local_rotary: Option<RotaryRows>,
    /// The rows of each image, in their order, for layers that tell an image from text.
    pub vision: Vec<Range<usize>>,
    /// Numbers of each token for each layer, (tokens, layers · width); none where layers have no
    /// input of their own.
    pub layer_inputs: Option<Tensor>,
}

impl Pass {
    /// The angles of a layer.
    pub(super) fn rotary(&self, local: bool) -> &RotaryRows {
        let local = self.local_rotary.as_ref().filter(|_| local);
        local.unwrap_or(&self.rotary)
    }
}

/// The feed-forward network of a layer: `down(f(gate(x)) · up(x))`, where f is SiLU in most
/// families. Gate and up projection are one matrix.
#[derive(Debug)]
pub(crate) struct SwiGlu {
    gate_up: Linear,
    down: Linear,
    act: Activation,
    /// Deviations above the mean of a row below which its gates are 0; none where all gates count.
    cutoff: Option<f32>,
}

#[derive(Debug, Clone, Copy)]
pub(crate) struct SwiGluShape<'a> {
    /// Names of the gate, up and down projection.
    pub names: [&'a str; 3],
    /// Width of input and output.
    pub hidden: usize,
    /// Width between the projections.
    pub intermediate: usize,
    pub bias: bool,
}

impl SwiGlu {
    pub(crate) fn take(
        weights: &mut Weights,
        name: &str,
        shape: SwiGluShape<'_>,
    ) -> Result<Self, MllmError> {
        let [gate, up, down] = shape.names.map(|part| format!("{name}.{part}"));
        let wide = shape.intermediate;
        Ok(Self {
            gate_up: weights.take_fused(&[(gate, wide), (up, wide)], shape.hidden, shape.bias)?,
            down: weights.take_linear(&down, wide, shape.hidden, shape.bias)?,
            act: Activation::Silu,
            cutoff: None,
        })
    }

    /// Takes the weights of a decoder layer, which have the same names in all families.
    /// `intermediate` is the width between the projections.
    pub(crate) fn take_mlp(
        weights: &mut Weights,
        name: &str,
        config: &LlamaConfig,
        intermediate: usize,
    ) -> Result<Self, MllmError> {
        let shape = SwiGluShape {
            names: ["gate_proj", "up_proj", "down_proj"],
            hidden: config.hidden,
            intermediate,
            bias: config.mlp_bias,
        };
        let act = config
            .gemma
            .as_ref()
            .map_or(Activation::Silu, |_| Activation::GeluTanh);
        let network = Self::take(weights, name, shape)?;
        let down = config.without_norm_before(network.down);
        Ok(Self {
            down,
            act,
            ..network
        })
    }

    /// Makes gates 0 that are not so many deviations above the mean of their row.
    pub(super) fn with_cutoff(self, cutoff: Option<f32>) -> Self {
        Self { cutoff, ..self }
    }

    /// What the second projection maps.
    fn gated(&self, x: &Tensor) -> candle_core::Result<Tensor> {
        let gate_up = self.gate_up.forward(x)?;
        match self.cutoff {
            Some(cutoff) => self.act.gated(&above_cutoff(&gate_up, cutoff)?),
            None => self.act.gated(&gate_up),
        }
    }

    /// Maps (tokens, hidden) to the same shape.
    pub(crate) fn forward(&self, x: &Tensor) -> candle_core::Result<Tensor> {
        self.down.forward(&self.gated(x)?)
    }

    /// residual + network(x), both (tokens, hidden).
    pub(crate) fn forward_onto(
        &self,
        x: &Tensor,
        residual: &Tensor,
    ) -> candle_core::Result<Tensor> {
        self.down.forward_onto(&self.gated(x)?, residual)
    }
}

/// Takes a norm of hidden states.
pub(crate) fn rms_norm(
    weights: &mut Weights,
    name: &str,
    config: &LlamaConfig,
) -> Result<RmsNorm, MllmError> {
    scaled_norm(weights, name, config.hidden, config, 1.0)
}

/// Takes a norm of rows of this width, whose results are multiplied by `scale`. Gemma 3 and
/// Qwen 3.5 multiply by 1 + weight.
pub(super) fn scaled_norm(
    weights: &mut Weights,
    name: &str,
    width: usize,
    config: &LlamaConfig,
    scale: f32,
) -> Result<RmsNorm, MllmError> {
    let adds_one = config.norms_add_one && !weights.norms_have_one();
    let offset = if adds_one { 1.0 } else { 0.0 };
    let stored: Vec<f32> = weights
        .take(&format!("{name}.weight"), &[width])?
        .to_vec1()?;
    let weight = stored
        .into_iter()
        .map(|weight| (weight + offset) * scale)
        .collect();
    Ok(RmsNorm::new(weight, config.rms_norm_eps))
}
