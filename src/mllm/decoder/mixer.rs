//! The part of a layer that mixes positions.

use super::cache::{DecoderCache, LayerState};
use super::delta_net::DeltaNet;
use super::layer::Pass;
use super::self_attention::SelfAttention;
use super::short_convolution::ShortConvolution;
use crate::MllmError;
use crate::checkpoint::{LlamaConfig, Weights};
use candle_core::Tensor;
use planagent_kernels::Linear;
use planagent_kernels::attention::Precision;
use std::fmt::Debug;

/// The part of a layer that mixes positions, by what it keeps of those before.
pub(super) trait Mixer: Debug + Send + Sync {
    /// As [`DecoderLayer::new_state`](super::DecoderLayer::new_state).
    fn new_state(&self, precision: Precision) -> LayerState;

    /// As [`LanguageModel::exact_pass`](super::LanguageModel::exact_pass).
    fn exact_pass(&self) -> usize;

    /// The mixed rows of normalized ones, (tokens, hidden), before the output projection.
    fn mix(&self, x: &Tensor, pass: &Pass, cache: &mut DecoderCache)
    -> candle_core::Result<Tensor>;

    /// The output projection.
    fn out(&self) -> &Linear;
}

/// Takes that of a layer, by its number from 0 and its name.
pub(super) fn take(
    weights: &mut Weights,
    config: &LlamaConfig,
    layer: usize,
    name: &str,
) -> Result<Box<dyn Mixer>, MllmError> {
    if let Some(convolution) = &config.convolution
        && convolution.is_in(layer)
    {
        return Ok(Box::new(ShortConvolution::take(
            weights,
            config,
            convolution,
            name,
        )?));
    }
    if let Some(delta) = &config.delta
        && delta.is_in(layer)
    {
        return Ok(Box::new(DeltaNet::take(weights, config, delta, name)?));
    }
    Ok(Box::new(SelfAttention::take(weights, config, layer, name)?))
}
