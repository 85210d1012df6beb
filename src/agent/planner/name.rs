//! Names of planners.

use std::fmt;

/// Name of a planner on the command line, in records and in file names.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize)]
#[serde(transparent)]
pub struct PlannerName(&'static str);

impl PlannerName {
    /// The agent of the paper.
    pub const PLAN_AGENT: Self = Self("plan-agent");
    /// PDM-Closed.
    pub const PDM_CLOSED: Self = Self("pdm-closed");

    /// A name; it becomes part of file names.
    pub const fn new(name: &'static str) -> Self {
        Self(name)
    }

    /// The name as text.
    pub const fn as_str(self) -> &'static str {
        self.0
    }
}

impl fmt::Display for PlannerName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.0)
    }
}
