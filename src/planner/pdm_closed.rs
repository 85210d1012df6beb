//! PDM-Closed as a planner (Dauner et al. 2023, "Parting with Misconceptions about Learning-based Vehicle Motion Planning").

use super::{Planner, PlannerError, PlannerInitialization, PlannerInput};
use crate::pdm::{DrivableLayers, NoReferencePath, PdmError, PdmMemory, ReferencePath, plan, plan_along};
use crate::world::{SceneView, Trajectory};

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

    fn drivable_layers(&self) -> Option<DrivableLayers> {
        self.memory.reference_path.as_ref().map(ReferencePath::layers)
    }
}

/// The error of a planner for which PDM-Closed plans.
pub(super) fn pdm_failed(error: PdmError) -> PlannerError {
    match error {
        PdmError::NoReferencePath(NoReferencePath::EmptyRoute) => PlannerError::EmptyRoute,
        error => PlannerError::Failed { doing: "planning with PDM-Closed", source: Box::new(error) },
    }
}

/// What PDM-Closed's plan is predicted to score along the way that it would choose here and now, which is kept in `memory`;
/// `None` where it finds no way.
///
/// # Errors
/// When PDM-Closed cannot plan.
pub(super) fn predicted_score(scene: &SceneView<'_>, memory: &mut PdmMemory) -> Result<Option<f64>, PlannerError> {
    memory.reference_path = ReferencePath::find(scene.map, scene.route, scene.ego).ok();
    let PdmMemory { reference_path: Some(reference_path), collided } = memory else { return Ok(None) };
    let plan = plan_along(reference_path, scene, collided).map_err(pdm_failed)?;
    Ok(Some(plan.scores[plan.best].total))
}
