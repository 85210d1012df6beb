//! The planner code of the paper: its parts, its ranges, its text.

use crate::environment::{AgentName, CenterlineName, LaneGraph};
use std::fmt;

/// The function that planner code calls (paper, section 3, planner code generation).
pub const FUNCTION: &str = "Generate_IDM_Planner";

/// A call `Generate_IDM_Planner(c, la, v0, acc, dec)`: an IDM planner along a centerline behind a
/// lead agent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlannerCode {
    /// `c`: the centerline to follow.
    pub centerline: CenterlineName,
    /// `la`: the lead agent; `None` without one.
    pub lead_agent: Option<AgentName>,
    /// `v0`: desired speed, m/s.
    pub target_speed: f64,
    /// `acc`: maximum acceleration, m/s².
    pub accel_max: f64,
    /// `dec`: maximum deceleration as a positive magnitude, m/s².
    pub decel_max: f64,
}

/// How a code says that no agent leads.
pub(super) const NO_LEAD_AGENT: &str = "None";

/// The values that a number of the code may take.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Range {
    pub min: f64,
    pub max: f64,
    /// The unit, for messages.
    pub unit: &'static str,
}

/// `v0`: from standstill to more than any speed limit of nuPlan's maps.
pub(crate) const TARGET_SPEED: Range = Range {
    min: 0.0,
    max: 40.0,
    unit: "m/s",
};
/// `acc`: up to what a passenger car can give.
pub(crate) const ACCEL_MAX: Range = Range {
    min: 0.1,
    max: 5.0,
    unit: "m/s²",
};
/// `dec`: up to a full brake on dry road.
pub(crate) const DECEL_MAX: Range = Range {
    min: 0.1,
    max: 9.0,
    unit: "m/s²",
};

impl Range {
    pub fn contains(&self, value: f64) -> bool {
        (self.min..=self.max).contains(&value)
    }
}

impl fmt::Display for Range {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} to {} {}", self.min, self.max, self.unit)
    }
}

impl fmt::Display for PlannerCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            centerline,
            lead_agent,
            target_speed,
            accel_max,
            decel_max,
        } = self;
        write!(f, "{FUNCTION}(c={centerline}, la=")?;
        match lead_agent {
            Some(name) => write!(f, "{name}")?,
            None => f.write_str(NO_LEAD_AGENT)?,
        }
        write!(f, ", v0={target_speed}, acc={accel_max}, dec={decel_max})")
    }
}

/// The names that a scene text gives: what planner code may refer to.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Names {
    /// Centerlines that a plan may follow.
    pub centerlines: Vec<CenterlineName>,
    /// Agents and obstacles that may lead.
    pub lead_agents: Vec<AgentName>,
    /// Speed limit of the ego's lane, whole m/s, the upper bound of v0 under a grammar. `None`
    /// where it is unknown.
    pub speed_limit: Option<u32>,
}

impl Names {
    /// The names of a scene's lane graph.
    pub fn from_graph(graph: &LaneGraph) -> Self {
        Self {
            centerlines: graph.named().map(|centerline| centerline.name).collect(),
            lead_agents: graph.agents.iter().map(|agent| agent.name).collect(),
            speed_limit: graph
                .ego_lane()
                .speed_limit
                .map(|limit| limit.round() as u32),
        }
    }
}
