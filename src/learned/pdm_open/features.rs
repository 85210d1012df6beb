//! The features of PDM-Open and PDM-Offset (`tuplan_garage` `pdm_feature_builder.py`,
//! `pdm_feature_utils.py`).

use super::network::{CENTERLINE, HISTORY, POSES, PdmInputs};
use crate::frame::relative;
use crate::past;
use candle_core::{Device, Result, Tensor};
use planagent_score::metrics::{ComfortQuantity, MetricError};
use planagent_score::pdm::PdmPath;
use planagent_world::{EgoState, SceneView};

/// Steps between two samples of the history.
const STRIDE: usize = 2;
/// Distance of the poses of the centerline, meters.
const INTERVAL: f64 = 1.0;

/// Features of one scene.
#[derive(Debug, Clone, PartialEq)]
pub struct PdmFeatures {
    /// x, y, heading of the rear axle, oldest first, in its frame now.
    pub position: [[f32; 3]; HISTORY],
    /// Velocity of the center (forward, left) and yaw rate, each in the frame of its own time.
    pub velocity: [[f32; 3]; HISTORY],
    /// Acceleration of the center (forward, left) and yaw acceleration, filtered.
    pub acceleration: [[f32; 3]; HISTORY],
    /// Poses of the path ahead.
    pub centerline: [[f32; 3]; CENTERLINE],
}

impl PdmFeatures {
    /// Of a scene and the path that the ego follows.
    ///
    /// # Errors
    /// When the history cannot be filtered.
    pub fn from_scene(
        scene: &SceneView<'_>,
        path: &PdmPath,
    ) -> std::result::Result<Self, MetricError> {
        let samples = past::samples(scene, (HISTORY - 1) * STRIDE + 1);
        let states: Vec<EgoState> = samples
            .iter()
            .step_by(STRIDE)
            .map(|sample| sample.ego)
            .collect();
        let here = scene.ego.rear_axle;
        // Upstream takes derivatives from the devkit's comfort metrics, and so does this.
        let signal = |quantity: ComfortQuantity| quantity.signal(&states);
        let yaw_rate = signal(ComfortQuantity::YawRate)?;
        let forward = signal(ComfortQuantity::LonAcceleration)?;
        let left = signal(ComfortQuantity::LatAcceleration)?;
        let yaw_acceleration = signal(ComfortQuantity::YawAcceleration)?;
        let velocity = |i: usize| {
            let center = states[i].center_velocity();
            [center.x as f32, center.y as f32, yaw_rate[i] as f32]
        };
        let acceleration = |i: usize| {
            [
                forward[i] as f32,
                left[i] as f32,
                yaw_acceleration[i] as f32,
            ]
        };
        let from = path.project(here.position());
        Ok(Self {
            position: std::array::from_fn(|i| relative(here, states[i].rear_axle)),
            velocity: std::array::from_fn(velocity),
            acceleration: std::array::from_fn(acceleration),
            centerline: std::array::from_fn(|i| {
                relative(here, path.pose_at(from + i as f64 * INTERVAL))
            }),
        })
    }

    /// A batch of one.
    ///
    /// # Errors
    /// When tensors cannot be made.
    pub fn inputs(&self) -> Result<PdmInputs> {
        let history = |rows: &[[f32; 3]; HISTORY]| {
            Tensor::from_slice(rows.as_flattened(), (1, HISTORY, 3), &Device::Cpu)
        };
        Ok(PdmInputs {
            position: history(&self.position)?,
            velocity: history(&self.velocity)?,
            acceleration: history(&self.acceleration)?,
            centerline: Tensor::from_slice(
                self.centerline.as_flattened(),
                (1, CENTERLINE, 3),
                &Device::Cpu,
            )?,
            trajectory: None,
        })
    }

    /// A batch of one with the trajectory that PDM-Offset corrects.
    ///
    /// # Errors
    /// When tensors cannot be made.
    pub(crate) fn inputs_with(&self, trajectory: &[[f32; 3]; POSES]) -> Result<PdmInputs> {
        let trajectory =
            Tensor::from_slice(trajectory.as_flattened(), (1, POSES, 3), &Device::Cpu)?;
        Ok(PdmInputs {
            trajectory: Some(trajectory),
            ..self.inputs()?
        })
    }
}
