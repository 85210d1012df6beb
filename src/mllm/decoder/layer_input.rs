//! Inputs that each layer has of its own ("per-layer embeddings" of Gemma 3n and 4): numbers of the
//! token from a table, and of its input row by a projection.

use super::layer::{Pass, rms_norm, scaled_norm};
use crate::MllmError;
use crate::checkpoint::{LayerInputConfig, LlamaConfig, Weights};
use candle_core::{Result, Tensor};
use planagent_kernels::matrix::Matrix;
use planagent_kernels::{Activation, Linear, RmsNorm};
use std::f64::consts::FRAC_1_SQRT_2;

/// Makes the inputs of all layers.
#[derive(Debug)]
pub(super) struct LayerInputs {
    config: LayerInputConfig,
    /// (vocabulary, layers · width)
    table: Matrix,
    projection: Linear,
    /// Factor of what is projected.
    scale: f64,
    norm: RmsNorm,
}

impl LayerInputs {
    /// Takes the weights, whose names begin with `prefix`; none for a decoder without such inputs.
    pub(super) fn take(
        weights: &mut Weights,
        config: &LlamaConfig,
        prefix: &str,
    ) -> std::result::Result<Option<Self>, MllmError> {
        let Some(inputs) = config.layer_inputs else {
            return Ok(None);
        };
        let all = inputs.width * config.layers;
        let table = format!("{prefix}embed_tokens_per_layer.weight");
        let projection = format!("{prefix}per_layer_model_projection");
        let norm = format!("{prefix}per_layer_projection_norm");
        Ok(Some(Self {
            config: inputs,
            table: weights.take_matrix(&table, [inputs.vocabulary, all])?,
            projection: config.without_norm_before(weights.take_linear(
                &projection,
                config.hidden,
                all,
                false,
            )?),
            scale: 1.0 / (config.hidden as f64).sqrt(),
            norm: scaled_norm(weights, &norm, inputs.width, config, 1.0)?,
        }))
    }

    /// The inputs of rows, (tokens, layers · width), of these tokens; none stands for a row of an
    /// image.
    pub(super) fn forward(&self, rows: &Tensor, tokens: &[Option<u32>]) -> Result<Tensor> {
        let count = rows.dim(0)?;
        if tokens.len() != count {
            candle_core::bail!("{} tokens for {count} input rows", tokens.len());
        }
        let ids: Vec<u32> = tokens.iter().map(|token| self.config.row(*token)).collect();
        let of_tokens = (self.table.rows(&ids)? * (self.config.width as f64).sqrt())?;
        let of_rows = (self.projection.forward(rows)? * self.scale)?;
        let of_rows = self
            .norm
            .forward(&of_rows.reshape(((), self.config.width))?)?
            .reshape((count, ()))?;
        (of_rows + of_tokens)? * FRAC_1_SQRT_2
    }
}

/// What a layer adds of its own input: norm(projection(f(gate(x)) · input)).
#[derive(Debug)]
pub(super) struct LayerInput {
    layer: usize,
    gate: Linear,
    projection: Linear,
    norm: RmsNorm,
}

impl LayerInput {
    /// Takes that of a layer, by its number from 0 and its name; none for a decoder without such
    /// inputs.
    pub(super) fn take(
        weights: &mut Weights,
        config: &LlamaConfig,
        layer: usize,
        name: &str,
    ) -> std::result::Result<Option<Self>, MllmError> {
        let Some(LayerInputConfig { width, .. }) = config.layer_inputs else {
            return Ok(None);
        };
        let hidden = config.hidden;
        let gate = format!("{name}.per_layer_input_gate");
        let projection = format!("{name}.per_layer_projection");
        Ok(Some(Self {
            layer,
            gate: config.without_norm_before(weights.take_linear(&gate, hidden, width, false)?),
            projection: config.without_norm_before(weights.take_linear(
                &projection,
                width,
                hidden,
                false,
            )?),
            norm: rms_norm(
                weights,
                &format!("{name}.post_per_layer_input_norm"),
                config,
            )?,
        }))
    }

    /// x and what is added, (tokens, hidden).
    pub(super) fn forward_onto(&self, x: &Tensor, pass: &Pass) -> Result<Tensor> {
        x + self.forward(x, pass)?
    }

    /// What is added to x, (tokens, hidden).
    pub(super) fn forward(&self, x: &Tensor, pass: &Pass) -> Result<Tensor> {
        let Some(inputs) = &pass.layer_inputs else {
            candle_core::bail!("layer {} has no input of its own", self.layer);
        };
        let width = self.gate.outputs();
        let own = inputs.narrow(1, self.layer * width, width)?;
        let gated = Activation::GeluTanh.gated(&Tensor::cat(&[self.gate.forward(x)?, own], 1)?)?;
        self.norm.forward(&self.projection.forward(&gated)?)
    }
}
