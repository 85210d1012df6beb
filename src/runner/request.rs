//! What a run is asked to simulate.

use crate::planner::PlannerRegistry;
use crate::scenario::{DataRoots, Readers};

/// What to simulate, in the words of the command line. An empty field takes the value of the run that is resumed, else
/// the default: one generated scenario, `plan-agent`, non-reactive agents.
#[derive(Debug, Clone)]
pub struct Request {
    /// Files, folders, `LOG.db#TOKEN`, `generated/TYPE/SEED`.
    pub scenarios: Vec<String>,
    /// Names of splits, or filter files.
    pub splits: Vec<String>,
    /// Only the first so many scenarios.
    pub limit: Option<usize>,
    /// Names of planners.
    pub planners: Vec<String>,
    /// Names of challenges; `both` stands for the closed-loop ones.
    pub challenges: Vec<String>,
    /// The planners that names refer to.
    pub registry: PlannerRegistry,
    /// Makes the readers that scenario words refer to.
    pub readers: fn(&DataRoots) -> Readers,
    /// Folders of nuPlan's data.
    pub roots: DataRoots,
    /// Whether to repeat the failed simulations of the run that is resumed.
    pub retry_failed: bool,
}

impl Default for Request {
    fn default() -> Self {
        Self {
            scenarios: Vec::new(),
            splits: Vec::new(),
            limit: None,
            planners: Vec::new(),
            challenges: Vec::new(),
            registry: PlannerRegistry::default(),
            readers: Readers::new,
            roots: DataRoots::default(),
            retry_failed: false,
        }
    }
}

impl Request {
    /// Whether it says which scenarios are meant.
    pub(super) fn names_scenarios(&self) -> bool {
        !self.scenarios.is_empty() || !self.splits.is_empty() || self.limit.is_some()
    }

    /// Whether it only resumes a run, as that was started.
    pub(super) fn is_plain_resume(&self) -> bool {
        !self.names_scenarios() && self.planners.is_empty() && self.challenges.is_empty() && !self.retry_failed
    }
}
