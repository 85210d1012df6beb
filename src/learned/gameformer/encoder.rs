//! The encoder of GameFormer and DTPP: actors and pieces of map lines as tokens of one transformer.

use crate::blocks::{
    LayerNorm, Linear, Lstm, Mlp, MultiheadAttention, PackedKeyValues, Probe, Weights, gelu,
    key_bias, largest,
};
use candle_core::{D, Device, Result, Tensor};

/// Heads of all attention layers.
pub(crate) const HEADS: usize = 8;
/// Layers of the LSTM of actors.
const LSTM_LAYERS: usize = 2;
/// Columns of a step of the ego and of another actor.
const EGO: usize = 7;
const NEIGHBOR: usize = 11;
/// Columns of an actor's present state: x, y, heading, velocity.
const STATE: usize = 5;
/// Columns and points of lanes and crosswalks.
const LANE: [usize; 2] = [7, 50];
const CROSSWALK: [usize; 2] = [3, 30];
/// Points of a lane or crosswalk in one token.
const TOKEN_POINTS: usize = 10;

/// Inputs of a batch, f32, zeros where nothing is; the frame is that of the rear axle now.
#[derive(Debug, Clone)]
pub struct SceneInputs {
    /// The ego's steps (B, 21, 7).
    pub ego: Tensor,
    /// The other actors' steps (B, A, 21, 11).
    pub neighbors: Tensor,
    /// Lanes (B, L, 50, 7).
    pub lanes: Tensor,
    /// Crosswalks (B, C, 30, 3).
    pub crosswalks: Tensor,
}

/// A scene as tokens: the ego, the other actors, pieces of lanes, pieces of crosswalks.
#[derive(Debug, Clone)]
pub(crate) struct EncodedScene {
    /// Present states (B, 1 + A, 5).
    pub current: Tensor,
    /// Tokens (B, T, dim).
    pub tokens: Tensor,
    /// Which are seen (B, T), u8.
    pub seen: Tensor,
}

/// Encodes a scene.
#[derive(Debug, Clone)]
pub(crate) struct SceneEncoder {
    neighbors: Lstm,
    ego: Lstm,
    lanes: MapEncoder,
    crosswalks: MapEncoder,
    layers: Vec<Layer>,
}

impl SceneEncoder {
    /// Takes the parameters below a prefix, which ends with a dot or is empty.
    pub(crate) fn take(
        weights: &mut Weights,
        prefix: &str,
        dim: usize,
        layers: usize,
    ) -> Result<Self> {
        let mut lstm = |name: &str, inputs: usize| {
            Lstm::take(
                weights,
                &format!("{prefix}{name}.motion"),
                [inputs, dim, LSTM_LAYERS],
            )
        };
        let (neighbors, ego) = (lstm("agent_encoder", NEIGHBOR)?, lstm("ego_encoder", EGO)?);
        let layers = (0..layers)
            .map(|i| Layer::take(weights, &format!("{prefix}fusion_encoder.layers.{i}"), dim));
        let layers = layers.collect::<Result<_>>()?;
        Ok(Self {
            neighbors,
            ego,
            layers,
            lanes: MapEncoder::take(weights, &format!("{prefix}lane_encoder"), LANE, dim)?,
            crosswalks: MapEncoder::take(
                weights,
                &format!("{prefix}crosswalk_encoder"),
                CROSSWALK,
                dim,
            )?,
        })
    }

