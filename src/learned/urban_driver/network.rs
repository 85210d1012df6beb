//! UrbanDriver's network (nuplan-devkit `urban_driver_open_loop_model.py`).

use super::elements::{Elements, KINDS, POINTS};
use crate::blocks::{
    GroupLinear, LayerNorm, Linear, Mlp, MultiheadAttention, Probe, Weights, key_bias,
    largest_where, relu,
};
use candle_core::{D, Device, Result, Tensor};
use rayon::prelude::*;

/// Poses of the plan, 0.5 s apart.
pub(super) const POSES: usize = 16;
/// Columns of a point.
const COLUMNS: usize = 8;
/// Heads of the attention between elements.
const HEADS: usize = 8;
/// Longest element of the table of point positions.
const POSITIONS: usize = 5000;
/// Elements whose layers are computed one after the other, while their points are in the
/// second-level cache.
const CACHED_ELEMENTS: usize = 12;
/// Rows of the table of element kinds; the last is unused.
const KIND_ROWS: usize = 11;
/// ε of the normalization of elements (PyTorch's `normalize`).
const NORM_EPSILON: f64 = 1e-12;

/// Width and depth of an UrbanDriver.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct UrbanDriverConfig {
    /// Width of an element.
    pub embedding: usize,
    /// Layers that mix the points of an element.
    pub layers: usize,
}

impl UrbanDriverConfig {
    /// The published model.
    pub const PUBLISHED: Self = Self {
        embedding: 256,
        layers: 3,
    };
}

/// UrbanDriver, trained in open loop.
#[derive(Debug, Clone)]
pub struct UrbanDriver {
    width: usize,
    points: Linear,
    kinds: Tensor,
    layers: Vec<SubgraphLayer>,
    attention: MultiheadAttention,
    output: Mlp,
}

impl UrbanDriver {
    /// Takes the parameters.
    ///
    /// # Errors
    /// When a tensor cannot be converted.
    pub fn take(weights: &mut Weights, config: UrbanDriverConfig) -> Result<Self> {
        let width = config.embedding;
        weights.skip(
            "positional_embedding.static_embedding",
            &[POSITIONS, 1, width],
        )?;
        let layers = (0..config.layers)
            .map(|i| SubgraphLayer::take(weights, &format!("local_subgraph.layers.{i}"), width));
        let layers = layers.collect::<Result<_>>()?;
        let outputs = [0, 1, 2].map(|i| format!("global_head.output_embed.layers.{i}"));
        Ok(Self {
            width,
            layers,
            points: weights.linear("feature_embedding", COLUMNS, width)?,
            kinds: weights.take("type_embedding.embedding.weight", &[KIND_ROWS, width])?,
            attention: MultiheadAttention::take(weights, "global_head.encoder", width, HEADS)?,
            output: Mlp::take(weights, &outputs, &[width, 4 * width, 4 * width, 3 * POSES])?,
        })
    }

    /// The plans (B, 16, 3) of a batch of elements.
    ///
    /// # Errors
    /// When an input has another shape.
    pub fn forward(&self, elements: &Elements, probe: &Probe) -> Result<Tensor> {
        let Elements {
            points,
            available,
            counts,
        } = elements;
        let (batch, rows, length, _) = points.dims4()?;
        probe.note_with("feature_embedding", || self.points.forward(points))?;
        let seen = available.max(D::Minus1)?;
        let x = self.subgraphs(
            &points.reshape((batch * rows, length, COLUMNS))?,
            available,
            &seen,
        )?;
        let x = x.reshape((batch, rows, self.width))?;
        probe.note("local_subgraph", &x);
        let norm = x
            .sqr()?
            .sum_keepdim(D::Minus1)?
            .sqrt()?
            .maximum(NORM_EPSILON)?;
        let x = (x.broadcast_div(&norm)? * (self.width as f64).sqrt())?;
        let kinds = counts
            .iter()
            .zip(KINDS)
            .flat_map(|(&count, kind)| vec![kind; count]);
        let kinds = self
            .kinds
            .index_select(&Tensor::from_iter(kinds, &Device::Cpu)?, 0)?;
        probe.note("type_embedding", &kinds);
        let ego = x.narrow(1, 0, 1)?;
        // The ego counts as seen in any case: attention without a key has no result.
        let own = Tensor::ones((batch, 1), seen.dtype(), &Device::Cpu)?;
        let hidden = key_bias(&Tensor::cat(&[own, seen.narrow(1, 1, rows - 1)?], 1)?)?;
        let mixed = self
            .attention
            .forward([&ego, &x.broadcast_add(&kinds)?, &x], Some(&hidden))?;
        probe.note("attention", &mixed);
        self.output
            .forward(&mixed.squeeze(1)?)?
            .reshape((batch, POSES, 3))
    }

