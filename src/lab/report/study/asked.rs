//! What the planning calls of a variant asked and gave.

use crate::study::{Column, Study};
use planagent_agent::planner::Unreadable;
use planagent_runs::report::SimulationRow;
use serde::Serialize;

/// The metric that a collision by the ego's fault makes 0.
const COLLISIONS: &str = "no_ego_at_fault_collisions";

/// Figures of the planning calls of a variant; means are over calls that were not gated.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AskedFigures {
    /// Simulations with a collision that is the ego's fault.
    pub collisions: usize,
    /// Planning calls.
    pub calls: usize,
    /// Mean number of questions to the model.
    pub questions: Option<f64>,
    /// Mean number of tokens that it reads and writes.
    pub tokens: Option<f64>,
    /// Calls whose last answer could not be read.
    pub unreadable: usize,
    /// Calls whose plans were refused: by Reflection, or because waypoints jump.
    pub refused: usize,
}

/// Whether a study has columns with these figures.
pub(super) fn asks_for_figures(study: &Study) -> bool {
    study.columns.iter().any(|column| {
        matches!(
            column,
            Column::Collisions | Column::Questions | Column::Tokens | Column::NoPlan
        )
    })
}

impl AskedFigures {
    pub(super) fn from_rows(rows: &[SimulationRow]) -> Self {
        let completed = || rows.iter().filter(|row| row.score.is_some());
        let calls: usize = completed().map(|row| row.planning_calls).sum();
        let times = || completed().flat_map(|row| &row.time.calls);
        let questions: usize = times().map(|call| call.questions).sum();
        let tokens: usize = times().map(|call| call.read + call.written).sum();
        let per_call =
            |count: usize| (calls > 0 && questions > 0).then(|| count as f64 / calls as f64);
        let jumps: usize = completed()
            .filter_map(|row| row.unreadable_calls.get(&Unreadable::Jump))
            .sum();
        let unreadable: usize = completed()
            .flat_map(|row| row.unreadable_calls.values())
            .sum();
        Self {
            collisions: completed()
                .filter(|row| row.zeroed_by.iter().any(|name| name == COLLISIONS))
                .count(),
            calls,
            questions: per_call(questions),
            tokens: per_call(tokens),
            unreadable: unreadable - jumps,
            refused: jumps + completed().map(|row| row.refused_calls).sum::<usize>(),
        }
    }

    /// A number of calls in percent of all.
    pub(crate) fn percent(&self, count: usize) -> Option<f64> {
        (self.calls > 0).then(|| 100.0 * count as f64 / self.calls as f64)
    }
}
