//! PlanTF's network (`jchengai/planTF` `planning_model.py`, `modules/`).

use super::history_encoder::HistoryEncoder;
use super::map_encoder::MapEncoder;
use crate::blocks::{
    LayerNorm, Linear, Mlp, MultiheadAttention, Probe, Weights, gelu, key_bias, relu,
};
use candle_core::{D, DType, Result, Tensor};

/// Samples of the history, 0.1 s apart, the present included.
pub(super) const HISTORY: usize = 21;
/// Poses of the plan, 0.1 s apart.
pub(super) const POSES: usize = 80;
/// Quantities of the ego's present state that the network reads.
const STATE: usize = 6;
/// Heads of the attention over the ego's state.
const STATE_HEADS: usize = 4;
/// Object categories.
const CATEGORIES: usize = 4;

/// Widths and counts of a PlanTF.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PlanTfConfig {
    /// Width of a token.
    pub dim: usize,
    /// Transformer layers.
    pub depth: usize,
    /// Heads of each.
    pub heads: usize,
    /// Modes of the plan.
    pub modes: usize,
}

impl PlanTfConfig {
    /// The published model.
    pub const PUBLISHED: Self = Self {
        dim: 128,
        depth: 4,
        heads: 8,
        modes: 6,
    };
}

/// Inputs of a batch. Floats are f32, masks u8, indices u32; the frame is that of the rear axle
/// now.
#[derive(Debug, Clone)]
pub struct PlanTfInputs {
    /// (B, 7): x, y, heading, speed, acceleration, steering angle, yaw rate.
    pub current_state: Tensor,
    /// Positions of the ego and the agents (B, A, 21, 2).
    pub position: Tensor,
    /// Headings (B, A, 21).
    pub heading: Tensor,
    /// Velocities (B, A, 21, 2).
    pub velocity: Tensor,
    /// Width and length (B, A, 21, 2).
    pub shape: Tensor,
    /// Categories (B, A).
    pub category: Tensor,
    /// Whether an agent was seen (B, A, 21).
    pub valid: Tensor,
    /// The map.
    pub map: PlanTfMap,
}

/// The polygons of a batch, at least one; of the three lines only the center line is read.
#[derive(Debug, Clone)]
pub struct PlanTfMap {
    /// Points of the center lines (B, M, 20, 2).
    pub point: Tensor,
    /// Vectors to the next points (B, M, 20, 2).
    pub vector: Tensor,
    /// Their directions (B, M, 20).
    pub orientation: Tensor,
    /// Centers with direction (B, M, 3).
    pub center: Tensor,
    /// Lane, connector, crosswalk (B, M).
    pub kind: Tensor,
    /// Whether a polygon is on the route (B, M), as an index.
    pub on_route: Tensor,
    /// Green, yellow, red, unknown (B, M).
    pub light: Tensor,
    /// Speed limits (B, M).
    pub speed_limit: Tensor,
    /// Whether there is one (B, M).
    pub has_speed_limit: Tensor,
    /// Whether a point is inside the map's square (B, M, 20).
    pub valid: Tensor,
}

/// Outputs of a batch.
#[derive(Debug, Clone)]
pub struct PlanTfOutputs {
    /// Plans (B, modes, 80, 4): x, y, cosine and sine of the heading.
    pub trajectory: Tensor,
    /// Logits of the modes (B, modes).
    pub probability: Tensor,
    /// Predicted positions of the agents (B, A − 1, 80, 2).
    pub prediction: Tensor,
}

/// PlanTF.
#[derive(Debug, Clone)]
pub struct PlanTf {
    config: PlanTfConfig,
    position: Mlp,
    history: HistoryEncoder,
    state: StateAttention,
    category: Tensor,
    map: MapEncoder,
    layers: Vec<Layer>,
    norm: LayerNorm,
    decoder: Decoder,
    predictor: Head,
}

impl PlanTf {
    /// Takes the parameters.
    ///
    /// # Errors
    /// When a tensor cannot be converted.
    pub fn take(weights: &mut Weights, config: PlanTfConfig) -> Result<Self> {
        let PlanTfConfig { dim, depth, .. } = config;
        Ok(Self {
            config,
            position: Mlp::take(weights, &names("pos_emb", [0, 2]), &[4, dim, dim])?,
            history: HistoryEncoder::take(weights, "agent_encoder.history_encoder", dim)?,
            state: StateAttention::take(weights, "agent_encoder.ego_state_emb", dim)?,
            category: weights.take("agent_encoder.type_emb.weight", &[CATEGORIES, dim])?,
            map: MapEncoder::take(weights, "map_encoder", dim)?,
            layers: (0..depth)
                .map(|i| Layer::take(weights, &format!("encoder_blocks.{i}"), config))
                .collect::<Result<_>>()?,
            norm: weights.layer_norm("norm", dim)?,
            decoder: Decoder::take(weights, config)?,
            predictor: Head::take(weights, "agent_predictor", [dim, 2 * dim, 2 * POSES], false)?,
        })
    }

