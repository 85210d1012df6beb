//! UrbanDriver as a planner (nuplan-devkit `ml_planner.py`).

use super::elements::{ElementLimits, Elements, UrbanDriverFeatures};
use super::network::{UrbanDriver, UrbanDriverConfig};
use crate::blocks::Probe;
use crate::slot::{Slot, learned_entry};
use crate::{network_failed, prediction};
use planagent_agent::planner::{Planner, PlannerError, PlannerInitialization, PlannerInput};
use planagent_agent::planner_registry::PlannerEntry;
use planagent_world::Trajectory;
use std::sync::Arc;

const NAME: &str = "urban-driver";

/// The planner `urban-driver`.
pub(crate) fn entry() -> PlannerEntry {
    let slot = Slot::new("UrbanDriver", |weights| {
        UrbanDriver::take(weights, UrbanDriverConfig::PUBLISHED)
    });
    learned_entry(NAME, "UrbanDriver, a learned planner", slot, |network| {
        Box::new(UrbanDriverPlanner { network })
    })
}

/// UrbanDriver: it plans again at every iteration.
#[derive(Debug)]
struct UrbanDriverPlanner {
    network: Arc<UrbanDriver>,
}

impl Planner for UrbanDriverPlanner {
    fn name(&self) -> &'static str {
        NAME
    }

    fn initialize(&mut self, _: &PlannerInitialization<'_>) -> Result<(), PlannerError> {
        Ok(())
    }

    fn compute_trajectory(&mut self, input: &PlannerInput<'_>) -> Result<Trajectory, PlannerError> {
        let features = UrbanDriverFeatures::from_scene(&input.scene);
        let elements =
            Elements::from_scenes(&[features], ElementLimits::PUBLISHED).map_err(network_failed)?;
        let plan = self
            .network
            .forward(&elements, &Probe::off())
            .map_err(network_failed)?;
        prediction::trajectory(
            &prediction::poses(&plan).map_err(network_failed)?,
            prediction::HALF_SECOND_US,
            &input.scene,
        )
    }
}