    /// Encodes a batch.
    ///
    /// # Errors
    /// When an input has another shape.
    pub(crate) fn forward(&self, inputs: &SceneInputs, probe: &Probe) -> Result<EncodedScene> {
        let (batch, count, steps, columns) = inputs.neighbors.dims4()?;
        let histories = inputs.neighbors.reshape((batch * count, steps, columns))?;
        let map = || -> Result<_> {
            let lanes = self
                .lanes
                .forward(&inputs.lanes, "encoder.lane_encoder", probe)?;
            Ok((
                lanes,
                self.crosswalks
                    .forward(&inputs.crosswalks, "encoder.crosswalk_encoder", probe)?,
            ))
        };
        // Two threads, since neither part needs the other's result.
        let ((ego, map), neighbors) = rayon::join(
            || (self.ego.last(&inputs.ego), map()),
            || self.neighbors.last(&histories),
        );
        let (ego, ((lanes, lanes_seen), (crosswalks, crosswalks_seen))) = (ego?, map?);
        probe.note("encoder.ego_encoder", &ego);
        let neighbors = neighbors?.reshape((batch, count, ()))?;
        let present =
            |x: &Tensor, time: usize| x.narrow(time, steps - 1, 1)?.narrow(D::Minus1, 0, STATE);
        let current = Tensor::cat(
            &[
                present(&inputs.ego, 1)?,
                present(&inputs.neighbors, 2)?.squeeze(2)?,
            ],
            1,
        )?;
        let actors = seen(&current)?;
        let seen = Tensor::cat(&[actors, lanes_seen, crosswalks_seen], 1)?;
        let hidden = key_bias(&seen)?;
        let mut tokens = Tensor::cat(&[ego.unsqueeze(1)?, neighbors, lanes, crosswalks], 1)?;
        for (i, layer) in self.layers.iter().enumerate() {
            tokens = layer.forward(&tokens, &hidden)?;
            probe.note(&format!("encoder.fusion_encoder.layers.{i}"), &tokens);
        }
        probe.note("encoder.fusion_encoder", &tokens);
        Ok(EncodedScene {
            current,
            tokens,
            seen,
        })
    }
}

/// Which actors are seen (B, 1 + A): those whose state does not sum up to exactly 0, as upstream,
/// which hides an ego that stands. Where none would be seen, the ego is: upstream's attention
/// without keys is NaN.
fn seen(current: &Tensor) -> Result<Tensor> {
    let actors = current.sum(2)?.ne(0.0)?;
    let nobody = actors.max_keepdim(1)?.eq(0u8)?;
    let ego = actors.narrow(1, 0, 1)?.maximum(&nobody)?;
    Tensor::cat(&[ego, actors.narrow(1, 1, actors.dim(1)? - 1)?], 1)
}

/// Tokens of pieces of lines.
#[derive(Debug, Clone)]
pub(super) struct MapEncoder {
    points: Mlp,
    positions: Tensor,
}

impl MapEncoder {
    pub(super) fn take(
        weights: &mut Weights,
        name: &str,
        [columns, points]: [usize; 2],
        dim: usize,
    ) -> Result<Self> {
        weights.skip(&format!("{name}.position_encode.pe"), &[1, points, dim])?;
        let layers = [0, 2, 4].map(|i| format!("{name}.point_net.{i}"));
        Ok(Self {
            points: Mlp::take(weights, &layers, &[columns, dim / 4, dim / 2, dim])?,
            positions: positions(points, dim)?,
        })
    }

    /// Tokens (B, N · pieces, dim) of lines (B, N, points, columns), and which are seen: those
    /// whose x is nowhere exactly 0.
    pub(super) fn forward(
        &self,
        lines: &Tensor,
        name: &str,
        probe: &Probe,
    ) -> Result<(Tensor, Tensor)> {
        let (batch, count, points, _) = lines.dims4()?;
        let encoded = self.points.forward(lines)?;
        probe.note(&format!("{name}.point_net"), &encoded);
        let tokens_of_line = points / TOKEN_POINTS;
        let encoded = encoded.broadcast_add(&self.positions)?;
        let tokens =
            largest(&encoded.reshape((batch, count * tokens_of_line, TOKEN_POINTS, ()))?)?;
        let x = lines
            .narrow(3, 0, 1)?
            .reshape((batch, count * tokens_of_line, TOKEN_POINTS))?;
        Ok((tokens, x.ne(0.0)?.min(2)?))
    }
}

