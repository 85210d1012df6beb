//! What became of the model's planning calls.

use crate::report::{Outcome, SuiteSimulations};
use planagent_runs::report::{
    DecisionRecord, ReportError, SimulationRow, simulation_calls, simulation_folders,
};
use serde::Serialize;
use std::path::Path;

/// The planning calls of the model on a suite. Each count is of calls, apart from attempts.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub(super) struct CallCounts {
    pub(super) suite: String,
    pub(super) calls: usize,
    /// Attempts at which the model was asked.
    pub(super) attempts: usize,
    /// The last answer has no plan that can be read.
    pub(super) unreadable: usize,
    /// Reflection refused the first attempt, and all of them.
    pub(super) first_refused: usize,
    pub(super) all_refused: usize,
    /// The active plan was kept, and the ego braked, since the call gave no plan.
    pub(super) kept: usize,
    pub(super) braked: usize,
    /// A deadline or a failure of the model ended it.
    pub(super) interrupted: usize,
}

/// The counts of the first variant on each suite; `runs` is the folder of the runs.
pub(super) fn count(
    suites: &[SuiteSimulations],
    runs: &Path,
) -> Result<Vec<CallCounts>, ReportError> {
    let of_suite = |suite: &SuiteSimulations| match suite.variants.first().map(|one| &one.outcome) {
        Some(Outcome::Simulated { run, rows }) => {
            let name = Path::new(run).file_name();
            let folder = name.map_or_else(|| runs.to_owned(), |name| runs.join(name));
            of_run(&suite.name, rows, &folder)
        }
        _ => Ok(CallCounts {
            suite: suite.name.clone(),
            ..CallCounts::default()
        }),
    };
    suites.iter().map(of_suite).collect()
}

fn of_run(suite: &str, rows: &[SimulationRow], run: &Path) -> Result<CallCounts, ReportError> {
    let sum = |of: fn(&SimulationRow) -> usize| rows.iter().map(of).sum::<usize>();
    let mut counts = CallCounts {
        suite: suite.to_owned(),
        calls: sum(|row| row.planning_calls),
        unreadable: sum(SimulationRow::unreadable),
        first_refused: sum(|row| row.first_refused_calls),
        all_refused: sum(|row| row.refused_calls),
        interrupted: sum(|row| row.deadlines + row.failed_calls),
        ..CallCounts::default()
    };
    for folder in simulation_folders(run)?.values() {
        for call in simulation_calls(folder)? {
            let asked = call.attempts.iter().filter(|attempt| !attempt.is_further);
            counts.attempts += asked.count();
            match call.decision {
                DecisionRecord::KeepActivePlan { .. } => counts.kept += 1,
                DecisionRecord::Brake { .. } => counts.braked += 1,
                _ => {}
            }
        }
    }
    Ok(counts)
}
