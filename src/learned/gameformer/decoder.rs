//! GameFormer's decoder: futures of all actors, level by level; each level answers those of the
//! level before.

use super::encoder::{Block, EncodedScene};
use crate::blocks::{Linear, Mlp, Probe, Weights, key_bias, largest, softmax};
use candle_core::{D, DType, Device, Result, Tensor};

/// Poses of a future, 0.1 s apart.
pub(super) const POSES: usize = 80;
/// Numbers of a pose: x, y and the logarithms of both deviations.
const GAUSSIAN: usize = 4;
/// Numbers of a step that the encoder of futures reads: x, y, heading, velocity.
const STEP: usize = 5;
/// Time between two poses, seconds.
const STEP_S: f64 = 0.1;
/// Least step forward when the heading of a future is computed, meters (`clamp(min=1e-6)` of
/// upstream's `FutureEncoder.state_process`).
const MIN_FORWARD: f64 = 1e-6;

/// What a level predicts.
#[derive(Debug, Clone)]
pub(super) struct Level {
    /// Futures (B, N, M, 80, 4).
    pub(super) futures: Tensor,
    /// Logits of the modes (B, N, M).
    pub(super) scores: Tensor,
}

/// Trajectories as Gaussians, with scores.
#[derive(Debug, Clone)]
struct Gaussians {
    gaussian: [Linear; 2],
    score: [Linear; 2],
}

impl Gaussians {
    fn take(weights: &mut Weights, name: &str, dim: usize) -> Result<Self> {
        Ok(Self {
            gaussian: [
                weights.linear(&format!("{name}.gaussian.0"), dim, 2 * dim)?,
                weights.linear(&format!("{name}.gaussian.3"), 2 * dim, POSES * GAUSSIAN)?,
            ],
            score: [
                weights.linear(&format!("{name}.score.0"), dim, dim / 4)?,
                weights.linear(&format!("{name}.score.2"), dim / 4, 1)?,
            ],
        })
    }

    /// Of contents (B, N, M, dim) and present states (B, N, 5).
    fn forward(&self, content: &Tensor, current: &Tensor) -> Result<Level> {
        let (batch, actors, modes, _) = content.dims4()?;
        let head = |[inner, outer]: &[Linear; 2]| outer.forward(&inner.forward(content)?.elu(1.0)?);
        let futures = head(&self.gaussian)?.reshape((batch, actors, modes, POSES, GAUSSIAN))?;
        let place = current.narrow(2, 0, 2)?.reshape((batch, actors, 1, 1, 2))?;
        let place = place.pad_with_zeros(D::Minus1, 0, GAUSSIAN - 2)?;
        Ok(Level {
            futures: futures.broadcast_add(&place)?,
            scores: head(&self.score)?.squeeze(3)?,
        })
    }
}

/// One level above the first.
#[derive(Debug, Clone)]
struct Stage {
    interaction: Block,
    query: Block,
    futures: Mlp,
    predictor: Gaussians,
}

/// The decoder.
#[derive(Debug, Clone)]
pub(super) struct Decoder {
    modes: Tensor,
    actors: Tensor,
    query: Block,
    predictor: Gaussians,
    stages: Vec<Stage>,
}

impl Decoder {
    pub(super) fn take(
        weights: &mut Weights,
        [dim, levels, modes, actors]: [usize; 4],
    ) -> Result<Self> {
        let first = "decoder.initial_predictor";
        // Indices of the embeddings, which the checkpoint stores and this code counts itself.
        weights.skip(&format!("{first}.modal"), &[modes])?;
        weights.skip(&format!("{first}.agent"), &[actors])?;
        let stage = |i: usize| {
            let name = format!("decoder.interaction_stage.{i}");
            let layers = [0, 2].map(|i| format!("{name}.future_encoder.mlp.{i}"));
            Ok(Stage {
                interaction: Block::take(
                    weights,
                    &format!("{name}.interaction_encoder"),
                    "self_attention",
                    [dim, 4 * dim],
                )?,
                query: Block::take(
                    weights,
                    &format!("{name}.query_encoder"),
                    "cross_attention",
                    [dim, 4 * dim],
                )?,
                futures: Mlp::take(weights, &layers, &[STEP, dim / 4, dim])?,
                predictor: Gaussians::take(weights, &format!("{name}.decoder"), dim)?,
            })
        };
        let stages = (0..levels).map(stage).collect::<Result<_>>()?;
        Ok(Self {
            stages,
            modes: weights.take(
                &format!("{first}.multi_modal_query_embedding.weight"),
                &[modes, dim],
            )?,
            actors: weights.take(
                &format!("{first}.agent_query_embedding.weight"),
                &[actors, dim],
            )?,
            query: Block::take(
                weights,
                &format!("{first}.query_encoder"),
                "cross_attention",
                [dim, 4 * dim],
            )?,
            predictor: Gaussians::take(weights, &format!("{first}.predictor"), dim)?,
        })
    }

