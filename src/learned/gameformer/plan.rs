//! GameFormer's plan for the ego: controls, rolled out.

use super::decoder::POSES;
use super::encoder::{Block, MapEncoder};
use crate::blocks::{Linear, Probe, Weights, key_bias};
use candle_core::{D, Device, IndexOp, Result, Tensor};

/// Columns and points of a route lane.
const ROUTE: [usize; 2] = [3, 50];
/// Time between two poses, seconds.
const STEP_S: f32 = 0.1;
/// Bounds of acceleration, m/s², and curvature, 1/m.
const MAX_ACCELERATION: f32 = 5.0;
const MAX_CURVATURE: f32 = 0.5;

#[derive(Debug, Clone)]
pub(super) struct PlanHead {
    route: MapEncoder,
    fusion: Block,
    controls: [Linear; 2],
}

impl PlanHead {
    pub(super) fn take(weights: &mut Weights, dim: usize) -> Result<Self> {
        Ok(Self {
            route: MapEncoder::take(weights, "planner.route_encoder", ROUTE, dim)?,
            fusion: Block::take(
                weights,
                "planner.route_fusion",
                "cross_attention",
                [dim, 4 * dim],
            )?,
            controls: [
                weights.linear("planner.plan_decoder.0", 2 * dim, dim)?,
                weights.linear("planner.plan_decoder.3", dim, 2 * POSES)?,
            ],
        })
    }

    /// The plan (B, 80, 3) of the ego's contents (B, M, dim), the route (B, R, 50, 3) and the
    /// present state (B, 5).
    pub(super) fn forward(
        &self,
        ego: &Tensor,
        route: &Tensor,
        current: &Tensor,
        probe: &Probe,
    ) -> Result<Tensor> {
        let (tokens, seen) = self.route.forward(route, "planner.route_encoder", probe)?;
        let first = Tensor::ones((seen.dim(0)?, 1), seen.dtype(), &Device::Cpu)?;
        let seen = Tensor::cat(&[first, seen.narrow(1, 1, seen.dim(1)? - 1)?], 1)?;
        let fused = self.fusion.cross(ego, &tokens, &key_bias(&seen)?)?;
        probe.note("planner.route_fusion", &fused);
        let largest = Tensor::cat(&[ego, &fused], D::Minus1)?.max(1)?;
        let [inner, outer] = &self.controls;
        let controls = outer.forward(&inner.forward(&largest)?.elu(1.0)?)?;
        probe.note("planner.plan_decoder", &controls);
        let states = current.to_vec2::<f32>()?;
        let plans = states.iter().enumerate().map(|(i, state)| {
            let controls = controls.i(i)?.reshape((POSES, 2))?.to_vec2::<f32>()?;
            Tensor::from_vec(rolled_out(&controls, state), (POSES, 3), &Device::Cpu)
        });
        Tensor::stack(&plans.collect::<Result<Vec<_>>>()?, 0)
    }
}

/// Poses of accelerations and curvatures from x, y, heading and velocity.
fn rolled_out(controls: &[Vec<f32>], state: &[f32]) -> Vec<f32> {
    let [x, y, heading, vx, vy] = std::array::from_fn(|i| {
        state
            .get(i)
            .copied()
            .expect("a present state has five columns")
    });
    let (mut x, mut y, mut heading, mut speed) = (x, y, heading, vx.hypot(vy));
    let mut poses = Vec::with_capacity(3 * controls.len());
    for control in controls {
        let [acceleration, curvature] = std::array::from_fn(|i| {
            control
                .get(i)
                .copied()
                .expect("a control is acceleration and curvature")
        });
        speed += acceleration.clamp(-MAX_ACCELERATION, MAX_ACCELERATION) * STEP_S;
        // As upstream, the sum goes on below zero while the speed itself stays at zero.
        let driven = speed.max(0.0);
        heading += curvature.clamp(-MAX_CURVATURE, MAX_CURVATURE) * driven * STEP_S;
        let turned = heading % std::f32::consts::TAU;
        x += driven * turned.cos() * STEP_S;
        y += driven * turned.sin() * STEP_S;
        poses.extend([x, y, turned]);
    }
    poses
}
