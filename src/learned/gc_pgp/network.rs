//! The policy over the lane graph and the decoder of trajectories.

use super::aggregator::{Aggregator, CONTEXT};
use super::encoder::{Encoder, Encodings, WIDTH};
use crate::blocks::{Linear, Probe, Weights, leaky_relu};
use candle_core::{D, DType, Device, Result, Tensor};

/// Steps of a traversal.
pub(super) const TRAVERSAL: usize = 16;
/// Poses of a trajectory, 0.5 s apart.
pub(super) const POSES: usize = 16;
/// Numbers of a latent sample.
pub(super) const LATENT: usize = 5;
/// Width of the decoder.
const HIDDEN: usize = 128;
/// Edge types in the table of successors.
const SUCCESSOR: f64 = 1.0;
const PROXIMAL: f64 = 2.0;

/// Inputs of a batch, f32; in masks of missing things 1 is missing.
#[derive(Debug, Clone)]
pub struct GcPgpInputs {
    /// The ego's steps (B, 1, 6, 5).
    pub ego: Tensor,
    /// The agents' steps (B, A, 6, 5).
    pub agents: Tensor,
    /// Which of these are missing (B, A, 6, 5).
    pub agents_missing: Tensor,
    /// 1 for an agent that is not near a node (B, N, A).
    pub far: Tensor,
    /// The poses of the nodes (B, N, 20, 7).
    pub poses: Tensor,
    /// Which of these are missing (B, N, 20, 7).
    pub poses_missing: Tensor,
    /// Whether a node's light is red (B, N, 20, 1).
    pub red: Tensor,
    /// The nodes that each leads to (B, N, K + 1); the last column is the goal.
    pub successors: Tensor,
    /// The types of these edges (B, N, K + 1): 1 successor, 2 proximal, 3 goal, 0 none.
    pub edges: Tensor,
    /// Which of these edges stay on the route (B, N, K + 1).
    pub on_route: Tensor,
}

impl GcPgpInputs {
    /// The nodes that edges lead to, as indices; an edge that is none leads to its own node.
    fn targets(&self) -> Result<Vec<Vec<Vec<usize>>>> {
        let (successors, edges) = (
            self.successors.to_vec3::<f32>()?,
            self.edges.to_vec3::<f32>()?,
        );
        let target = |own: usize, successor: f32, edge: f32| {
            if edge == 0.0 { own } else { successor as usize }
        };
        let row = |own: usize, row: &Vec<f32>, edges: &Vec<f32>| -> Vec<usize> {
            row.iter()
                .zip(edges)
                .map(|(&successor, &edge)| target(own, successor, edge))
                .collect()
        };
        let sample = |(rows, edges): (&Vec<Vec<f32>>, &Vec<Vec<f32>>)| -> Vec<Vec<usize>> {
            rows.iter()
                .zip(edges)
                .enumerate()
                .map(|(own, (successors, edges))| row(own, successors, edges))
                .collect()
        };
        Ok(successors.iter().zip(&edges).map(sample).collect())
    }

    /// 0 between nodes that an edge joins in either direction and on the diagonal, −∞ elsewhere (B,
    /// N, N).
    pub(super) fn connected_bias(&self) -> Result<Tensor> {
        let (batch, nodes, _) = self.edges.dims3()?;
        let mut bias = vec![f32::NEG_INFINITY; batch * nodes * nodes];
        for (sample, rows) in self.targets()?.iter().enumerate() {
            let place = |a: usize, b: usize| (sample * nodes + a) * nodes + b;
            for (own, targets) in rows.iter().enumerate() {
                bias[place(own, own)] = 0.0;
                for &target in targets
                    .iter()
                    .take(targets.len().saturating_sub(1))
                    .filter(|&&target| target < nodes)
                {
                    bias[place(own, target)] = 0.0;
                    bias[place(target, own)] = 0.0;
                }
            }
        }
        Tensor::from_vec(bias, (batch, nodes, nodes), &Device::Cpu)
    }
}

/// What the network makes of a scene before it draws traversals.
#[derive(Debug, Clone)]
pub struct GcPgpScene {
    /// Encodings of the ego and the nodes.
    pub encodings: Encodings,
    /// Probability of each edge and the goal (B, N, K + 1).
    pub policy: Tensor,
}

/// GC-PGP without its random draws.
#[derive(Debug, Clone)]
pub struct GcPgp {
    encoder: Encoder,
    edge: [Linear; 3],
    goal: [Linear; 3],
    aggregator: Aggregator,
    hidden: Linear,
    output: Linear,
}

