//! Why a drive ends early.

use crate::dynamics::TrackingError;
use crate::planner::PlannerError;

/// Why a scenario cannot be driven to its end.
#[derive(Debug, thiserror::Error)]
pub enum SimulationError {
    /// A drive needs two iterations at least.
    #[error("scenario {scenario} has {iterations} iterations; a simulation needs at least 2")]
    TooShort {
        /// Which scenario.
        scenario: String,
        /// How many iterations it has.
        iterations: usize,
    },
    /// Two frames of the log follow each other in no time.
    #[error("scenario {scenario}: the time of iteration {iteration} does not lie after its predecessor")]
    TimeNotIncreasing {
        /// Which scenario.
        scenario: String,
        /// The later iteration.
        iteration: usize,
    },
    /// The planner refuses the scenario.
    #[error("planner {planner} cannot be initialised for scenario {scenario}")]
    Initialization {
        /// Which planner.
        planner: String,
        /// Which scenario.
        scenario: String,
        /// Its reason.
        source: PlannerError,
    },
    /// The planner gives no trajectory.
    #[error("planner {planner} failed at iteration {iteration} of scenario {scenario}")]
    Planner {
        /// Which planner.
        planner: String,
        /// Which scenario.
        scenario: String,
        /// Which iteration.
        iteration: usize,
        /// Its reason.
        source: PlannerError,
    },
    /// The controller cannot follow the trajectory.
    #[error("the trajectory of planner {planner} at iteration {iteration} of scenario {scenario} cannot be tracked")]
    Tracking {
        /// Which planner.
        planner: String,
        /// Which scenario.
        scenario: String,
        /// Which iteration.
        iteration: usize,
        /// The controller's reason.
        source: TrackingError,
    },
    /// The ego left the numbers.
    #[error("the ego is not finite after iteration {iteration} of scenario {scenario} (planner {planner})")]
    NotFinite {
        /// Which planner.
        planner: String,
        /// Which scenario.
        scenario: String,
        /// The last iteration with a finite state.
        iteration: usize,
    },
}
