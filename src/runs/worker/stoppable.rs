//! Ends the simulations of a run that its user stops.

use planagent_agent::planner::{
    Planner, PlannerError, PlannerInitialization, PlannerInput, PlanningCall, StopSwitch,
};
use planagent_score::pdm::DrivableLayers;
use planagent_world::Trajectory;

/// Why a stopped simulation has no trajectory.
#[derive(Debug, thiserror::Error)]
#[error("the run was stopped")]
struct Stopped;

/// A planner that fails once its run is stopped.
pub(super) struct Stoppable<'a> {
    pub(super) planner: Box<dyn Planner + 'a>,
    pub(super) switch: StopSwitch,
}

impl Planner for Stoppable<'_> {
    fn name(&self) -> &str {
        self.planner.name()
    }

    fn initialize(
        &mut self,
        initialization: &PlannerInitialization<'_>,
    ) -> Result<(), PlannerError> {
        self.planner.initialize(initialization)
    }

    fn compute_trajectory(&mut self, input: &PlannerInput<'_>) -> Result<Trajectory, PlannerError> {
        if self.switch.is_stopped() {
            return Err(PlannerError::Failed {
                doing: "planning",
                source: Box::new(Stopped),
            });
        }
        self.planner.compute_trajectory(input)
    }

    fn finish(&mut self) -> Result<(), PlannerError> {
        self.planner.finish()
    }

    fn calls(&self) -> &[PlanningCall] {
        self.planner.calls()
    }

    fn take_calls(&mut self) -> Vec<PlanningCall> {
        self.planner.take_calls()
    }

    fn drivable_layers(&self) -> Option<DrivableLayers> {
        self.planner.drivable_layers()
    }
}