    /// The predictions of all levels, and the ego's contents of the last (B, M, dim).
    pub(super) fn forward(
        &self,
        scene: &EncodedScene,
        probe: &Probe,
    ) -> Result<(Vec<Level>, Tensor)> {
        let (batch, _, dim) = scene.tokens.dims3()?;
        let (modes, actors) = (self.modes.dim(0)?, self.actors.dim(0)?);
        let current = scene.current.narrow(1, 0, actors)?;
        let query = self
            .actors
            .unsqueeze(1)?
            .broadcast_add(&self.modes.unsqueeze(0)?)?;
        let query = scene
            .tokens
            .narrow(1, 0, actors)?
            .unsqueeze(2)?
            .broadcast_add(&query.unsqueeze(0)?)?;
        let by_actor = |x: &Tensor| x.reshape((batch, actors, modes, dim));
        let flat = |x: &Tensor| x.reshape((batch, actors * modes, dim));
        let mut content = by_actor(&self.query.cross(
            &flat(&query)?,
            &scene.tokens,
            &key_bias(&scene.seen)?,
        )?)?;
        probe.note("decoder.initial_predictor.query_encoder", &content);
        let mut levels = vec![self.predictor.forward(&content, &current)?];
        let present = scene.seen.narrow(1, 0, actors)?.contiguous()?;
        for (i, stage) in self.stages.iter().enumerate() {
            let Some(Level { futures, scores }) = levels.last() else {
                break;
            };
            let encoded = largest(
                &stage
                    .futures
                    .forward(&steps(&futures.narrow(4, 0, 2)?, &current)?)?,
            )?;
            probe.note(
                &format!("decoder.interaction_stage.{i}.future_encoder"),
                &encoded,
            );
            let shares = softmax(scores)?.unsqueeze(3)?;
            // As upstream: a mean over the modes, although their shares sum up to one already.
            let expected = (encoded.broadcast_mul(&shares)?.sum(2)? / modes as f64)?;
            let interaction = stage
                .interaction
                .self_attended(&expected, &key_bias(&present)?)?;
            probe.note(
                &format!("decoder.interaction_stage.{i}.interaction_encoder"),
                &interaction,
            );
            let memory = Tensor::cat(&[&interaction, &scene.tokens], 1)?;
            let bias = key_bias(&Tensor::cat(&[&present, &scene.seen], 1)?)?;
            let bias = bias.broadcast_add(&own_hidden(actors, modes, memory.dim(1)?)?)?;
            let query = flat(&(&content + encoded)?)?;
            content = by_actor(&stage.query.cross(&query, &memory, &bias)?)?;
            probe.note(
                &format!("decoder.interaction_stage.{i}.query_encoder"),
                &content,
            );
            levels.push(stage.predictor.forward(&content, &current)?);
        }
        let ego = content.narrow(1, 0, 1)?.squeeze(1)?;
        Ok((levels, ego))
    }
}

/// −∞ where a query of an actor would attend to the actor's own interaction (1, 1, actors · modes,
/// keys).
fn own_hidden(actors: usize, modes: usize, keys: usize) -> Result<Tensor> {
    let mut bias = vec![0f32; actors * modes * keys];
    for (query, row) in bias.chunks_exact_mut(keys).enumerate() {
        row[query / modes] = f32::NEG_INFINITY;
    }
    Tensor::from_vec(bias, (1, 1, actors * modes, keys), &Device::Cpu)
}

/// x, y, heading and velocity of futures (B, N, M, 80, 2).
///
/// As upstream, a heading is within ±90 degrees of the ego's: a step back counts as one of
/// [`MIN_FORWARD`], so an oncoming agent heads to the left or right. Upstream gives no reason; the
/// bound keeps the gradient of `atan2` finite at a step of zero. Published weights are trained with
/// it, so it stays.
fn steps(futures: &Tensor, current: &Tensor) -> Result<Tensor> {
    let (batch, actors, modes, poses, _) = futures.dims5()?;
    let start = current.narrow(2, 0, 2)?.reshape((batch, actors, 1, 1, 2))?;
    let start = start
        .broadcast_as((batch, actors, modes, 1, 2))?
        .contiguous()?;
    let before = Tensor::cat(&[start, futures.narrow(3, 0, poses - 1)?], 3)?;
    let moved = (futures - before)?;
    let column = |i: usize| moved.narrow(4, i, 1)?.flatten_all()?.to_vec1::<f32>();
    let (forward, left) = (column(0)?, column(1)?);
    let heading = left
        .iter()
        .zip(&forward)
        .map(|(y, x)| y.atan2(x.max(MIN_FORWARD as f32)));
    let heading = Tensor::from_iter(heading, &Device::Cpu)?.to_dtype(DType::F32)?;
    let heading = heading.reshape((batch, actors, modes, poses, 1))?;
    Tensor::cat(&[futures, &heading, &(moved / STEP_S)?], 4)
}
