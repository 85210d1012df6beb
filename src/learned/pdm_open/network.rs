//! The networks of PDM-Open and PDM-Offset (`tuplan_garage` `pdm_open_model.py`,
//! `pdm_offset_model.py`).

use crate::blocks::{Linear, Probe, Weights, relu};
use candle_core::{Result, Tensor};

/// Samples of the ego's history.
pub(super) const HISTORY: usize = 11;
/// Poses of the centerline.
pub(super) const CENTERLINE: usize = 120;
/// Poses of the plan, 0.5 s apart.
pub(super) const POSES: usize = 16;
/// Hidden width of the published models.
pub const HIDDEN: usize = 512;

/// Inputs of a batch, f32: poses are x, y, heading in the frame of the rear axle.
#[derive(Debug, Clone)]
pub struct PdmInputs {
    /// Positions (B, 11, 3), oldest first.
    pub position: Tensor,
    /// Velocities (B, 11, 3).
    pub velocity: Tensor,
    /// Accelerations (B, 11, 3).
    pub acceleration: Tensor,
    /// Centerline (B, 120, 3).
    pub centerline: Tensor,
    /// The trajectory of PDM-Closed (B, 16, 3), for PDM-Offset.
    pub trajectory: Option<Tensor>,
}

/// PDM-Open, or with a trajectory to correct PDM-Offset.
#[derive(Debug, Clone)]
pub struct PdmNetwork {
    state: Linear,
    centerline: Linear,
    trajectory: Option<Linear>,
    first: Linear,
    second: Linear,
    last: Linear,
}

impl PdmNetwork {
    /// PDM-Open of this hidden width.
    ///
    /// # Errors
    /// When a tensor cannot be converted.
    pub fn open(weights: &mut Weights, hidden: usize) -> Result<Self> {
        Self::take(weights, hidden, false)
    }

    /// PDM-Offset of this hidden width.
    ///
    /// # Errors
    /// When a tensor cannot be converted.
    pub fn offset(weights: &mut Weights, hidden: usize) -> Result<Self> {
        Self::take(weights, hidden, true)
    }

    fn take(weights: &mut Weights, hidden: usize, offset: bool) -> Result<Self> {
        let state = weights.linear("state_encoding.0", 9 * HISTORY, hidden)?;
        let centerline = weights.linear("centerline_encoding.0", 3 * CENTERLINE, hidden)?;
        let trajectory = if offset {
            Some(weights.linear("trajectory_encoding.0", 3 * POSES, hidden)?)
        } else {
            None
        };
        let encodings = if offset { 3 } else { 2 };
        let first = weights.linear("planner_head.0", encodings * hidden, hidden)?;
        let second = weights.linear("planner_head.3", hidden, hidden)?;
        let last = weights.linear("planner_head.5", hidden, 3 * POSES)?;
        Ok(Self {
            state,
            centerline,
            trajectory,
            first,
            second,
            last,
        })
    }

    /// The plan (B, 16, 3).
    ///
    /// # Errors
    /// When an input has another shape, or PDM-Offset gets no trajectory.
    pub fn forward(&self, inputs: &PdmInputs, probe: &Probe) -> Result<Tensor> {
        let quantities = [&inputs.position, &inputs.velocity, &inputs.acceleration];
        let flat = quantities.map(|quantity| quantity.flatten_from(1));
        let [position, velocity, acceleration] = flat;
        let state = relu(
            &self
                .state
                .forward(&Tensor::cat(&[position?, velocity?, acceleration?], 1)?)?,
        )?;
        let centerline = relu(
            &self
                .centerline
                .forward(&inputs.centerline.flatten_from(1)?)?,
        )?;
        probe.note("state_encoding", &state);
        probe.note("centerline_encoding", &centerline);
        let mut encodings = vec![state, centerline];
        if let Some(layer) = &self.trajectory {
            let Some(trajectory) = &inputs.trajectory else {
                candle_core::bail!("PDM-Offset needs the trajectory of PDM-Closed");
            };
            let encoding = relu(&layer.forward(&trajectory.flatten_from(1)?)?)?;
            probe.note("trajectory_encoding", &encoding);
            encodings.push(encoding);
        }
        let first = self.first.forward(&Tensor::cat(&encodings, 1)?)?;
        probe.note("planner_head.0", &first);
        let second = relu(&self.second.forward(&relu(&first)?)?)?;
        probe.note("planner_head.4", &second);
        let poses = self.last.forward(&second)?.reshape(((), POSES, 3))?;
        // PDM-Offset predicts what to add to PDM-Closed's poses.
        match (&self.trajectory, &inputs.trajectory) {
            (Some(_), Some(trajectory)) => poses + trajectory,
            _ => Ok(poses),
        }
    }
}
