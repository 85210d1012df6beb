//! Codes that are the same whatever the scene asks for.

use crate::MAX_PROPOSALS;
use planagent_agent::planner::{CodeCall, CodeList, fixed_code, grid_codes, plain_codes};
use planagent_agent::reasoning::PlannerCode;

/// Always the ego's lane at the speed limit, in one attempt.
pub(crate) struct FixedCode;

impl CodeList for FixedCode {
    fn codes(&self, call: &CodeCall<'_>) -> Vec<PlannerCode> {
        vec![fixed_code(call.graph)]
    }
}

/// The code of a grid that Reflection scores best. Earlier codes win ties: the ego's lane before
/// others, fast before slow.
pub(crate) struct Grid;

impl CodeList for Grid {
    fn codes(&self, call: &CodeCall<'_>) -> Vec<PlannerCode> {
        grid_codes(call.graph)
    }

    fn compares(&self) -> bool {
        true
    }
}

/// The best of four codes that do not look: each lane at the limit, then the ego's lane more
/// slowly.
pub(crate) struct FourPlainCodes;

impl CodeList for FourPlainCodes {
    fn codes(&self, call: &CodeCall<'_>) -> Vec<PlannerCode> {
        plain_codes(call.graph).take(MAX_PROPOSALS).collect()
    }

    fn compares(&self) -> bool {
        true
    }
}