    /// Plans and predictions.
    ///
    /// # Errors
    /// When an input has another shape.
    pub fn forward(&self, inputs: &PlanTfInputs, probe: &Probe) -> Result<PlanTfOutputs> {
        let PlanTfInputs {
            position,
            heading,
            valid,
            map,
            ..
        } = inputs;
        let (batch, agents, steps, _) = position.dims4()?;
        let present = |x: &Tensor| x.narrow(2, steps - 1, 1)?.squeeze(2);
        let place = Tensor::cat(&[present(position)?, map.center.narrow(2, 0, 2)?], 1)?;
        let angle = Tensor::cat(
            &[present(heading)?, map.center.narrow(2, 2, 1)?.squeeze(2)?],
            1,
        )?
        .unsqueeze(2)?;
        let embedded = self
            .position
            .forward(&Tensor::cat(&[place, angle.cos()?, angle.sin()?], 2)?)?;
        probe.note("pos_emb", &embedded);
        let seen = valid.max(D::Minus1)?;
        let hidden = key_bias(&Tensor::cat(&[seen, map.valid.max(D::Minus1)?], 1)?)?;
        let (agents_tokens, map_tokens) = rayon::join(
            || self.agents(inputs, probe),
            || self.map.forward(map, "map_encoder", probe),
        );
        let mut x = (Tensor::cat(&[agents_tokens?, map_tokens?], 1)? + embedded)?;
        for (i, layer) in self.layers.iter().enumerate() {
            x = layer.forward(&x, &hidden)?;
            probe.note(&format!("encoder_blocks.{i}"), &x);
        }
        let x = self.norm.forward(&x)?;
        probe.note("norm", &x);
        let (trajectory, probability) = self
            .decoder
            .forward(&x.narrow(1, 0, 1)?.squeeze(1)?, self.config)?;
        let others = x.narrow(1, 1, agents - 1)?;
        // The ego alone: the predictor would get a tensor without rows.
        let prediction = match agents {
            1 => Tensor::zeros((batch, 0, POSES, 2), DType::F32, x.device())?,
            _ => self
                .predictor
                .forward(&others)?
                .reshape((batch, agents - 1, POSES, 2))?,
        };
        Ok(PlanTfOutputs {
            trajectory,
            probability,
            prediction,
        })
    }

    /// Tokens of the ego and the agents (B, A, dim).
    fn agents(&self, inputs: &PlanTfInputs, probe: &Probe) -> Result<Tensor> {
        let (batch, agents, _) = inputs.heading.dims3()?;
        let dim = self.config.dim;
        let encoded = self
            .history
            .forward(inputs, "agent_encoder.history_encoder", probe)?;
        let encoded = encoded.reshape((batch, agents, dim))?;
        let ego = self
            .state
            .forward(&inputs.current_state.narrow(1, 0, STATE)?)?;
        probe.note("agent_encoder.ego_state_emb", &ego);
        let ego = ego.unsqueeze(1)?;
        let tokens = match agents {
            1 => ego,
            _ => Tensor::cat(&[ego, encoded.narrow(1, 1, agents - 1)?], 1)?,
        };
        let category = self
            .category
            .index_select(&inputs.category.flatten_all()?, 0)?;
        let tokens = (tokens + category.reshape((batch, agents, dim))?)?;
        probe.note("agent_encoder", &tokens);
        Ok(tokens)
    }
}

/// `NAME.i` for each number.
pub(super) fn names<const N: usize>(name: &str, numbers: [usize; N]) -> [String; N] {
    numbers.map(|i| format!("{name}.{i}"))
}

/// One token of the ego's present state, by attention over its quantities.
#[derive(Debug, Clone)]
struct StateAttention {
    quantities: Vec<Linear>,
    position: Tensor,
    query: Tensor,
    attention: MultiheadAttention,
}

