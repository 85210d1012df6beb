//! Why a simulation ends early.

use super::agents::AgentPolicyError;
use crate::planner::PlannerError;
use planagent_world::dynamics::TrackingError;

/// Why a scenario cannot be simulated to its end.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)]
pub enum SimulationError {
    #[error("scenario {scenario} has {iterations} iterations; a simulation needs at least 2")]
    TooShort { scenario: String, iterations: usize },
    #[error(
        "scenario {scenario}: the time of iteration {iteration} is not after that of the iteration before"
    )]
    TimeNotIncreasing { scenario: String, iteration: usize },
    #[error("planner {planner} cannot be initialized for scenario {scenario}")]
    Initialization {
        planner: String,
        scenario: String,
        source: Box<PlannerError>,
    },
    #[error("planner {planner} failed at iteration {iteration} of scenario {scenario}")]
    Planner {
        planner: String,
        scenario: String,
        iteration: usize,
        source: Box<PlannerError>,
    },
    #[error(
        "the trajectory of planner {planner} at iteration {iteration} of scenario {scenario} cannot be tracked"
    )]
    Tracking {
        planner: String,
        scenario: String,
        iteration: usize,
        source: TrackingError,
    },
    #[error(
        "the ego state became NaN or infinite after iteration {iteration} of scenario {scenario} (planner {planner})"
    )]
    NotFinite {
        planner: String,
        scenario: String,
        iteration: usize,
    },
    #[error("the other agents cannot be moved to iteration {iteration} of scenario {scenario}")]
    Agents {
        scenario: String,
        iteration: usize,
        source: AgentPolicyError,
    },
}