    /// Elements (N, width) of points (N, P, 8); zeros where no point is available.
    fn subgraphs(&self, points: &Tensor, available: &Tensor, seen: &Tensor) -> Result<Tensor> {
        let (rows, length, _) = points.dims3()?;
        let seen = seen.flatten_all()?.to_vec1::<u8>()?;
        let places: Vec<u32> = (0u32..)
            .zip(&seen)
            .filter(|&(_, &seen)| seen != 0)
            .map(|(i, _)| i)
            .collect();
        let zeros = Tensor::zeros((rows, self.width), points.dtype(), &Device::Cpu)?;
        if places.is_empty() {
            return Ok(zeros);
        }
        let available = available.reshape((rows, length))?;
        let positions = positions(length, self.width)?;
        let piece = |places: &[u32]| {
            let places = Tensor::new(places, &Device::Cpu)?;
            let positions = positions.broadcast_as((places.elem_count(), length, self.width))?;
            let mut x = self
                .points
                .forward_onto(&points.index_select(&places, 0)?, &positions)?;
            let available = available.index_select(&places, 0)?;
            for layer in &self.layers {
                x = layer.forward(&x, &available)?;
            }
            largest_where(&x, &available, f32::NEG_INFINITY)
        };
        // Pieces stay in the cache through all layers, and threads share them.
        let pieces = places
            .par_chunks(CACHED_ELEMENTS)
            .map(piece)
            .collect::<Result<Vec<_>>>()?;
        zeros.index_add(
            &Tensor::from_iter(places, &Device::Cpu)?,
            &Tensor::cat(&pieces, 0)?,
            0,
        )
    }
}

/// The sinusoidal embedding of the places of points (P, width).
fn positions(length: usize, width: usize) -> Result<Tensor> {
    debug_assert_eq!(length, POINTS);
    let mut values = vec![0f32; length * width];
    for (i, value) in values.iter_mut().enumerate() {
        let (place, column) = ((i / width) as f64, i % width);
        let frequency = (-(1e4f64.ln()) / width as f64 * (column - column % 2) as f64).exp();
        *value = if column % 2 == 0 {
            (place * frequency).sin()
        } else {
            (place * frequency).cos()
        } as f32;
    }
    Tensor::from_vec(values, (length, width), &Device::Cpu)
}

/// Mixes the points of each element with their largest features.
#[derive(Debug, Clone)]
struct SubgraphLayer {
    inner: Linear,
    norm: LayerNorm,
    outer: GroupLinear,
}

impl SubgraphLayer {
    fn take(weights: &mut Weights, name: &str, width: usize) -> Result<Self> {
        let remap = weights.take(&format!("{name}.linear_remap.weight"), &[width, 2 * width])?;
        Ok(Self {
            inner: weights.linear_without_bias(&format!("{name}.mlp.linear"), width, width)?,
            norm: weights.layer_norm(&format!("{name}.mlp.norm"), width)?,
            outer: GroupLinear::from_tensors(
                &remap,
                weights.take(&format!("{name}.linear_remap.bias"), &[width])?,
            )?,
        })
    }

    /// Points (N, P, width), of which some are available (N, P).
    fn forward(&self, x: &Tensor, available: &Tensor) -> Result<Tensor> {
        let x = relu(&self.norm.forward(&self.inner.forward(x)?)?)?;
        self.outer
            .forward(&x, &largest_where(&x, available, f32::NEG_INFINITY)?)
    }
}
