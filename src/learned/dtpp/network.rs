//! Futures of the other agents for each branch of a tree of ego trajectories, and the branches'
//! scores.

use super::scorer::Scorer;
use crate::blocks::{Linear, Mlp, Probe, Weights, largest};
use crate::gameformer::{Block, EncodedScene, HEADS, SceneEncoder, SceneInputs};
use candle_core::{D, Device, Result, Tensor};
use rayon::prelude::*;

/// Steps of a branch, 0.1 s apart.
pub(super) const STEPS: usize = 80;
/// Columns of a step: x, y, heading, speed, acceleration, curvature.
pub(super) const COLUMNS: usize = 6;
/// Tokens of a branch, and steps of each.
const TOKENS: usize = 8;
const TOKEN_STEPS: usize = STEPS / TOKENS;
/// What hides a key: a row without any visible key then hears all of them equally, as upstream.
const HIDDEN: f32 = -1e9;

/// Widths and counts of a DTPP.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DtppConfig {
    /// Width of a token.
    pub dim: usize,
    /// Inner width of the decoder's blocks.
    pub inner: usize,
    /// Layers of the encoder.
    pub encoder_layers: usize,
    /// Agents with futures.
    pub neighbors: usize,
    /// Branches of a tree.
    pub branches: usize,
}

impl DtppConfig {
    /// The published planner.
    pub const PUBLISHED: Self = Self {
        dim: 256,
        inner: 1024,
        encoder_layers: 3,
        neighbors: 10,
        branches: 30,
    };
    /// `dtpp-small`.
    pub const SMALL: Self = Self {
        dim: 64,
        inner: 256,
        encoder_layers: 2,
        ..Self::PUBLISHED
    };
}

/// Outputs of a batch.
#[derive(Debug, Clone)]
pub struct DtppOutputs {
    /// Futures of the agents under each branch (B, M, N, 80, 3).
    pub futures: Tensor,
    /// Scores of the branches (B, M); −∞ for an unused one.
    pub scores: Tensor,
    /// Weights of the features of a branch (B, 8).
    pub weights: Tensor,
    /// The ego's trajectory that training regularizes with (B, 80, 3).
    pub regularization: Tensor,
}

/// DTPP.
#[derive(Debug, Clone)]
pub struct Dtpp {
    config: DtppConfig,
    encoder: SceneEncoder,
    trajectory: Mlp,
    times: Tensor,
    environment: Block,
    condition: Block,
    futures: [Linear; 2],
    regularization: [Linear; 2],
    scorer: Scorer,
}

impl Dtpp {
    /// Takes the parameters.
    ///
    /// # Errors
    /// When a tensor cannot be converted.
    pub fn take(weights: &mut Weights, config: DtppConfig) -> Result<Self> {
        let DtppConfig {
            dim,
            inner,
            encoder_layers,
            branches,
            ..
        } = config;
        let tokens = branches * TOKENS;
        // Buffers that PyTorch stored; they are computed here. Skipped, they do not count as left
        // over.
        weights.skip("decoder.casual_mask", &[tokens, tokens])?;
        weights.skip("decoder.time_index", &[branches, TOKENS])?;
        let layers = [0, 2].map(|i| format!("decoder.ego_traj_encoder.{i}"));
        let mut block = |name: &str| {
            Block::take(
                weights,
                &format!("decoder.{name}"),
                "cross_attention",
                [dim, inner],
            )
        };
        let (environment, condition) = (
            block("environment_decoder")?,
            block("ego_condition_decoder")?,
        );
        let futures = "decoder.agent_traj_decoder.traj_decoder";
        Ok(Self {
            config,
            encoder: SceneEncoder::take(weights, "encoder.", dim, encoder_layers)?,
            trajectory: Mlp::take(weights, &layers, &[COLUMNS, dim / 4, dim])?,
            times: weights.take("decoder.time_embed.weight", &[TOKENS, dim])?,
            environment,
            condition,
            futures: [
                weights.linear(&format!("{futures}.0"), 2 * dim, dim / 2)?,
                weights.linear(&format!("{futures}.2"), dim / 2, 3 * TOKEN_STEPS)?,
            ],
            regularization: [
                weights.linear("decoder.ego_traj_decoder.0", dim, dim)?,
                weights.linear("decoder.ego_traj_decoder.2", dim, 3 * STEPS)?,
            ],
            scorer: Scorer::take(weights, dim)?,
        })
    }

    /// Of scenes and trees (B, M, 80, 6), zeros where a branch is unused; the first `steps` steps
    /// of a branch count.
    ///
    /// # Errors
    /// When an input has another shape.
    pub fn forward(
        &self,
        inputs: &SceneInputs,
        tree: &Tensor,
        steps: usize,
        probe: &Probe,
    ) -> Result<DtppOutputs> {
        let scene = self.encode(inputs, probe)?;
        self.branches(inputs, &scene, tree, steps, probe)
    }

    /// Encodes a batch of scenes.
    pub(super) fn encode(&self, inputs: &SceneInputs, probe: &Probe) -> Result<EncodedScene> {
        self.encoder.forward(inputs, probe)
    }