/// Sines in even columns and cosines in odd ones (points, dim).
fn positions(points: usize, dim: usize) -> Result<Tensor> {
    let value = |i: usize| {
        let (place, column) = ((i / dim) as f64, i % dim);
        let angle = place * (-(1e4f64.ln()) / dim as f64 * (column - column % 2) as f64).exp();
        (if column % 2 == 0 {
            angle.sin()
        } else {
            angle.cos()
        }) as f32
    };
    Tensor::from_vec(
        (0..points * dim).map(value).collect(),
        (points, dim),
        &Device::Cpu,
    )
}

/// A post-norm transformer layer of PyTorch.
#[derive(Debug, Clone)]
struct Layer {
    attention: MultiheadAttention,
    linear: [Linear; 2],
    norms: [LayerNorm; 2],
}

impl Layer {
    fn take(weights: &mut Weights, name: &str, dim: usize) -> Result<Self> {
        Ok(Self {
            attention: MultiheadAttention::take(weights, &format!("{name}.self_attn"), dim, HEADS)?,
            linear: [
                weights.linear(&format!("{name}.linear1"), dim, 4 * dim)?,
                weights.linear(&format!("{name}.linear2"), 4 * dim, dim)?,
            ],
            norms: [
                weights.layer_norm(&format!("{name}.norm1"), dim)?,
                weights.layer_norm(&format!("{name}.norm2"), dim)?,
            ],
        })
    }

    fn forward(&self, x: &Tensor, hidden: &Tensor) -> Result<Tensor> {
        let ([first, second], [inner, outer]) = (&self.norms, &self.linear);
        let x = first.forward(&(x + self.attention.forward([x, x, x], Some(hidden))?)?)?;
        second.forward(&outer.forward_onto(&gelu(&inner.forward(&x)?)?, &x)?)
    }
}

/// Attention, and an MLP around which alone there is a residual; or with a residual around both.
#[derive(Debug, Clone)]
pub(crate) struct Block {
    attention: MultiheadAttention,
    norms: [LayerNorm; 2],
    mlp: [Linear; 2],
}

impl Block {
    pub(crate) fn take(
        weights: &mut Weights,
        name: &str,
        attention: &str,
        [dim, inner]: [usize; 2],
    ) -> Result<Self> {
        Ok(Self {
            attention: MultiheadAttention::take(
                weights,
                &format!("{name}.{attention}"),
                dim,
                HEADS,
            )?,
            norms: [
                weights.layer_norm(&format!("{name}.norm_1"), dim)?,
                weights.layer_norm(&format!("{name}.norm_2"), dim)?,
            ],
            mlp: [
                weights.linear(&format!("{name}.ffn.0"), dim, inner)?,
                weights.linear(&format!("{name}.ffn.3"), inner, dim)?,
            ],
        })
    }

    /// Queries that attend to a memory, without a residual around the attention.
    pub(crate) fn cross(&self, query: &Tensor, memory: &Tensor, bias: &Tensor) -> Result<Tensor> {
        self.attended(query, &self.memory(memory)?, bias)
    }

    /// A memory that several queries may attend to.
    pub(crate) fn memory(&self, memory: &Tensor) -> Result<PackedKeyValues> {
        self.attention.memory(memory, memory)
    }

    /// As [`Self::cross`].
    pub(crate) fn attended(
        &self,
        query: &Tensor,
        memory: &PackedKeyValues,
        bias: &Tensor,
    ) -> Result<Tensor> {
        self.normed(&self.attention.attended(query, memory, Some(bias))?)
    }

    /// Tokens that attend to each other.
    pub(crate) fn self_attended(&self, x: &Tensor, bias: &Tensor) -> Result<Tensor> {
        self.normed(&(x + self.attention.forward([x, x, x], Some(bias))?)?)
    }

    /// The result of the attention through both norms and the perceptron between them.
    fn normed(&self, attended: &Tensor) -> Result<Tensor> {
        let ([first, second], [inner, outer]) = (&self.norms, &self.mlp);
        let x = first.forward(attended)?;
        second.forward(&outer.forward_onto(&gelu(&inner.forward(&x)?)?, &x)?)
    }
}
