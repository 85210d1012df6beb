//! PDM-Closed as a planner (Dauner et al. 2023, "Parting with Misconceptions about Learning-based Vehicle Motion Planning").

use super::{Planner, PlannerError, PlannerInitialization, PlannerInput};
use crate::pdm::{DrivableLayers, NoWay, PdmError, PdmMemory, Way, plan};
use crate::world::Trajectory;

/// PDM-Closed: its centreline is chosen at the first iteration and kept; fifteen proposals are judged at every one.
#[derive(Debug, Clone, Default)]
pub struct PdmClosed {
    memory: PdmMemory,
}

impl PdmClosed {
    /// A planner that has not been initialised yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// What counts as drivable along its way; `None` before the first iteration.
    pub fn drivable_layers(&self) -> Option<DrivableLayers> {
        self.memory.way.as_ref().map(Way::layers)
    }
}

impl Planner for PdmClosed {
    fn name(&self) -> &'static str {
        "pdm-closed"
    }

    fn initialize(&mut self, initialization: &PlannerInitialization<'_>) -> Result<(), PlannerError> {
        *self = Self::default();
        if initialization.route.lanes(initialization.map).is_empty() { Err(PlannerError::EmptyRoute) } else { Ok(()) }
    }

    fn compute_trajectory(&mut self, input: &PlannerInput<'_>) -> Result<Trajectory, PlannerError> {
        Ok(plan(&mut self.memory, &input.scene).map_err(pdm_failed)?.trajectory)
    }
}

/// The error of a planner for which PDM-Closed plans.
pub(super) fn pdm_failed(error: PdmError) -> PlannerError {
    match error {
        PdmError::NoWay(NoWay::EmptyRoute) => PlannerError::EmptyRoute,
        error => PlannerError::Failed { doing: "planning with PDM-Closed", source: Box::new(error) },
    }
}
