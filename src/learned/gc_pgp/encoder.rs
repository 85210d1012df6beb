//! Encodings of the ego, the agents and the lane graph.

use super::network::GcPgpInputs;
use crate::blocks::{Gru, Linear, MultiheadAttention, Probe, Weights, leaky_relu};
use candle_core::{D, DType, Device, Result, Tensor};

/// Width of an embedded step, and of an encoding.
const STEP: usize = 16;
pub(super) const WIDTH: usize = 32;
/// Columns of a step of the ego, of an agent with its type flag, and of a lane's pose with its red
/// flag.
const EGO: usize = 5;
const AGENT: usize = 6;
const POSE: usize = 8;
/// Rounds of attention in the lane graph.
const ROUNDS: usize = 2;

/// An affine layer and a recurrent one.
#[derive(Debug, Clone)]
struct Sequence {
    embed: Linear,
    encode: Gru,
}

impl Sequence {
    fn take(weights: &mut Weights, [embed, encode]: [&str; 2], inputs: usize) -> Result<Self> {
        Ok(Self {
            embed: weights.linear(embed, inputs, STEP)?,
            encode: Gru::take(weights, encode, STEP, WIDTH)?,
        })
    }

    /// (B, N, T, inputs) to (B, N, 32); the first rows are read, as many as are not missing.
    fn forward(&self, x: &Tensor, missing: Option<&Tensor>) -> Result<Tensor> {
        let (batch, count, steps, columns) = x.dims4()?;
        let embedded = leaky_relu(&self.embed.forward(&x.reshape((
            batch * count,
            steps,
            columns,
        ))?)?)?;
        let lengths = match missing {
            None => None,
            Some(missing) => {
                let rows = missing
                    .narrow(3, 0, 1)?
                    .reshape((batch * count, steps))?
                    .to_vec2::<f32>()?;
                Some(
                    rows.iter()
                        .map(|row| row.iter().filter(|&&missing| missing == 0.0).count())
                        .collect::<Vec<_>>(),
                )
            }
        };
        self.encode
            .last(&embedded, lengths.as_deref())?
            .reshape((batch, count, WIDTH))
    }
}

/// Projections of queries, keys and values, and attention with one head.
#[derive(Debug, Clone)]
struct Attention {
    embed: [Linear; 3],
    attention: MultiheadAttention,
}

impl Attention {
    fn take(weights: &mut Weights, name: &str, attention: &str) -> Result<Self> {
        let embed = ["query_emb", "key_emb", "val_emb"]
            .map(|part| weights.linear(&format!("{name}{part}"), WIDTH, WIDTH));
        let [query, key, value] = embed;
        Ok(Self {
            embed: [query?, key?, value?],
            attention: MultiheadAttention::take(weights, &format!("{name}{attention}"), WIDTH, 1)?,
        })
    }

    fn forward(&self, queries: &Tensor, keys: &Tensor, bias: &Tensor) -> Result<Tensor> {
        let [query, key, value] = &self.embed;
        let (query, key, value) = (
            query.forward(queries)?,
            key.forward(keys)?,
            value.forward(keys)?,
        );
        self.attention
            .forward([&query, &key, &value], Some(&bias.unsqueeze(1)?))
    }
}

#[derive(Debug, Clone)]
pub(super) struct Encoder {
    ego: Sequence,
    nodes: Sequence,
    agents: Sequence,
    near: Attention,
    mix: Linear,
    graph: Vec<Attention>,
}

/// What the rest of the network reads.
#[derive(Debug, Clone)]
pub struct Encodings {
    /// Of the ego (B, 32).
    pub ego: Tensor,
    /// Of the nodes (B, N, 32).
    pub nodes: Tensor,
}

impl Encoder {
    pub(super) fn take(weights: &mut Weights) -> Result<Self> {
        let graph =
            (0..ROUNDS).map(|i| Attention::take(weights, &format!("encoder.gat.{i}."), "att"));
        let graph = graph.collect::<Result<_>>()?;
        Ok(Self {
            graph,
            ego: Sequence::take(
                weights,
                ["encoder.target_agent_emb", "encoder.target_agent_enc"],
                EGO,
            )?,
            nodes: Sequence::take(weights, ["encoder.node_emb", "encoder.node_encoder"], POSE)?,
            agents: Sequence::take(weights, ["encoder.nbr_emb", "encoder.nbr_enc"], AGENT)?,
            near: Attention::take(weights, "encoder.", "a_n_att")?,
            mix: weights.linear("encoder.mix", 2 * WIDTH, WIDTH)?,
        })
    }

    pub(super) fn forward(&self, inputs: &GcPgpInputs, probe: &Probe) -> Result<Encodings> {
        let ego = self.ego.forward(&inputs.ego, None)?.squeeze(1)?;
        let poses = Tensor::cat(&[&inputs.poses, &inputs.red], D::Minus1)?;
        let nodes = self.nodes.forward(&poses, Some(&inputs.poses_missing))?;
        probe.note("node_gru", &nodes);
        let (batch, count, _) = nodes.dims3()?;
        let agents = inputs.agents.dim(1)?;
        let attended = if agents == 0 {
            // Without keys PyTorch's attention gives its output layer's bias; so does one key of
            // zeros whose value is zero.
            let nothing = Tensor::zeros((batch, count, WIDTH), DType::F32, &Device::Cpu)?;
            self.near.nothing(&nothing)?
        } else {
            let vehicle = inputs.agents.narrow(3, 0, 1)?.zeros_like()?;
            let steps = Tensor::cat(&[&inputs.agents, &vehicle], D::Minus1)?;
            let agents = self.agents.forward(&steps, Some(&inputs.agents_missing))?;
            self.near.forward(&nodes, &agents, &inputs.far)?
        };
        probe.note("agent_node_attention", &attended);
        let mixed = self
            .mix
            .forward(&Tensor::cat(&[nodes, attended], D::Minus1)?)?;
        probe.note("mix_linear", &mixed);
        let mut nodes = leaky_relu(&mixed)?;
        let bias = inputs.connected_bias()?;
        for (i, round) in self.graph.iter().enumerate() {
            let attended = round.forward(&nodes, &nodes, &bias)?;
            probe.note(&format!("gat{i}"), &attended);
            nodes = (nodes + attended)?;
        }
        Ok(Encodings { ego, nodes })
    }
}

impl Attention {
    /// The result where there is nothing to attend to.
    fn nothing(&self, like: &Tensor) -> Result<Tensor> {
        self.attention.output(&like.zeros_like()?)
    }
}
