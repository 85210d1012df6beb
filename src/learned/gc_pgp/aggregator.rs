//! The context of traversals through the lane graph.

use super::encoder::{Encodings, WIDTH};
use super::network::TRAVERSAL;
use crate::blocks::{Linear, MultiheadAttention, Weights};
use candle_core::{Device, Result, Tensor};
use planagent_kernels::matrix::{Instructions, Kernel, Simd};
use planagent_kernels::pointwise::exp_or_zero;
use rayon::prelude::*;

/// Width and heads of the attention.
const ATTENTION: usize = 128;
const HEADS: usize = 32;
const HEAD: usize = ATTENTION / HEADS;
/// Traversals that a thread computes at once.
const TASK_TRAVERSALS: usize = 64;
/// A row of all heads: the first number of each, the second of each, and so on.
type Row = [[f32; HEADS]; HEAD];
/// Width of a context.
pub(super) const CONTEXT: usize = WIDTH + ATTENTION;

/// Attention of the ego over the nodes of a traversal.
#[derive(Debug, Clone)]
pub(super) struct Aggregator {
    embed: [Linear; 3],
    attention: MultiheadAttention,
}

impl Aggregator {
    pub(super) fn take(weights: &mut Weights) -> Result<Self> {
        weights.skip("aggregator.pos_enc.inv_freq", &[WIDTH / 2])?;
        let mut embed =
            |part: &str| weights.linear(&format!("aggregator.{part}"), WIDTH, ATTENTION);
        let embed = [embed("query_emb")?, embed("key_emb")?, embed("val_emb")?];
        Ok(Self {
            embed,
            attention: MultiheadAttention::take(weights, "aggregator.mha", ATTENTION, HEADS)?,
        })
    }

    /// Contexts (B, S, 160) of the traversals in lexicographic order.
    pub(super) fn forward(
        &self,
        Encodings { ego, nodes }: &Encodings,
        traversals: &[Vec<[u32; TRAVERSAL]>],
    ) -> Result<Tensor> {
        let samples = traversals.iter().enumerate().map(|(sample, traversals)| {
            let (ego, nodes) = (ego.narrow(0, sample, 1)?, nodes.get(sample)?);
            let mut ordered = traversals.clone();
            ordered.sort_unstable();
            let mut unique = ordered.clone();
            unique.dedup();
            let contexts = self.contexts(&ego, &nodes, &unique)?;
            let place =
                |traversal: &[u32; TRAVERSAL]| unique.partition_point(|one| one < traversal) as u32;
            let places = Tensor::from_iter(ordered.iter().map(place), &Device::Cpu)?;
            contexts.index_select(&places, 0)
        });
        Tensor::stack(&samples.collect::<Result<Vec<_>>>()?, 0)
    }

    /// Contexts (S, 160) of traversals. Keys and values are affine in the sum of a node and its
    /// step. So those of nodes and of steps are computed once, and not for each traversal.
    fn contexts(
        &self,
        ego: &Tensor,
        nodes: &Tensor,
        traversals: &[[u32; TRAVERSAL]],
    ) -> Result<Tensor> {
        let rows = traversals.len();
        // The goal is a row of zeros behind the nodes.
        let padded = Tensor::cat(&[nodes, &nodes.narrow(0, 0, 1)?.zeros_like()?], 0)?;
        let steps = positions()?;
        let [query, key, value] = &self.embed;
        let query = self
            .attention
            .projected(0, &query.forward(ego)?)?
            .flatten_all()?
            .to_vec1::<f32>()?;
        let table = |part: usize, embed: &Linear| -> Result<[Tensor; 2]> {
            let project = |x: &Tensor| self.attention.projected(part, &embed.forward(x)?);
            let of_steps =
                project(&steps)?.broadcast_sub(&project(&steps.narrow(0, 0, 1)?.zeros_like()?)?)?;
            Ok([project(&padded)?, of_steps])
        };
        let [of_nodes, of_steps] = table(1, key)?;
        let (mut of_nodes, of_steps) = (
            logits(&query, &by_number(&of_nodes)?),
            logits(&query, &by_number(&of_steps)?),
        );
        if let Some(goal) = of_nodes.last_mut() {
            *goal = [f32::NEG_INFINITY; HEADS];
        }
        let [node_values, step_values] = table(2, value)?;
        let (node_values, step_values) = (by_number(&node_values)?, by_number(&step_values)?);
        let mut weighted_values = vec![0f32; rows * ATTENTION];
        let tasks = weighted_values
            .par_chunks_mut(TASK_TRAVERSALS * ATTENTION)
            .zip(traversals.par_chunks(TASK_TRAVERSALS));
        tasks.for_each(|(out, traversals)| {
            let kernel = TraversalAttention {
                logits: [&of_nodes, &of_steps],
                values: [&node_values, &step_values],
                traversals,
                out,
            };
            Instructions::best().run(kernel);
        });
        let weighted_values = Tensor::from_vec(weighted_values, (rows, ATTENTION), &Device::Cpu)?;
        let attended = self.attention.output(&weighted_values)?;
        let ego = ego.broadcast_as((rows, WIDTH))?.contiguous()?;
        Tensor::cat(&[ego, attended], 1)
    }
}

