//! Tokens of lanes, connectors and crosswalks.

use super::network::{PlanTfMap, names};
use crate::blocks::{BatchNorm, GroupLinear, Linear, Mlp, Probe, Weights, largest_where, relu};
use candle_core::{DType, Result, Tensor};

/// Columns of a point: offset from the center, vector, cosine and sine.
const CHANNELS: usize = 6;
/// Widths of the point encoder.
const NARROW: usize = 128;
const WIDE: usize = 256;

/// One token a polygon.
#[derive(Debug, Clone)]
pub(super) struct MapEncoder {
    points: PointsEncoder,
    speed_limit: Mlp,
    kind: Tensor,
    on_route: Tensor,
    light: Tensor,
    no_speed_limit: Tensor,
}

impl MapEncoder {
    pub(super) fn take(weights: &mut Weights, name: &str, dim: usize) -> Result<Self> {
        Ok(Self {
            points: PointsEncoder::take(weights, &format!("{name}.polygon_encoder"), dim)?,
            speed_limit: Mlp::take(
                weights,
                &names(&format!("{name}.speed_limit_emb"), [0, 2]),
                &[1, dim, dim],
            )?,
            kind: weights.take(&format!("{name}.type_emb.weight"), &[3, dim])?,
            on_route: weights.take(&format!("{name}.on_route_emb.weight"), &[2, dim])?,
            light: weights.take(&format!("{name}.traffic_light_emb.weight"), &[4, dim])?,
            no_speed_limit: weights.take(&format!("{name}.unknown_speed_emb.weight"), &[1, dim])?,
        })
    }

    pub(super) fn forward(&self, map: &PlanTfMap, name: &str, probe: &Probe) -> Result<Tensor> {
        let (batch, polygons, points, _) = map.point.dims4()?;
        let offset = map
            .point
            .broadcast_sub(&map.center.narrow(2, 0, 2)?.unsqueeze(2)?)?;
        let orientation = map.orientation.unsqueeze(3)?;
        let features = Tensor::cat(
            &[
                offset,
                map.vector.clone(),
                orientation.cos()?,
                orientation.sin()?,
            ],
            3,
        )?;
        let rows = batch * polygons;
        let encoded = self.points.forward(
            &features.reshape((rows, points, CHANNELS))?,
            &map.valid.reshape((rows, points))?,
        )?;
        probe.note(&format!("{name}.polygon_encoder"), &encoded);
        let embedded =
            |table: &Tensor, index: &Tensor| table.index_select(&index.flatten_all()?, 0);
        // Both embeddings are computed and masked, since a batch mixes lanes with and without a
        // limit.
        let limited = map
            .has_speed_limit
            .reshape((rows, 1))?
            .to_dtype(DType::F32)?;
        let limit = self
            .speed_limit
            .forward(&map.speed_limit.reshape((rows, 1))?)?
            .broadcast_mul(&limited)?;
        let unlimited = limited
            .affine(-1.0, 1.0)?
            .broadcast_mul(&self.no_speed_limit)?;
        let kinds = (embedded(&self.kind, &map.kind)? + embedded(&self.on_route, &map.on_route)?)?;
        let limits = (embedded(&self.light, &map.light)? + (limit + unlimited)?)?;
        let tokens = ((encoded + kinds)? + limits)?.reshape((batch, polygons, ()))?;
        probe.note(name, &tokens);
        Ok(tokens)
    }
}

/// A point network: each point sees the largest features of its polygon.
#[derive(Debug, Clone)]
struct PointsEncoder {
    first: [Linear; 2],
    second: (GroupLinear, Linear),
}

impl PointsEncoder {
    fn take(weights: &mut Weights, name: &str, dim: usize) -> Result<Self> {
        let [first, second] =
            ["first_mlp", "second_mlp"].map(|part| names(&format!("{name}.{part}"), [0, 1, 3]));
        // With the norm behind it, an affine layer is another affine layer.
        let mut normed = |[layer, norm, _]: &[String; 3], inputs: usize, outputs: usize| {
            let weight = weights.take(&format!("{layer}.weight"), &[outputs, inputs])?;
            let bias = weights.take(&format!("{layer}.bias"), &[outputs])?;
            BatchNorm::take(weights, norm, outputs)?.folded(&weight, Some(&bias))
        };
        let (narrow, narrow_bias) = normed(&first, CHANNELS, NARROW)?;
        let (wide, wide_bias) = normed(&second, 2 * WIDE, WIDE)?;
        Ok(Self {
            first: [
                Linear::from_tensors(&narrow, Some(narrow_bias))?,
                weights.linear(&first[2], NARROW, WIDE)?,
            ],
            second: (
                GroupLinear::from_tensors(&wide, wide_bias)?,
                weights.linear(&second[2], WIDE, dim)?,
            ),
        })
    }

    /// Points (N, P, 6) with a mask (N, P) to (N, dim); what is masked counts as zero in both
    /// maxima, as upstream.
    fn forward(&self, x: &Tensor, valid: &Tensor) -> Result<Tensor> {
        let ([narrow, wide], (inner, outer)) = (&self.first, &self.second);
        let x = wide.forward(&relu(&narrow.forward(x)?)?)?;
        let largest = largest_where(&x, valid, 0.0)?;
        let x = outer.forward(&relu(&inner.forward(&x, &largest)?)?)?;
        largest_where(&x, valid, 0.0)
    }
}
