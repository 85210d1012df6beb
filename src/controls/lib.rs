//! Controls of the studies: the agent with planner codes that no model wrote. What a model adds is
//! the difference to them.
//!
//! [`search`] simulates many codes from a state; `oracle-code` and the labels of datasets are its
//! best ones.

mod assist;
mod assist_answers;
pub mod foresight;
mod grid;
mod oracle;
mod random;
pub mod search;
#[cfg(test)]
mod tests;
pub mod trial;

use grid::{FixedCode, FourPlainCodes, Grid};
use planagent_agent::planner::{CodeList, CodeSource, PlannerName};
use planagent_agent::planner_registry::{PlannerEntry, PlannerNeeds};
use random::{FourRandomCodes, RandomCodes};
use std::sync::Arc;

/// Maximum number of codes that a model proposes in an attempt, and so those of a control that is
/// compared with such a model.
const MAX_PROPOSALS: usize = 4;

/// The controls.
pub fn entries() -> impl Iterator<Item = PlannerEntry> {
    // One list, a row a control: a new one needs nothing else.
    [
        control(
            "random-code",
            "the agent with random codes (a control)",
            RandomCodes,
        ),
        control(
            "fixed-code",
            "the agent with one fixed code (a control)",
            FixedCode,
        ),
        control(
            "grid-code",
            "the agent with the best code of a grid (a control)",
            Grid,
        ),
        control(
            "random-code-four",
            "the agent with the best of four random codes (a control)",
            FourRandomCodes,
        ),
        control(
            "grid-code-four",
            "the agent with the best of four fixed codes (a control)",
            FourPlainCodes,
        ),
    ]
    .into_iter()
    .chain(oracle::entries())
    .chain(assist::entries())
}

fn control(
    name: &'static str,
    summary: &'static str,
    list: impl CodeList + 'static,
) -> PlannerEntry {
    let source = CodeSource::Listed(Arc::new(list));
    let name = PlannerName::new(name);
    PlannerEntry::new(name, summary, PlannerNeeds::Settings, move |parts| {
        Ok(Box::new(parts.agent(source.clone())))
    })
}
