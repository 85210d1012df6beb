//! Ends the simulations of a run that its user stops.

use planagent_agent::planner::{
    Planner, PlannerError, PlannerInitialization, PlannerInput, PlanningCall,
};
use planagent_score::pdm::DrivableLayers;
use planagent_world::Trajectory;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// A switch that ends a run: its simulations fail at their next step, and no further one starts.
#[derive(Debug, Clone, Default)]
pub struct StopSwitch {
    own: Arc<AtomicBool>,
    /// The switch that this one is a part of.
    above: Option<Arc<AtomicBool>>,
}

impl StopSwitch {
    /// A switch that stops with this one, and alone.
    pub(crate) fn part(&self) -> Self {
        Self {
            own: Arc::default(),
            above: Some(Arc::clone(&self.own)),
        }
    }

    /// Stops the run.
    pub fn stop(&self) {
        self.own.store(true, Ordering::Relaxed);
    }

    /// Whether the run is to stop.
    pub fn is_stopped(&self) -> bool {
        let is_set = |flag: &Arc<AtomicBool>| flag.load(Ordering::Relaxed);
        is_set(&self.own) || self.above.as_ref().is_some_and(is_set)
    }
}

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
