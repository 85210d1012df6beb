//! GameFormer: encoder, decoder, plan.

use super::decoder::{Decoder, Level};
use super::encoder::{SceneEncoder, SceneInputs};
use super::plan::PlanHead;
use crate::blocks::{Probe, Weights};
use candle_core::{Result, Tensor};

/// Widths and counts of a GameFormer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GameFormerConfig {
    /// Width of a token.
    pub dim: usize,
    /// Layers of the encoder.
    pub encoder_layers: usize,
    /// Levels above the first.
    pub levels: usize,
    /// Modes of a future.
    pub modes: usize,
    /// Actors with futures beside the ego.
    pub neighbors: usize,
}

impl GameFormerConfig {
    /// The published planner.
    pub const PUBLISHED: Self = Self {
        dim: 256,
        encoder_layers: 3,
        levels: 2,
        modes: 6,
        neighbors: 10,
    };
    /// `gameformer-small`.
    pub const SMALL: Self = Self {
        dim: 64,
        encoder_layers: 2,
        levels: 1,
        ..Self::PUBLISHED
    };
}

/// Outputs of a batch.
#[derive(Debug, Clone)]
pub struct GameFormerOutputs {
    /// Futures and scores of all levels.
    pub levels: Vec<(Tensor, Tensor)>,
    /// The ego's plan (B, 80, 3).
    pub plan: Tensor,
}

/// GameFormer.
#[derive(Debug, Clone)]
pub struct GameFormer {
    encoder: SceneEncoder,
    decoder: Decoder,
    plan: PlanHead,
}

impl GameFormer {
    /// Takes the parameters.
    ///
    /// # Errors
    /// When a tensor cannot be converted.
    pub fn take(weights: &mut Weights, config: GameFormerConfig) -> Result<Self> {
        let GameFormerConfig {
            dim,
            encoder_layers,
            levels,
            modes,
            neighbors,
        } = config;
        Ok(Self {
            encoder: SceneEncoder::take(weights, "encoder.", dim, encoder_layers)?,
            decoder: Decoder::take(weights, [dim, levels, modes, neighbors + 1])?,
            plan: PlanHead::take(weights, dim)?,
        })
    }

    /// Futures, and the plan along route lanes (B, R, 50, 3).
    ///
    /// # Errors
    /// When an input has another shape.
    pub fn forward(
        &self,
        inputs: &SceneInputs,
        route: &Tensor,
        probe: &Probe,
    ) -> Result<GameFormerOutputs> {
        let scene = self.encoder.forward(inputs, probe)?;
        let (levels, ego) = self.decoder.forward(&scene, probe)?;
        let plan = self.plan.forward(
            &ego,
            route,
            &scene.current.narrow(1, 0, 1)?.squeeze(1)?,
            probe,
        )?;
        let levels = levels
            .into_iter()
            .map(|Level { futures, scores }| (futures, scores))
            .collect();
        Ok(GameFormerOutputs { levels, plan })
    }
}
