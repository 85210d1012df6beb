//! PDM-Closed as a planner (Dauner et al. 2023, "Parting with Misconceptions about Learning-based
//! Vehicle Motion Planning").

use super::{Planner, PlannerError, PlannerInitialization, PlannerInput};
use planagent_score::pdm::{DrivableLayers, PdmMemory, ReferencePath, plan};
use planagent_world::Trajectory;

/// PDM-Closed: it chooses its reference path at the first iteration and keeps it, and scores
/// fifteen proposals at every iteration.
#[derive(Debug, Clone, Default)]
pub struct PdmClosed {
    memory: PdmMemory,
}

impl PdmClosed {
    /// A planner that has not been initialised yet.
    pub fn new() -> Self {
        Self::default()
    }
}

impl Planner for PdmClosed {
    fn name(&self) -> &'static str {
        "pdm-closed"
    }

    fn initialize(
        &mut self,
        initialization: &PlannerInitialization<'_>,
    ) -> Result<(), PlannerError> {
        *self = Self::default();
        if initialization.route.lanes(initialization.map).is_empty() {
            Err(PlannerError::EmptyRoute)
        } else {
            Ok(())
        }
    }

    fn compute_trajectory(&mut self, input: &PlannerInput<'_>) -> Result<Trajectory, PlannerError> {
        Ok(plan(&mut self.memory, &input.scene)?.trajectory)
    }

    fn drivable_layers(&self) -> Option<DrivableLayers> {
        self.memory
            .reference_path
            .as_ref()
            .map(ReferencePath::layers)
    }
}
