//! RasterModel as a planner (nuplan-devkit `ml_planner.py`).

use super::features::Raster;
use super::network::{RasterModel, RasterModelConfig};
use crate::planner::learned::blocks::Probe;
use crate::planner::learned::slot::{Slot, learned_entry};
use crate::planner::learned::{network_failed, prediction};
use crate::planner::{Planner, PlannerEntry, PlannerError, PlannerInitialization, PlannerInput};
use crate::world::Trajectory;
use std::sync::Arc;

const NAME: &str = "raster-model";

/// The planner `raster-model`.
pub(in crate::planner) fn entry() -> PlannerEntry {
    let slot = Slot::new("RasterModel", |weights| RasterModel::take(weights, RasterModelConfig::PUBLISHED));
    learned_entry(NAME, "RasterModel, a learned planner", slot, |network| Box::new(RasterModelPlanner { network }))
}

/// RasterModel: it plans again at every iteration.
#[derive(Debug)]
struct RasterModelPlanner {
    network: Arc<RasterModel>,
}

impl Planner for RasterModelPlanner {
    fn name(&self) -> &'static str {
        NAME
    }

    fn initialize(&mut self, _: &PlannerInitialization<'_>) -> Result<(), PlannerError> {
        Ok(())
    }

    fn compute_trajectory(&mut self, input: &PlannerInput<'_>) -> Result<Trajectory, PlannerError> {
        let raster = Raster::of(&input.scene).inputs().map_err(network_failed)?;
        let plan = self.network.forward(&raster, &Probe::off()).map_err(network_failed)?;
        prediction::trajectory(
            &prediction::poses(&plan).map_err(network_failed)?,
            prediction::HALF_SECOND_US,
            &input.scene,
        )
    }
}
