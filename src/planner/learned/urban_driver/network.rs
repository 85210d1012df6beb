//! UrbanDriver's network (nuplan-devkit `urban_driver_open_loop_model.py`).

use super::elements::{Elements, KINDS, POINTS};
use crate::planner::learned::blocks::{LayerNorm, Linear, Mlp, MultiheadAttention, Probe, Weights, key_bias, relu};
use candle_core::{D, Device, Result, Tensor};

/// Poses of the plan, 0.5 s apart.
pub(super) const POSES: usize = 16;
/// Columns of a point.
const COLUMNS: usize = 8;
/// Heads of the attention between elements.
const HEADS: usize = 8;
/// Longest element of the table of point positions.
const POSITIONS: usize = 5000;
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
    pub const PUBLISHED: Self = Self { embedding: 256, layers: 3 };
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
        weights.skip("positional_embedding.static_embedding", &[POSITIONS, 1, width])?;
        let layers =
            (0..config.layers).map(|i| SubgraphLayer::take(weights, &format!("local_subgraph.layers.{i}"), width));
        let layers = layers.collect::<Result<_>>()?;
        let outputs = [0, 1, 2].map(|i| format!("global_head.output_embed.layers.{i}"));
        Ok(Self {
            width,
            layers,
            points: Linear::take(weights, "feature_embedding", COLUMNS, width)?,
            kinds: weights.take("type_embedding.embedding.weight", &[KIND_ROWS, width])?,
            attention: MultiheadAttention::take(weights, "global_head.encoder", width, HEADS)?,
            output: Mlp::take(weights, &outputs, &[width, 4 * width, 4 * width, 3 * POSES])?,
        })
    }

    /// The plans (B, 16, 3) of a batch of elements.
    ///
    /// # Errors
    /// When an input has another shape.
    pub fn forward(&self, elements: &Elements, probe: &mut Probe) -> Result<Tensor> {
        let Elements { points, available, counts } = elements;
        let (batch, rows, length, _) = points.dims4()?;
        let embedded = self.points.forward(points)?;
        probe.note("feature_embedding", &embedded);
        let embedded = embedded.broadcast_add(&positions(length, self.width)?)?;
        let seen = available.max(D::Minus1)?;
        let x = self.subgraphs(&embedded.reshape((batch * rows, length, self.width))?, available, &seen)?;
        let x = x.reshape((batch, rows, self.width))?;
        probe.note("local_subgraph", &x);
        let norm = x.sqr()?.sum_keepdim(D::Minus1)?.sqrt()?.maximum(NORM_EPSILON)?;
        let x = (x.broadcast_div(&norm)? * (self.width as f64).sqrt())?;
        let kinds = counts.iter().zip(KINDS).flat_map(|(&count, kind)| vec![kind; count]);
        let kinds = self.kinds.index_select(&Tensor::from_iter(kinds, &Device::Cpu)?, 0)?;
        probe.note("type_embedding", &kinds);
        let ego = x.narrow(1, 0, 1)?;
        let own = Tensor::ones((batch, 1), seen.dtype(), &Device::Cpu)?;
        let hidden = key_bias(&Tensor::cat(&[own, seen.narrow(1, 1, rows - 1)?], 1)?)?;
        let mixed = self.attention.forward([&ego, &x.broadcast_add(&kinds)?, &x], Some(&hidden))?;
        probe.note("attention", &mixed);
        self.output.forward(&mixed.squeeze(1)?)?.reshape((batch, POSES, 3))
    }

    /// Elements (N, width) of points (N, P, width); zeros where no point is available.
    fn subgraphs(&self, x: &Tensor, available: &Tensor, seen: &Tensor) -> Result<Tensor> {
        let (rows, length, width) = x.dims3()?;
        let seen = seen.flatten_all()?.to_vec1::<u8>()?;
        let places: Vec<u32> = (0u32..).zip(&seen).filter(|&(_, &seen)| seen != 0).map(|(i, _)| i).collect();
        let zeros = Tensor::zeros((rows, width), x.dtype(), &Device::Cpu)?;
        if places.is_empty() {
            return Ok(zeros);
        }
        let places = Tensor::from_iter(places, &Device::Cpu)?;
        let mut x = x.index_select(&places, 0)?;
        let available = available.reshape((rows, length))?.index_select(&places, 0)?;
        let hidden = Tensor::full(f32::NEG_INFINITY, available.dims(), &Device::Cpu)?;
        let hidden = available.where_cond(&hidden.zeros_like()?, &hidden)?.unsqueeze(2)?;
        for layer in &self.layers {
            x = layer.forward(&x, &hidden)?;
        }
        zeros.index_add(&places, &x.broadcast_add(&hidden)?.max(1)?, 0)
    }
}

/// The sinusoidal embedding of the places of points (P, width).
fn positions(length: usize, width: usize) -> Result<Tensor> {
    debug_assert_eq!(length, POINTS);
    let mut values = vec![0f32; length * width];
    for (i, value) in values.iter_mut().enumerate() {
        let (place, column) = ((i / width) as f64, i % width);
        let frequency = (-(1e4f64.ln()) / width as f64 * (column - column % 2) as f64).exp();
        *value = if column % 2 == 0 { (place * frequency).sin() } else { (place * frequency).cos() } as f32;
    }
    Tensor::from_vec(values, (length, width), &Device::Cpu)
}

/// Mixes the points of each element with their largest features.
#[derive(Debug, Clone)]
struct SubgraphLayer {
    inner: Linear,
    norm: LayerNorm,
    outer: Linear,
}

impl SubgraphLayer {
    fn take(weights: &mut Weights, name: &str, width: usize) -> Result<Self> {
        Ok(Self {
            inner: Linear::without_bias(weights, &format!("{name}.mlp.linear"), width, width)?,
            norm: LayerNorm::take(weights, &format!("{name}.mlp.norm"), width)?,
            outer: Linear::take(weights, &format!("{name}.linear_remap"), 2 * width, width)?,
        })
    }

    fn forward(&self, x: &Tensor, hidden: &Tensor) -> Result<Tensor> {
        let x = relu(&self.norm.forward(&self.inner.forward(x)?)?)?;
        let largest = x.broadcast_add(hidden)?.max_keepdim(1)?.broadcast_as(x.shape())?.contiguous()?;
        self.outer.forward(&Tensor::cat(&[x, largest], 2)?)
    }
}
