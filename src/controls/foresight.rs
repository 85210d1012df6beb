//! A planner beside the simulation that it takes part in: before a planning call it tries answers
//! out in a copy of it.

use planagent_agent::planner::{
    Planner, PlannerError, PlannerInitialization, PlannerInput, PlannerName, PlanningCall,
};
use planagent_agent::planner_registry::{PlannerEntry, PlannerNeeds, PlannerParts};
use planagent_agent::simulation::ClosedLoop;
use planagent_world::{HistorySample, SceneView, Trajectory};

/// A planner whose planning calls are answered by a search in the simulation.
pub trait Foresight: Send {
    /// The planner whose calls are answered.
    fn planner(&self) -> &dyn Planner;

    /// The planner whose calls are answered.
    fn planner_mut(&mut self) -> &mut dyn Planner;

    /// Whether the next step, in this scene, begins with a planning call.
    fn begins_with_call(&self, scene: &SceneView<'_>) -> bool;

    /// Finds the answer of the planning call that begins now, and hands it to the planner. `past`
    /// has the samples before the present.
    fn look_ahead(&mut self, simulation: &ClosedLoop<'static>, past: &[HistorySample]);
}

/// The planner of a name, which `build` makes from its parts.
pub fn entry<F: Foresight + 'static>(
    name: &'static str,
    summary: &'static str,
    build: impl Fn(&PlannerParts<'_>) -> Result<F, PlannerError> + Send + Sync + 'static,
) -> PlannerEntry {
    let build = move |parts: &PlannerParts<'_>| -> Result<Box<dyn Planner>, PlannerError> {
        let simulation = parts.simulation.ok_or(PlannerError::MissingPart {
            planner: parts.name,
            part: "a simulation to look ahead in",
        })?;
        Ok(Box::new(OracleAgent {
            shadow: simulation.clone(),
            past: Vec::new(),
            inner: build(parts)?,
        }))
    };
    PlannerEntry::new(
        PlannerName::new(name),
        summary,
        PlannerNeeds::Simulation,
        build,
    )
}

struct OracleAgent<F> {
    /// The same simulation, with the same trajectories.
    shadow: ClosedLoop<'static>,
    /// Its samples before the present.
    past: Vec<HistorySample>,
    inner: F,
}

impl<F: Foresight> Planner for OracleAgent<F> {
    fn name(&self) -> &str {
        self.inner.planner().name()
    }

    fn initialize(
        &mut self,
        initialization: &PlannerInitialization<'_>,
    ) -> Result<(), PlannerError> {
        self.inner.planner_mut().initialize(initialization)
    }

    fn compute_trajectory(&mut self, input: &PlannerInput<'_>) -> Result<Trajectory, PlannerError> {
        if self.inner.begins_with_call(&input.scene) {
            self.inner.look_ahead(&self.shadow, &self.past);
        }
        let trajectory = self.inner.planner_mut().compute_trajectory(input)?;
        let name = self.name().to_owned();
        let failed = |source| PlannerError::Failed {
            doing: "looking ahead",
            source: Box::new(source),
        };
        self.past.push(self.shadow.present().clone());
        self.shadow.advance(&trajectory, &name).map_err(failed)?;
        Ok(trajectory)
    }

    fn calls(&self) -> &[PlanningCall] {
        self.inner.planner().calls()
    }

    fn take_calls(&mut self) -> Vec<PlanningCall> {
        self.inner.planner_mut().take_calls()
    }
}
