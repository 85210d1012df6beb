//! Why a call of the library fails.

use planagent_agent::planner::PlannerError;
use planagent_agent::planner_registry::UnknownPlanner;
use planagent_agent::reasoning::PromptError;
use planagent_agent::simulation::SimulationError;
use planagent_mllm::MllmError;
use planagent_scenario::{OpenError, ReaderError};
use planagent_score::metrics::MetricError;
use planagent_world::SceneError;

/// Why a call of the library fails.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs, reason = "the message of a variant says what it is")]
pub enum Error {
    #[error(transparent)]
    Scenario(#[from] ReaderError),
    #[error("'{word}' names {count} scenarios; use Scenario::open_all")]
    ManyScenarios { word: String, count: usize },
    #[error(transparent)]
    Scene(#[from] SceneError),
    #[error(transparent)]
    Model(Box<MllmError>),
    #[error(transparent)]
    Prompts(#[from] PromptError),
    #[error(transparent)]
    UnknownPlanner(#[from] UnknownPlanner),
    #[error(transparent)]
    Planner(Box<PlannerError>),
    #[error(transparent)]
    Simulation(Box<SimulationError>),
    #[error(transparent)]
    Metrics(#[from] MetricError),
}

#[doc(hidden)]
impl From<OpenError> for Error {
    fn from(error: OpenError) -> Self {
        match error {
            OpenError::Reader(error) => Self::Scenario(error),
            OpenError::ManyScenarios { word, count } => Self::ManyScenarios { word, count },
        }
    }
}

macro_rules! boxed {
    ($($variant:ident $error:ty),*) => {
        $(impl From<$error> for Error {
            fn from(error: $error) -> Self {
                Self::$variant(Box::new(error))
            }
        })*
    };
}

boxed!(Model MllmError, Planner PlannerError, Simulation SimulationError);

/// The library's result.
pub type Result<T, E = Error> = std::result::Result<T, E>;
