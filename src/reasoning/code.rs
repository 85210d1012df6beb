//! The planner code of the paper: what it says, its ranges, and how it is printed.

use std::fmt;

/// Name of the one function that planner code calls (paper, section 3, planner code generation).
pub const FUNCTION: &str = "Generate_IDM_Planner";

/// A call `Generate_IDM_Planner(c, la, v0, acc, dec)`: an IDM planner along a centreline behind a leader.
#[derive(Debug, Clone, PartialEq)]
pub struct PlannerCode {
    /// `c`: name of the centreline to follow, as the scene text gives it.
    pub centerline: String,
    /// `la`: name of the leading agent, as the scene text gives it; `None` when nothing leads.
    pub lead_agent: Option<String>,
    /// `v0`: desired speed, m/s.
    pub target_speed: f64,
    /// `acc`: maximum acceleration, m/s².
    pub accel_max: f64,
    /// `dec`: maximum deceleration as a positive magnitude, m/s².
    pub decel_max: f64,
}

/// What a number of the code may be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Range {
    /// Smallest allowed value.
    pub min: f64,
    /// Largest allowed value.
    pub max: f64,
    /// Its unit, for messages.
    pub unit: &'static str,
}

/// `v0`: from standing still to more than any speed limit of nuPlan's maps.
pub const TARGET_SPEED: Range = Range { min: 0.0, max: 40.0, unit: "m/s" };
/// `acc`: up to what a passenger car can give.
pub const ACCEL_MAX: Range = Range { min: 0.1, max: 5.0, unit: "m/s²" };
/// `dec`: up to a full brake on dry road.
pub const DECEL_MAX: Range = Range { min: 0.1, max: 9.0, unit: "m/s²" };

impl Range {
    /// Whether a value lies within.
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
        let lead_agent = self.lead_agent.as_deref().unwrap_or("None");
        let Self { centerline, target_speed, accel_max, decel_max, .. } = self;
        write!(f, "{FUNCTION}(c={centerline}, la={lead_agent}, v0={target_speed}, acc={accel_max}, dec={decel_max})")
    }
}

/// The names that a scene text gives: what planner code may refer to.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Names {
    /// Centrelines that may be followed.
    pub centerlines: Vec<String>,
    /// Agents and obstacles that may lead.
    pub lead_agents: Vec<String>,
    /// Speed limit of the ego's lane, whole m/s: under a grammar no more can be asked for. `None` where it is unknown.
    pub speed_limit: Option<u32>,
}
