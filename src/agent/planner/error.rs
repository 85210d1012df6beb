//! Why a planner gives no trajectory.

use super::name::PlannerName;
use crate::reasoning::ReasoningError;
use crate::reflection::ReflectionError;
use planagent_score::pdm::{NoReferencePath, PdmError};
use planagent_world::TrajectoryError;
use planagent_world::geometry::GeometryError;

/// Why a planner gives no trajectory.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)]
pub enum PlannerError {
    #[error("the planner was asked for a trajectory before it was initialized")]
    NotInitialized,
    #[error("the route has no lanes")]
    EmptyRoute,
    #[error("the recording holds {samples} samples; iteration {iteration} has no future to replay")]
    NoRecordedFuture { iteration: usize, samples: usize },
    #[error("{planner} needs {part}")]
    MissingPart {
        planner: PlannerName,
        part: &'static str,
    },
    #[error("the planned states make no trajectory")]
    Trajectory(#[from] TrajectoryError),
    #[error("the plan's path cannot be built")]
    Path(#[from] GeometryError),
    #[error("asking the model failed")]
    Reasoning(#[source] Box<ReasoningError>),
    #[error("reflecting on the plan failed")]
    Reflection(#[source] Box<ReflectionError>),
    #[error("planning with PDM-Closed failed")]
    Pdm(#[source] Box<PdmError>),
    #[error(
        "{planner} needs a checkpoint; name its file by --checkpoint FILE, or by the setting {key}. docs/learned.md says where to get \
         one"
    )]
    NoCheckpoint { planner: PlannerName, key: String },
    #[error(transparent)]
    Checkpoint(Box<dyn std::error::Error + Send + Sync>),
    #[error("{doing} failed")]
    Failed {
        doing: &'static str,
        source: Box<dyn std::error::Error + Send + Sync>,
    },
}

impl From<PdmError> for PlannerError {
    fn from(error: PdmError) -> Self {
        match error {
            PdmError::NoReferencePath(NoReferencePath::EmptyRoute) => Self::EmptyRoute,
            error => Self::Pdm(Box::new(error)),
        }
    }
}

impl From<ReasoningError> for PlannerError {
    fn from(error: ReasoningError) -> Self {
        Self::Reasoning(Box::new(error))
    }
}

impl From<ReflectionError> for PlannerError {
    fn from(error: ReflectionError) -> Self {
        Self::Reflection(Box::new(error))
    }
}
