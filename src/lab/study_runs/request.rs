//! What studies are asked for.

use planagent_agent::planner_registry::PlannerRegistry;
use planagent_scenario::DataRoots;
use std::path::PathBuf;

/// What studies are asked for.
#[derive(Debug, Clone, Default)]
pub struct StudiesRequest {
    /// Names of suites; without any, those of each study.
    pub suites: Vec<String>,
    /// Scenarios of the suite `recorded`; without any, the recordings in `$PLANAGENT_DATA`.
    pub scenarios: Vec<String>,
    /// The planners that the studies name.
    pub registry: PlannerRegistry,
    /// Folders of nuPlan's data.
    pub roots: DataRoots,
    /// Folder for results and runs.
    pub out: PathBuf,
    /// Folder of a bench that measured the models without weights on this machine.
    pub bench: Option<PathBuf>,
    /// Whether to take only the first scenes of each type.
    pub quick: bool,
    /// Maximum number of scenes of a suite, taken evenly from their types.
    pub limit: Option<usize>,
    /// Whether to repeat failed simulations.
    pub retry_failed: bool,
}