/// The numbers of rows (…, 128), those of all heads side by side.
fn by_number(rows: &Tensor) -> Result<Vec<Row>> {
    let rows = rows.flatten_all()?.to_vec1::<f32>()?;
    let row =
        |row: &[f32]| std::array::from_fn(|i| std::array::from_fn(|head| row[head * HEAD + i]));
    Ok(rows.chunks_exact(ATTENTION).map(row).collect())
}

/// The scaled products of a query with each key, by head.
fn logits(query: &[f32], keys: &[Row]) -> Vec<[f32; HEADS]> {
    let scale = 1.0 / (HEAD as f32).sqrt();
    let of_head = |key: &Row, head: usize| {
        (0..HEAD)
            .map(|i| query[head * HEAD + i] * key[i][head])
            .sum::<f32>()
    };
    keys.iter()
        .map(|key| std::array::from_fn(|head| scale * of_head(key, head)))
        .collect()
}

/// Attention of a query to the steps of each traversal: the values of its nodes and steps, weighted
/// by the softmax of their logits.
struct TraversalAttention<'a> {
    logits: [&'a [[f32; HEADS]]; 2],
    values: [&'a [Row]; 2],
    traversals: &'a [[u32; TRAVERSAL]],
    /// A row of all heads for each traversal.
    out: &'a mut [f32],
}

impl Kernel for TraversalAttention<'_> {
    #[inline(always)]
    #[allow(
        clippy::inline_always,
        reason = "kernels must be inlined into the functions that enable the instructions"
    )]
    fn run<S: Simd>(self, _: S) {
        let ([of_nodes, of_steps], [node_values, step_values]) = (self.logits, self.values);
        let goal = of_nodes.len() - 1;
        for (out, traversal) in self.out.chunks_exact_mut(ATTENTION).zip(self.traversals) {
            let nodes = traversal.map(|node| goal.min(node as usize));
            // Heads are the innermost dimension everywhere, so that inner loops are vector
            // operations.
            let mut shares = [[0f32; HEADS]; TRAVERSAL];
            let mut largest = [f32::NEG_INFINITY; HEADS];
            for ((shares, &node), step) in shares.iter_mut().zip(&nodes).zip(of_steps) {
                for head in 0..HEADS {
                    shares[head] = of_nodes[node][head] + step[head];
                    largest[head] = if shares[head] > largest[head] {
                        shares[head]
                    } else {
                        largest[head]
                    };
                }
            }
            let mut sums = [0f32; HEADS];
            for shares in &mut shares {
                for head in 0..HEADS {
                    shares[head] = exp_or_zero(shares[head] - largest[head]);
                    sums[head] += shares[head];
                }
            }
            let mut mixed = [[0f32; HEADS]; HEAD];
            for ((shares, &node), step) in shares.iter().zip(&nodes).zip(step_values) {
                for ((mixed, node), step) in mixed.iter_mut().zip(&node_values[node]).zip(step) {
                    for head in 0..HEADS {
                        mixed[head] += shares[head] * (node[head] + step[head]);
                    }
                }
            }
            for (i, out) in out.iter_mut().enumerate() {
                *out = mixed[i % HEAD][i / HEAD] / sums[i / HEAD];
            }
        }
    }
}

/// Sines and cosines of the step's number (16, 32).
fn positions() -> Result<Tensor> {
    let value = |i: usize| {
        let (step, column) = ((i / WIDTH) as f64, i % WIDTH);
        let angle = step * 1e4f64.powf(-((column - column % 2) as f64) / WIDTH as f64);
        (if column % 2 == 0 {
            angle.sin()
        } else {
            angle.cos()
        }) as f32
    };
    Tensor::from_vec(
        (0..TRAVERSAL * WIDTH).map(value).collect(),
        (TRAVERSAL, WIDTH),
        &Device::Cpu,
    )
}
