//! RasterModel as a planner (nuplan-devkit `ml_planner.py`).

use super::features::Raster;
use super::network::{RasterModel, RasterModelConfig};
use crate::blocks::Probe;
use crate::slot::{Slot, learned_entry};
use crate::{network_failed, prediction};
use planagent_agent::planner::{Planner, PlannerError, PlannerInitialization, PlannerInput};
use planagent_agent::planner_registry::PlannerEntry;
use planagent_world::Trajectory;
use std::sync::Arc;

/// The planners `raster-model` and `raster-model-small`.
pub(crate) fn entries() -> [PlannerEntry; 2] {
    let published = Slot::new("RasterModel", |weights| {
        RasterModel::take(weights, RasterModelConfig::PUBLISHED)
    });
    let small = Slot::new("RasterModel (small)", |weights| {
        RasterModel::take(weights, RasterModelConfig::SMALL)
    });
    [
        ("raster-model", "RasterModel, a learned planner", published),
        ("raster-model-small", "RasterModel in a small shape", small),
    ]
    .map(|(name, summary, slot)| {
        learned_entry(name, summary, slot, move |network| {
            Box::new(RasterModelPlanner { name, network })
        })
    })
}

/// RasterModel: it plans again at every iteration.
#[derive(Debug)]
struct RasterModelPlanner {
    name: &'static str,
    network: Arc<RasterModel>,
}

impl Planner for RasterModelPlanner {
    fn name(&self) -> &'static str {
        self.name
    }

    fn initialize(&mut self, _: &PlannerInitialization<'_>) -> Result<(), PlannerError> {
        Ok(())
    }

    fn compute_trajectory(&mut self, input: &PlannerInput<'_>) -> Result<Trajectory, PlannerError> {
        let raster = Raster::from_scene(&input.scene)
            .inputs()
            .map_err(network_failed)?;
        let plan = self
            .network
            .forward(&raster, &Probe::off())
            .map_err(network_failed)?;
        prediction::trajectory(
            &prediction::poses(&plan).map_err(network_failed)?,
            prediction::HALF_SECOND_US,
            &input.scene,
        )
    }
}
