//! A gated convolution over the last positions (LFM2: `Lfm2ShortConv` in transformers 5.24.0).

use super::cache::{DecoderCache, LayerState};
use super::layer::Pass;
use super::mixer::Mixer;
use super::taps::Taps;
use crate::MllmError;
use crate::checkpoint::{ConvolutionConfig, LlamaConfig, Weights};
use candle_core::Tensor;
use planagent_kernels::Linear;
use planagent_kernels::attention::{Precision, exact_tokens};
use std::sync::Arc;

/// Rows are projected to three: two are multiplied, the product is convolved, and the result is
/// multiplied by the third. It keeps the last products.
#[derive(Debug)]
pub(super) struct ShortConvolution {
    project: Linear,
    taps: Arc<Taps>,
    out: Linear,
    hidden: usize,
    exact: usize,
}

impl ShortConvolution {
    /// Takes that of the layer called `name`.
    pub(super) fn take(
        weights: &mut Weights,
        config: &LlamaConfig,
        convolution: &ConvolutionConfig,
        name: &str,
    ) -> Result<Self, MllmError> {
        let (hidden, bias) = (config.hidden, convolution.bias);
        let part = |part: &str| format!("{name}.conv.{part}");
        Ok(Self {
            project: weights.take_linear(&part("in_proj"), hidden, 3 * hidden, bias)?,
            taps: Arc::new(Taps::take(
                weights,
                &part("conv"),
                hidden,
                convolution.taps,
                bias,
            )?),
            out: weights.take_linear(&part("out_proj"), hidden, hidden, bias)?,
            hidden,
            exact: exact_tokens(config.into()),
        })
    }
}

impl Mixer for ShortConvolution {
    fn new_state(&self, _precision: Precision) -> LayerState {
        LayerState::recurrent(Arc::clone(&self.taps) as Arc<_>)
    }

    fn exact_pass(&self) -> usize {
        self.exact
    }

    fn mix(
        &self,
        x: &Tensor,
        pass: &Pass,
        cache: &mut DecoderCache,
    ) -> candle_core::Result<Tensor> {
        let rows = self.project.forward(x)?;
        let part = |index: usize| rows.narrow(1, index * self.hidden, self.hidden);
        let product = (part(0)? * part(2)?)?;
        part(1)? * cache.run(pass.layer, &product)?
    }

    fn out(&self) -> &Linear {
        &self.out
    }
}
