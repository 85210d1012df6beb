//! PDM-Open as a planner (`tuplan_garage` `pdm_open_planner.py`).

use super::features::PdmFeatures;
use super::network::{HIDDEN, PdmNetwork};
use super::route::PdmRoute;
use crate::blocks::Probe;
use crate::slot::{Slot, learned_entry};
use crate::{network_failed, prediction};
use planagent_agent::planner::{Planner, PlannerError, PlannerInitialization, PlannerInput};
use planagent_agent::planner_registry::PlannerEntry;
use planagent_world::Trajectory;
use std::sync::Arc;

const NAME: &str = "pdm-open";

/// The planner `pdm-open`.
pub(crate) fn entry() -> PlannerEntry {
    let slot = Slot::new("PDM-Open", |weights| PdmNetwork::open(weights, HIDDEN));
    learned_entry(NAME, "PDM-Open, a learned planner", slot, |network| {
        Box::new(PdmOpen {
            network,
            route: PdmRoute::default(),
        })
    })
}

/// PDM-Open. It repairs the route at the first iteration; the path starts again at the ego's lane
/// in each.
#[derive(Debug)]
struct PdmOpen {
    network: Arc<PdmNetwork>,
    route: PdmRoute,
}

impl Planner for PdmOpen {
    fn name(&self) -> &'static str {
        NAME
    }

    fn initialize(
        &mut self,
        initialization: &PlannerInitialization<'_>,
    ) -> Result<(), PlannerError> {
        self.route = PdmRoute::default();
        if initialization.route.lanes(initialization.map).is_empty() {
            Err(PlannerError::EmptyRoute)
        } else {
            Ok(())
        }
    }

    fn compute_trajectory(&mut self, input: &PlannerInput<'_>) -> Result<Trajectory, PlannerError> {
        let path = self
            .route
            .path(&input.scene)?
            .ok_or(PlannerError::EmptyRoute)?;
        let features = PdmFeatures::from_scene(&input.scene, &path).map_err(|source| {
            PlannerError::Failed {
                doing: "filtering the history",
                source: Box::new(source),
            }
        })?;
        let inputs = features.inputs().map_err(network_failed)?;
        let plan = self
            .network
            .forward(&inputs, &Probe::off())
            .map_err(network_failed)?;
        prediction::trajectory(
            &prediction::poses(&plan).map_err(network_failed)?,
            prediction::HALF_SECOND_US,
            &input.scene,
        )
    }
}
