//! Scores of branches: comfort and progress by formula, interaction by a network, and nearness to
//! the agents.

use super::network::{COLUMNS, STEPS};
use crate::blocks::{Linear, Mlp, Probe, Weights, largest};
use candle_core::{D, Device, Result, Tensor};
use rayon::prelude::*;

/// Features by formula, and by the network.
const PLAIN: usize = 4;
const LATENT: usize = 4;
/// Columns of a step relative to an agent.
const RELATIVE: usize = 10;
/// Places of an agent's length in its state; width and three flags follow.
const SIZE: usize = 6;
/// Time between two steps, seconds.
const STEP_S: f32 = 0.1;
/// Bounds of mean speed, m/s, acceleration, m/s², jerk, m/s³, and lateral acceleration, m/s².
const BOUNDS: [f32; PLAIN] = [15.0, 4.0, 6.0, 5.0];
/// Weight and steepness of nearness.
const NEARNESS: f32 = 10.0;
const STEEPNESS: f32 = 0.2;

#[derive(Debug, Clone)]
pub(super) struct Scorer {
    relative: Mlp,
    latent: [Linear; 2],
    weights: [Linear; 2],
    dim: usize,
}

impl Scorer {
    pub(super) fn take(weights: &mut Weights, dim: usize) -> Result<Self> {
        let mut two = |name: &str, outputs: usize| -> Result<[Linear; 2]> {
            Ok([
                weights.linear(&format!("decoder.scorer.{name}.0"), dim, dim / 4)?,
                weights.linear(&format!("decoder.scorer.{name}.2"), dim / 4, outputs)?,
            ])
        };
        let latent = two("interaction_feature_decoder", LATENT)?;
        let factors = two("weights_decoder", PLAIN + LATENT)?;
        let layers = [0, 2].map(|i| format!("decoder.scorer.interaction_feature_encoder.{i}"));
        let relative = Mlp::take(weights, &layers, &[RELATIVE, dim / 4, dim])?;
        Ok(Self {
            relative,
            latent,
            weights: factors,
            dim,
        })
    }

    /// Scores (B, M) and weights (B, 8) of trees (B, M, 80, 6), futures (B, M, N, 80, 3) and
    /// present states of the agents (B, N, 11).
    pub(super) fn forward(
        &self,
        [tree, futures, states]: [&Tensor; 3],
        steps: usize,
        probe: &Probe,
    ) -> Result<(Tensor, Tensor)> {
        let (batch, branches, _, _) = tree.dims4()?;
        let agents = states.dim(1)?;
        let rows = |tensor: &Tensor| tensor.flatten_all()?.to_vec1::<f32>();
        let (tree, futures, states) = (rows(tree)?, rows(futures)?, rows(&states.contiguous()?)?);
        let columns = states.len() / (batch * agents);
        let rated = tree
            .par_chunks_exact(STEPS * COLUMNS)
            .enumerate()
            .map(|(i, branch)| {
                let states = &states[i / branches * agents * columns..][..agents * columns];
                let futures = &futures[i * agents * STEPS * 3..][..agents * STEPS * 3];
                let (mut relative, mut near) = (Vec::with_capacity(agents * steps * RELATIVE), 0.0);
                for (state, future) in states
                    .chunks_exact(columns)
                    .zip(futures.chunks_exact(STEPS * 3))
                {
                    let present = if state.iter().sum::<f32>() == 0.0 {
                        0.0
                    } else {
                        1.0
                    };
                    near += present * closeness(branch, future, steps);
                    for step in 0..steps {
                        relative.extend(
                            beside(branch, future, step, &state[SIZE..])
                                .map(|value| value * present),
                        );
                    }
                }
                let relative =
                    Tensor::from_vec(relative, (1, agents, steps, RELATIVE), &Device::Cpu)?;
                let encoded = self.relative.forward(&relative)?;
                if i == 0 {
                    probe.note("decoder.interaction_feature_encoder", &encoded);
                }
                let strongest = largest(&encoded.reshape((1, agents, steps * self.dim))?)?;
                let interaction = strongest.reshape((steps, self.dim))?.mean(0)?;
                Ok(RatedBranch {
                    plain: formulas(branch, steps),
                    interaction,
                    near,
                    unused: branch.iter().sum::<f32>() == 0.0,
                })
            });
        let rated = rated.collect::<Result<Vec<_>>>()?;
        let count = rated.len();
        let interactions: Vec<&Tensor> = rated.iter().map(|branch| &branch.interaction).collect();
        let head =
            |[inner, outer]: &[Linear; 2], x: &Tensor| outer.forward(&inner.forward(x)?.elu(1.0)?);
        let latent = head(&self.latent, &Tensor::stack(&interactions, 0)?)?;
        let latent = (latent.neg()?.exp()? + 1.0)?.recip()?;
        probe.note(
            "decoder.interaction_feature_decoder",
            &latent.narrow(0, 0, 1)?,
        );
        let plain = rated.iter().flat_map(|branch| branch.plain).collect();
        let plain = Tensor::from_vec(plain, (count, PLAIN), &Device::Cpu)?;
        probe.note(
            "hardcoded_features",
            &plain.reshape((batch, branches, PLAIN))?,
        );
        let ones = Tensor::ones((1, self.dim), plain.dtype(), &Device::Cpu)?;
        // Softplus.
        let weights = (head(&self.weights, &ones)?.exp()? + 1.0)?.log()?;
        let cost = Tensor::cat(&[plain, latent], 1)?
            .broadcast_mul(&weights)?
            .sum(D::Minus1)?
            .to_vec1::<f32>()?;
        let scores = cost
            .iter()
            .zip(&rated)
            .map(|(cost, RatedBranch { near, unused, .. })| {
                if *unused {
                    f32::NEG_INFINITY
                } else {
                    -cost - NEARNESS * near
                }
            });
        let scores = Tensor::from_iter(scores, &Device::Cpu)?.reshape((batch, branches))?;
        let nearness = Tensor::from_iter(rated.iter().map(|branch| branch.near), &Device::Cpu)?;
        probe.note("collision", &nearness.reshape((batch, branches))?);
        Ok((
            scores,
            weights
                .broadcast_as((batch, PLAIN + LATENT))?
                .contiguous()?,
        ))
    }
}

