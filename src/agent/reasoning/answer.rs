//! The line that an attempt ends with.

use super::assist::Assistance;
use super::code::PlannerCode;
use super::outputs::{DrivingAction, WaypointList};
use std::fmt;

/// A model's answer that was read.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PlannerAnswer {
    /// The planner code of PlanAgent.
    Code(PlannerCode),
    /// The waypoints or parameters of LLM-ASSIST.
    Assistance(Assistance),
    /// Six waypoints, half a second apart.
    Waypoints(WaypointList),
    /// One of five actions.
    Action(DrivingAction),
}

impl PlannerAnswer {
    pub fn code(&self) -> Option<PlannerCode> {
        match self {
            Self::Code(code) => Some(*code),
            Self::Assistance(_) | Self::Waypoints(_) | Self::Action(_) => None,
        }
    }
}

impl fmt::Display for PlannerAnswer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Code(code) => code.fmt(f),
            Self::Assistance(assistance) => assistance.fmt(f),
            Self::Waypoints(waypoints) => waypoints.fmt(f),
            Self::Action(action) => action.fmt(f),
        }
    }
}

impl From<PlannerCode> for PlannerAnswer {
    fn from(code: PlannerCode) -> Self {
        Self::Code(code)
    }
}

impl From<Assistance> for PlannerAnswer {
    fn from(assistance: Assistance) -> Self {
        Self::Assistance(assistance)
    }
}

impl From<WaypointList> for PlannerAnswer {
    fn from(waypoints: WaypointList) -> Self {
        Self::Waypoints(waypoints)
    }
}

impl From<DrivingAction> for PlannerAnswer {
    fn from(action: DrivingAction) -> Self {
        Self::Action(action)
    }
}
