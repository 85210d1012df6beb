//! The context of traversals through the lane graph.

use super::encoder::{Encodings, WIDTH};
use super::network::TRAVERSAL;
use crate::planner::learned::blocks::{Linear, MultiheadAttention, Weights};
use candle_core::{Device, Result, Tensor};

/// Width and heads of the attention.
const ATTENTION: usize = 128;
const HEADS: usize = 32;
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
        let mut embed = |part: &str| Linear::take(weights, &format!("aggregator.{part}"), WIDTH, ATTENTION);
        let embed = [embed("query_emb")?, embed("key_emb")?, embed("val_emb")?];
        Ok(Self { embed, attention: MultiheadAttention::take(weights, "aggregator.mha", ATTENTION, HEADS)? })
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
            let place = |traversal: &[u32; TRAVERSAL]| unique.partition_point(|one| one < traversal) as u32;
            let places = Tensor::from_iter(ordered.iter().map(place), &Device::Cpu)?;
            contexts.index_select(&places, 0)
        });
        Tensor::stack(&samples.collect::<Result<Vec<_>>>()?, 0)
    }

    fn contexts(&self, ego: &Tensor, nodes: &Tensor, traversals: &[[u32; TRAVERSAL]]) -> Result<Tensor> {
        let (nodes_count, rows) = (nodes.dim(0)?, traversals.len());
        // The goal is a row of zeros behind the nodes.
        let padded = Tensor::cat(&[nodes, &nodes.narrow(0, 0, 1)?.zeros_like()?], 0)?;
        let places = traversals.iter().flatten().map(|&node| node.min(nodes_count as u32));
        let places: Vec<u32> = places.collect();
        let hidden = places.iter().map(|&node| if node as usize == nodes_count { f32::NEG_INFINITY } else { 0.0 });
        let hidden = Tensor::from_iter(hidden, &Device::Cpu)?.reshape((rows, 1, 1, TRAVERSAL))?;
        let places = Tensor::from_vec(places, rows * TRAVERSAL, &Device::Cpu)?;
        let path = padded.index_select(&places, 0)?.reshape((rows, TRAVERSAL, WIDTH))?;
        let path = path.broadcast_add(&positions()?)?;
        let [query, key, value] = &self.embed;
        let query = query.forward(ego)?.unsqueeze(0)?.broadcast_as((rows, 1, ATTENTION))?.contiguous()?;
        let mixed = self.attention.forward([&query, &key.forward(&path)?, &value.forward(&path)?], Some(&hidden))?;
        let own = ego.broadcast_as((rows, WIDTH))?.contiguous()?;
        Tensor::cat(&[own, mixed.squeeze(1)?], 1)
    }
}

/// Sines and cosines of the step's number (16, 32).
fn positions() -> Result<Tensor> {
    let value = |i: usize| {
        let (step, column) = ((i / WIDTH) as f64, i % WIDTH);
        let angle = step * 1e4f64.powf(-((column - column % 2) as f64) / WIDTH as f64);
        (if column % 2 == 0 { angle.sin() } else { angle.cos() }) as f32
    };
    Tensor::from_vec((0..TRAVERSAL * WIDTH).map(value).collect(), (TRAVERSAL, WIDTH), &Device::Cpu)
}