    /// The outputs for trees in encoded scenes.
    pub(super) fn branches(
        &self,
        inputs: &SceneInputs,
        scene: &EncodedScene,
        tree: &Tensor,
        steps: usize,
        probe: &Probe,
    ) -> Result<DtppOutputs> {
        let DtppConfig {
            dim,
            neighbors,
            branches,
            ..
        } = self.config;
        let batch = tree.dim(0)?;
        let tokens = branches * TOKENS;
        let encoded = self.trajectory.forward(tree)?;
        probe.note("decoder.ego_traj_encoder", &encoded);
        let branch = encoded.narrow(2, steps - 1, 1)?;
        let pooled = largest(&encoded.reshape((batch, tokens, TOKEN_STEPS, dim))?)?;
        let embedded = branch
            .broadcast_add(&self.times.reshape((1, 1, TOKENS, dim))?)?
            .reshape((batch, tokens, dim))?;
        let (environment, condition) = self.biases(scene, tree)?;
        let states = inputs.neighbors.narrow(1, 0, neighbors)?;
        let states = states.narrow(2, states.dim(2)? - 1, 1)?.squeeze(2)?;
        // All agents attend to the same scene and the same branches.
        let [scene_memory, branch_memory] = [
            self.environment.memory(&scene.tokens)?,
            self.condition.memory(&pooled)?,
        ];
        let future = |i: usize| {
            let query = scene.tokens.narrow(1, i + 1, 1)?.broadcast_add(&embedded)?;
            let of_scene = self
                .environment
                .attended(&query, &scene_memory, &environment)?;
            let of_branch = self
                .condition
                .attended(&query, &branch_memory, &condition)?;
            let [inner, outer] = &self.futures;
            let moved = outer.forward(
                &inner
                    .forward(&Tensor::cat(&[&of_scene, &of_branch], 2)?)?
                    .elu(1.0)?,
            )?;
            let start = states
                .narrow(1, i, 1)?
                .narrow(2, 0, 3)?
                .reshape((batch, 1, 1, 3))?;
            Ok([
                of_scene,
                of_branch,
                moved
                    .reshape((batch, branches, STEPS, 3))?
                    .broadcast_add(&start)?,
            ])
        };
        let agents = (0..neighbors)
            .into_par_iter()
            .map(future)
            .collect::<Result<Vec<_>>>()?;
        let mut futures = Vec::with_capacity(neighbors);
        for [of_scene, of_branch, future] in agents {
            probe.note("decoder.environment_decoder", &of_scene);
            probe.note("decoder.ego_condition_decoder", &of_branch);
            futures.push(future);
        }
        let futures = Tensor::stack(&futures, 2)?;
        let (scores, weights) = self
            .scorer
            .forward([tree, &futures, &states], steps, probe)?;
        let [inner, outer] = &self.regularization;
        let ego = scene.tokens.narrow(1, 0, 1)?.squeeze(1)?;
        let regularization = outer
            .forward(&inner.forward(&ego)?.elu(1.0)?)?
            .reshape((batch, STEPS, 3))?;
        Ok(DtppOutputs {
            futures,
            scores,
            weights,
            regularization,
        })
    }

    /// Biases (B, heads, queries, keys) of the attention to the scene and to the branch itself.
    /// Upstream repeats its masks in another order than PyTorch reads them. So in a batch, heads
    /// use the masks of other samples; in a batch of one, all heads have one mask.
    fn biases(&self, scene: &EncodedScene, tree: &Tensor) -> Result<(Tensor, Tensor)> {
        let batch = tree.dim(0)?;
        let tokens = self.config.branches * TOKENS;
        let seen = scene.seen.to_vec2::<u8>()?;
        let used = tree.sum(D::Minus1)?.to_vec3::<f32>()?;
        let used = |sample: usize, query: usize| {
            let [branch, token] = [query / TOKENS, query % TOKENS];
            used[sample][branch][token * TOKEN_STEPS] != 0.0
        };
        let keys = scene.seen.dim(1)?;
        let heads = if batch == 1 { 1 } else { HEADS };
        let bias = |keys: usize, open: &dyn Fn(usize, usize, usize) -> bool| {
            let mut values = Vec::with_capacity(batch * heads * tokens * keys);
            for place in 0..batch * heads {
                // The order in which upstream's masks reach the heads, see above.
                let sample = place % batch;
                for query in 0..tokens {
                    values.extend((0..keys).map(|key| {
                        if open(sample, query, key) {
                            0.0
                        } else {
                            HIDDEN
                        }
                    }));
                }
            }
            Tensor::from_vec(values, (batch, heads, tokens, keys), &Device::Cpu)
        };
        let environment = bias(keys, &|sample, query, key| {
            used(sample, query) && seen[sample][key] != 0
        })?;
        let is_of_branch =
            |query: usize, key: usize| query / TOKENS == key / TOKENS && key <= query;
        let condition = bias(tokens, &|sample, query, key| {
            used(sample, query) && is_of_branch(query, key)
        })?;
        Ok((environment, condition))
    }
}
