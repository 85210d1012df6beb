//! What drives between the planning calls: PDM-Closed, or an answer that is active.

use super::Assisted;
use crate::planner::PlannerError;
use crate::reasoning::Assistance;
use planagent_score::pdm::{self, PdmError, PdmMemory, PdmPlan, ReferencePath, plan_tuned};
use planagent_world::{EgoState, SceneView, Trajectory, TrajectoryError};

/// PDM-Closed with its memory, and the answer that is executed in its place.
#[derive(Debug, Clone, Default)]
pub struct AssistDrive {
    pub(super) memory: PdmMemory,
    pub(super) active: Option<Assisted>,
}

impl AssistDrive {
    /// A step of PDM-Closed, which comes first in every step.
    ///
    /// # Errors
    /// As of [`pdm::plan`].
    pub fn rules(&mut self, scene: &SceneView<'_>) -> Result<PdmPlan, PdmError> {
        pdm::plan(&mut self.memory, scene)
    }

    /// PDM-Closed's path; `None` before its first step.
    pub fn reference_path(&self) -> Option<&ReferencePath> {
        self.memory.reference_path.as_ref()
    }

    /// Executes an answer from now on.
    ///
    /// # Errors
    /// When the state of the ego is not finite.
    pub fn begin(&mut self, answer: &Assistance, ego: &EgoState) -> Result<(), TrajectoryError> {
        self.active = Some(Assisted::from_answer(answer, ego)?);
        Ok(())
    }

    /// Executes PDM-Closed from now on.
    pub fn end(&mut self) {
        self.active = None;
    }

    /// The trajectory of a step whose step of PDM-Closed is `rules`.
    ///
    /// # Errors
    /// When the proposals of the answer's parameters cannot be scored or are not finite.
    pub fn trajectory(
        &mut self,
        scene: &SceneView<'_>,
        rules: PdmPlan,
    ) -> Result<Trajectory, PlannerError> {
        match (&self.active, &mut self.memory) {
            (Some(Assisted::Plan(trajectory)), _) => Ok(trajectory.clone()),
            (
                Some(Assisted::Parameters(parameters)),
                PdmMemory {
                    reference_path: Some(path),
                    collided,
                },
            ) => Ok(plan_tuned(path, scene, collided, *parameters)?.trajectory),
            _ => Ok(rules.trajectory),
        }
    }
}
