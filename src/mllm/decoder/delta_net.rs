//! A gated delta rule behind a short convolution (Yang et al., arXiv:2412.06464;
//! `Qwen3_5GatedDeltaNet` in transformers 5.24.0).

use super::cache::{DecoderCache, LayerState};
use super::layer::Pass;
use super::mixer::Mixer;
use super::recurrence::Recurrence;
use super::taps::Taps;
use crate::MllmError;
use crate::checkpoint::{DeltaConfig, LlamaConfig, Weights};
use candle_core::Tensor;
use planagent_kernels::attention::{Precision, exact_tokens};
use planagent_kernels::{Activation, DeltaHeads, GatedDeltaRule, Linear, RmsNorm};
use std::sync::Arc;

/// Rows are projected to queries, keys and values, which are convolved, to two numbers for each
/// value head, which say how much is learned and forgotten, and to gates of what the rule gives. It
/// keeps the matrices of the rule in f32, and the last inputs of the convolution.
#[derive(Debug)]
pub(super) struct DeltaNet {
    project: Linear,
    memory: Arc<Memory>,
    /// Of what each value head gives, before the gate. Its weight is never stored with 1 added.
    norm: RmsNorm,
    out: Linear,
    heads: DeltaHeads,
    exact: usize,
}

impl DeltaNet {
    /// Takes that of the layer called `name`.
    pub(super) fn take(
        weights: &mut Weights,
        config: &LlamaConfig,
        delta: &DeltaConfig,
        name: &str,
    ) -> Result<Self, MllmError> {
        let heads = DeltaHeads {
            tiled: weights.heads_are_tiled(),
            ..delta.heads
        };
        let part = |part: &str| format!("{name}.linear_attn.{part}");
        let values = heads.values * heads.value_width;
        // What the memory reads comes first.
        let parts = [
            (part("in_proj_qkv"), heads.channels()),
            (part("in_proj_b"), heads.values),
            (part("in_proj_a"), heads.values),
            (part("in_proj_z"), values),
        ];
        let (decay, bias) = forgetting(weights, heads.values, &part)?;
        Ok(Self {
            project: weights.take_fused(&parts, config.hidden, false)?,
            memory: Arc::new(Memory {
                taps: Taps::take(
                    weights,
                    &part("conv1d"),
                    heads.channels(),
                    delta.taps,
                    false,
                )?,
                rule: GatedDeltaRule::new(heads, decay, bias),
            }),
            norm: weights.take_rms_norm(&part("norm"), heads.value_width, config.rms_norm_eps)?,
            out: weights.take_linear(&part("out_proj"), values, config.hidden, false)?,
            heads,
            exact: exact_tokens(config.into()),
        })
    }
}

/// For each value head, how fast it forgets, and what is added to what a token says of it. Training
/// checkpoints have the logarithm of the first; llama.cpp stores the number itself, below zero.
fn forgetting(
    weights: &mut Weights,
    heads: usize,
    part: &dyn Fn(&str) -> String,
) -> Result<(Vec<f32>, Vec<f32>), MllmError> {
    let negative = part("decay.weight");
    let decay: Vec<f32> = if weights.contains(&negative) {
        let stored: Vec<f32> = weights.take(&negative, &[heads])?.to_vec1()?;
        stored.into_iter().map(|decay| -decay).collect()
    } else {
        let stored: Vec<f32> = weights.take(&part("A_log"), &[heads])?.to_vec1()?;
        // One that is not finite would give no number where nothing is forgotten.
        let decay = |log: f32| log.exp().min(f32::MAX);
        stored.into_iter().map(decay).collect()
    };
    let bias = weights.take(&part("dt.bias"), &[heads])?.to_vec1()?;
    Ok((decay, bias))
}

impl Mixer for DeltaNet {
    fn new_state(&self, _precision: Precision) -> LayerState {
        LayerState::recurrent(Arc::clone(&self.memory) as Arc<_>)
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
        let tokens = rows.dim(0)?;
        let DeltaHeads {
            values,
            value_width,
            ..
        } = self.heads;
        let (read, width) = (self.memory.row(), values * value_width);
        let said = cache.run(pass.layer, &rows.narrow(1, 0, read)?)?;
        let said = self
            .norm
            .forward(&said.reshape((tokens * values, value_width))?)?;
        let gates = rows.narrow(1, read, width)?;
        Activation::Silu.gated(&Tensor::cat(&[gates, said.reshape((tokens, width))?], 1)?)
    }

    fn out(&self) -> &Linear {
        &self.out
    }
}

/// What a layer keeps: the last inputs of the convolution, then the matrices of the rule.
#[derive(Debug)]
struct Memory {
    taps: Taps,
    rule: GatedDeltaRule,
}

impl Recurrence for Memory {
    fn state(&self) -> usize {
        self.taps.state_numbers() + self.rule.state()
    }

    fn row(&self) -> usize {
        self.rule.row()
    }

    fn out(&self) -> usize {
        self.rule.out()
    }

    fn run(&self, state: &mut [f32], rows: &[f32], out: &mut [f32]) {
        let (earlier, matrices) = state.split_at_mut(self.taps.state_numbers());
        let mut convolved = rows.to_vec();
        let channels = self.rule.heads().channels();
        let both = rows.chunks_exact(self.row());
        for (row, out) in both.zip(convolved.chunks_exact_mut(self.row())) {
            let (row, _) = row.split_at(channels);
            let (out, _) = out.split_at_mut(channels);
            self.taps.step(earlier, row, out);
        }
        self.rule.run(matrices, &mut convolved, out);
    }
}