impl StateAttention {
    fn take(weights: &mut Weights, name: &str, dim: usize) -> Result<Self> {
        let position = weights.take(&format!("{name}.pos_embed"), &[1, STATE, dim])?;
        let query = weights.take(&format!("{name}.query"), &[1, 1, dim])?;
        let quantities = (0..STATE).map(|i| weights.linear(&format!("{name}.linears.{i}"), 1, dim));
        let quantities = quantities.collect::<Result<_>>()?;
        let attention =
            MultiheadAttention::take(weights, &format!("{name}.attn"), dim, STATE_HEADS)?;
        Ok(Self {
            quantities,
            position,
            query,
            attention,
        })
    }

    fn forward(&self, state: &Tensor) -> Result<Tensor> {
        let embed = |(i, layer): (usize, &Linear)| layer.forward(&state.narrow(1, i, 1)?);
        let embedded: Vec<Tensor> = self
            .quantities
            .iter()
            .enumerate()
            .map(embed)
            .collect::<Result<_>>()?;
        let embedded = Tensor::stack(&embedded, 1)?.broadcast_add(&self.position)?;
        let batch = state.dim(0)?;
        let query = self.query.repeat((batch, 1, 1))?;
        self.attention
            .forward([&query, &embedded, &embedded], None)?
            .squeeze(1)
    }
}

/// A pre-norm transformer layer.
#[derive(Debug, Clone)]
struct Layer {
    norms: [LayerNorm; 2],
    attention: MultiheadAttention,
    mlp: [Linear; 2],
}

impl Layer {
    fn take(
        weights: &mut Weights,
        name: &str,
        PlanTfConfig { dim, heads, .. }: PlanTfConfig,
    ) -> Result<Self> {
        Ok(Self {
            attention: MultiheadAttention::take(weights, &format!("{name}.attn"), dim, heads)?,
            norms: [
                weights.layer_norm(&format!("{name}.norm1"), dim)?,
                weights.layer_norm(&format!("{name}.norm2"), dim)?,
            ],
            mlp: [
                weights.linear(&format!("{name}.mlp.fc1"), dim, 4 * dim)?,
                weights.linear(&format!("{name}.mlp.fc2"), 4 * dim, dim)?,
            ],
        })
    }

    fn forward(&self, x: &Tensor, hidden: &Tensor) -> Result<Tensor> {
        let [first, second] = &self.norms;
        let normed = first.forward(x)?;
        let x = (x + self
            .attention
            .forward([&normed, &normed, &normed], Some(hidden))?)?;
        let [inner, outer] = &self.mlp;
        outer.forward_onto(&gelu(&inner.forward(&second.forward(&x)?)?)?, &x)
    }
}

/// Affine, norm, ReLU, affine.
#[derive(Debug, Clone)]
struct Head {
    first: Linear,
    norm: LayerNorm,
    last: Linear,
}

impl Head {
    fn take(
        weights: &mut Weights,
        name: &str,
        [inputs, inner, outputs]: [usize; 3],
        bias: bool,
    ) -> Result<Self> {
        let [first, norm, last] = names(name, [0, 1, 3]);
        Ok(Self {
            first: if bias {
                weights.linear(&first, inputs, inner)?
            } else {
                weights.linear_without_bias(&first, inputs, inner)?
            },
            norm: weights.layer_norm(&norm, inner)?,
            last: weights.linear(&last, inner, outputs)?,
        })
    }

    fn forward(&self, x: &Tensor) -> Result<Tensor> {
        self.last
            .forward(&relu(&self.norm.forward(&self.first.forward(x)?)?)?)
    }
}

/// Plans of all modes from the ego's token.
#[derive(Debug, Clone)]
struct Decoder {
    modes: Linear,
    trajectory: Head,
    probability: Head,
}

impl Decoder {
    fn take(weights: &mut Weights, PlanTfConfig { dim, modes, .. }: PlanTfConfig) -> Result<Self> {
        Ok(Self {
            modes: weights.linear("trajectory_decoder.multimodal_proj", dim, modes * dim)?,
            trajectory: Head::take(
                weights,
                "trajectory_decoder.loc",
                [dim, 2 * dim, 4 * POSES],
                true,
            )?,
            probability: Head::take(weights, "trajectory_decoder.pi", [dim, 2 * dim, 1], true)?,
        })
    }

    fn forward(
        &self,
        ego: &Tensor,
        PlanTfConfig { dim, modes, .. }: PlanTfConfig,
    ) -> Result<(Tensor, Tensor)> {
        let x = self.modes.forward(ego)?.reshape(((), modes, dim))?;
        let trajectory = self
            .trajectory
            .forward(&x)?
            .reshape(((), modes, POSES, 4))?;
        Ok((trajectory, self.probability.forward(&x)?.squeeze(2)?))
    }
}
