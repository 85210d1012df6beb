//! The line that an attempt ends with.

use super::assist::Assistance;
use super::code::PlannerCode;
use std::fmt;

/// A model's answer that was read.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PlannerAnswer {
    /// The planner code of PlanAgent.
    Code(PlannerCode),
    /// The waypoints or parameters of LLM-ASSIST.
    Assistance(Assistance),
}

impl PlannerAnswer {
    pub fn code(&self) -> Option<PlannerCode> {
        match self {
            Self::Code(code) => Some(*code),
            Self::Assistance(_) => None,
        }
    }
}

impl fmt::Display for PlannerAnswer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Code(code) => code.fmt(f),
            Self::Assistance(assistance) => assistance.fmt(f),
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
