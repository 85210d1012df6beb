//! PlanTF as a planner (`jchengai/planTF` `imitation_planner.py`).

use super::features::PlanTfFeatures;
use super::network::{PlanTf, PlanTfConfig, PlanTfOutputs};
use crate::blocks::Probe;
use crate::slot::{Slot, learned_entry};
use crate::{network_failed, prediction};
use candle_core::Result;
use planagent_agent::planner::{Planner, PlannerError, PlannerInitialization, PlannerInput};
use planagent_agent::planner_registry::PlannerEntry;
use planagent_score::pdm::corrected_route;
use planagent_world::{STEP_US, Trajectory};
use std::sync::Arc;

const NAME: &str = "plantf";

/// The planner `plantf`.
pub(crate) fn entry() -> PlannerEntry {
    let slot = Slot::new("PlanTF", |weights| {
        PlanTf::take(weights, PlanTfConfig::PUBLISHED)
    });
    learned_entry(NAME, "PlanTF, a learned planner", slot, |network| {
        Box::new(PlanTfPlanner { network })
    })
}

/// PlanTF: it plans again at every iteration, and the most probable mode is the plan.
#[derive(Debug)]
struct PlanTfPlanner {
    network: Arc<PlanTf>,
}

impl Planner for PlanTfPlanner {
    fn name(&self) -> &'static str {
        NAME
    }

    fn initialize(
        &mut self,
        _: &PlannerInitialization<'_>,
    ) -> std::result::Result<(), PlannerError> {
        Ok(())
    }

    fn compute_trajectory(
        &mut self,
        input: &PlannerInput<'_>,
    ) -> std::result::Result<Trajectory, PlannerError> {
        let scene = &input.scene;
        let route = corrected_route(scene.map, &scene.route.roadblocks, scene.ego.rear_axle);
        let inputs = PlanTfFeatures::from_scene(scene, &route)
            .inputs()
            .map_err(network_failed)?;
        let outputs = self
            .network
            .forward(&inputs, &Probe::off())
            .map_err(network_failed)?;
        let poses = outputs.best().map_err(network_failed)?;
        prediction::trajectory(
            &prediction::poses(&poses).map_err(network_failed)?,
            STEP_US,
            scene,
        )
    }
}

impl PlanTfOutputs {
    /// The poses of each sample's most probable mode (B, 80, 3).
    ///
    /// # Errors
    /// When a tensor has another shape.
    pub fn best(&self) -> Result<candle_core::Tensor> {
        let (_, _, steps, columns) = self.trajectory.dims4()?;
        let mode = self.probability.argmax_keepdim(1)?.reshape(((), 1, 1, 1))?;
        let mode = mode
            .broadcast_as((mode.dim(0)?, 1, steps, columns))?
            .contiguous()?;
        let plan = self.trajectory.contiguous()?.gather(&mode, 1)?.squeeze(1)?;
        let column = |i: usize| plan.narrow(2, i, 1)?.flatten_all()?.to_vec1::<f32>();
        let heading: Vec<f32> = column(3)?
            .into_iter()
            .zip(column(2)?)
            .map(|(sin, cos)| sin.atan2(cos))
            .collect();
        let heading =
            candle_core::Tensor::from_vec(heading, (plan.dim(0)?, steps, 1), plan.device())?;
        candle_core::Tensor::cat(&[plan.narrow(2, 0, 2)?, heading], 2)
    }
}