/// What a branch's score is made of.
struct RatedBranch {
    plain: [f32; PLAIN],
    /// The strongest interaction with an agent at each step, their mean (dim).
    interaction: Tensor,
    near: f32,
    unused: bool,
}

/// A step of a branch.
fn at(branch: &[f32], step: usize) -> [f32; COLUMNS] {
    std::array::from_fn(|i| branch[step * COLUMNS + i])
}

/// Progress (negative), acceleration, jerk and lateral acceleration, as shares of their bounds.
fn formulas(branch: &[f32], steps: usize) -> [f32; PLAIN] {
    let mean = |value: &dyn Fn(usize) -> f32| (0..steps).map(value).sum::<f32>() / steps as f32;
    let acceleration = |step: usize| at(branch, step)[4];
    let jerk = |step: usize| (acceleration(step.max(1)) - acceleration(step.max(1) - 1)) / STEP_S;
    let lateral = |step: usize| {
        let [_, _, _, speed, _, curvature] = at(branch, step);
        speed * speed * curvature
    };
    let means = [
        mean(&|step| at(branch, step)[3]),
        mean(&|step| acceleration(step).abs()),
        mean(&|step| jerk(step).abs()),
        mean(&|step| lateral(step).abs()),
    ];
    let [speed, acceleration, jerk, lateral] =
        std::array::from_fn(|i| means[i].clamp(0.0, BOUNDS[i]) / BOUNDS[i]);
    [-speed, acceleration, jerk, lateral]
}

fn closeness(branch: &[f32], future: &[f32], steps: usize) -> f32 {
    let near = |step: usize| {
        let [x, y, ..] = at(branch, step);
        let (dx, dy) = (x - future[3 * step], y - future[3 * step + 1]);
        (-STEEPNESS * (dx * dx + dy * dy)).exp()
    };
    (0..steps).map(near).sum()
}

/// An agent's step relative to a branch's. As upstream, x goes with the cosine of the turn and y
/// with its sine.
fn beside(branch: &[f32], future: &[f32], step: usize, size: &[f32]) -> [f32; RELATIVE] {
    let [x, y, heading, speed, ..] = at(branch, step);
    let place = |step: usize| [future[3 * step], future[3 * step + 1]];
    let turn = future[3 * step + 2] - heading;
    let turn = turn.sin().atan2(turn.cos());
    let ([now_x, now_y], later) = (place(step), step.max(1));
    let ([after_x, after_y], [before_x, before_y]) = (place(later), place(later - 1));
    let (vx, vy) = ((after_x - before_x) / STEP_S, (after_y - before_y) / STEP_S);
    let (sin, cos) = turn.sin_cos();
    let size = |i: usize| *size.get(i).expect("a state ends with five sizes");
    [
        (now_x - x) * cos,
        (now_y - y) * sin,
        turn,
        (vx - speed * heading.cos()) * cos,
        (vy - speed * heading.sin()) * sin,
        size(0),
        size(1),
        size(2),
        size(3),
        size(4),
    ]
}