impl GcPgp {
    /// Takes the parameters.
    ///
    /// # Errors
    /// When a tensor cannot be converted.
    pub fn take(weights: &mut Weights) -> Result<Self> {
        let encoder = Encoder::take(weights)?;
        // Both policies have the same layers; only names and inputs differ.
        let mut layers = |names: [&str; 3], inputs: usize| -> Result<[Linear; 3]> {
            let [first, second, last] = names;
            Ok([
                weights.linear(first, inputs, WIDTH)?,
                weights.linear(second, WIDTH, WIDTH)?,
                weights.linear(last, WIDTH, 1)?,
            ])
        };
        let edge = layers(
            ["aggregator.pi_h1", "aggregator.pi_h2", "aggregator.pi_op"],
            3 * WIDTH + 2,
        )?;
        let goal = layers(
            [
                "aggregator.pi_h1_goal",
                "aggregator.pi_h2_goal",
                "aggregator.pi_op_goal",
            ],
            2 * WIDTH,
        )?;
        let aggregator = Aggregator::take(weights)?;
        Ok(Self {
            encoder,
            edge,
            goal,
            aggregator,
            hidden: weights.linear("decoder.hidden", CONTEXT + LATENT, HIDDEN)?,
            output: weights.linear("decoder.op_traj", HIDDEN, 2 * POSES)?,
        })
    }

    /// Encodings and policy; with `route_only`, edges off the route have probability 0.
    ///
    /// # Errors
    /// When an input has another shape.
    pub fn encode(
        &self,
        inputs: &GcPgpInputs,
        route_only: bool,
        probe: &Probe,
    ) -> Result<GcPgpScene> {
        let encodings = self.encoder.forward(inputs, probe)?;
        let policy = self.policy(inputs, &encodings, route_only)?;
        Ok(GcPgpScene { encodings, policy })
    }

    fn policy(
        &self,
        inputs: &GcPgpInputs,
        Encodings { ego, nodes }: &Encodings,
        route_only: bool,
    ) -> Result<Tensor> {
        let (batch, count, width) = nodes.dims3()?;
        let choices = inputs.edges.dim(2)?;
        let targets = inputs.targets()?;
        let places = targets.iter().enumerate().flat_map(|(sample, rows)| {
            let first = sample * count;
            rows.iter().flat_map(move |row| {
                row.iter()
                    .take(row.len() - 1)
                    .map(move |&target| (first + target) as u32)
            })
        });
        let places = Tensor::from_iter(places, &Device::Cpu)?;
        let neighbors = (batch, count, choices - 1, width);
        let target = nodes
            .reshape((batch * count, width))?
            .index_select(&places, 0)?
            .reshape(neighbors)?;
        let source = nodes.unsqueeze(2)?.broadcast_as(neighbors)?.contiguous()?;
        let own = ego
            .reshape((batch, 1, 1, width))?
            .broadcast_as(neighbors)?
            .contiguous()?;
        let kinds = inputs.edges.narrow(2, 0, choices - 1)?;
        let flag = |kind: f64| kinds.eq(kind)?.to_dtype(DType::F32)?.unsqueeze(3);
        let edge = Tensor::cat(&[own, source, target, flag(SUCCESSOR)?, flag(PROXIMAL)?], 3)?;
        let beside = ego
            .unsqueeze(1)?
            .broadcast_as(nodes.shape())?
            .contiguous()?;
        let goal = Tensor::cat(&[&beside, nodes], 2)?;
        let edges = scored(&self.edge, &edge)?.squeeze(D::Minus1)?;
        let logits = Tensor::cat(&[edges, scored(&self.goal, &goal)?], 2)?;
        let exists = inputs.edges.ne(0.0)?.to_dtype(DType::F32)?;
        let (logits, mask) = if route_only {
            ((logits * &inputs.on_route)?, (exists * &inputs.on_route)?)
        } else {
            (logits, exists)
        };
        let raised = (logits.exp()? * &mask)?;
        let sum = raised.sum_keepdim(D::Minus1)?;
        let open = sum.gt(0.0)?.to_dtype(DType::F32)?;
        let shares = raised.broadcast_div(&(&sum + open.affine(-1.0, 1.0)?)?)?;
        // Where nothing is open, the goal is certain.
        let closed = open.affine(-1.0, 1.0)?;
        let none = Tensor::zeros((batch, count, choices - 1), DType::F32, &Device::Cpu)?;
        shares + Tensor::cat(&[none, closed], 2)?
    }

    /// The context of each traversal (B, S, 160): node indices, or at least N for the goal. The
    /// traversals are put in order first.
    ///
    /// # Errors
    /// When an input has another shape.
    pub fn aggregate(
        &self,
        encodings: &Encodings,
        traversals: &[Vec<[u32; TRAVERSAL]>],
    ) -> Result<Tensor> {
        self.aggregator.forward(encodings, traversals)
    }

    /// Trajectories (B, S, 16, 2) of contexts (B, S, 160) and latent samples (B, S, 5).
    ///
    /// # Errors
    /// When an input has another shape.
    pub fn decode(&self, context: &Tensor, latent: &Tensor) -> Result<Tensor> {
        let (batch, samples, _) = context.dims3()?;
        let hidden = leaky_relu(&self.hidden.forward(&Tensor::cat(&[context, latent], 2)?)?)?;
        self.output
            .forward(&hidden)?
            .reshape((batch, samples, POSES, 2))
    }
}

fn scored([first, second, last]: &[Linear; 3], x: &Tensor) -> Result<Tensor> {
    last.forward(&leaky_relu(
        &second.forward(&leaky_relu(&first.forward(x)?)?)?,
    )?)
}
