//! `planagent scenarios hard`: selects the scenarios of generated-test14-hard from a run.

use crate::completed::completed;
use crate::{Exit, Printer};
use anyhow::Context;
use planagent_agent::planner::PlannerName;
use planagent_agent::simulation::Challenge;
use planagent_runs::worker::suite::{Suite, hard_list, hard_scenarios};
use serde_json::json;
use std::path::Path;

/// Selects them by the scores of PDM-Closed in the run.
pub(super) fn run(folder: &Path, printer: Printer) -> anyhow::Result<Exit> {
    let rows = completed(folder, printer)?.into_iter().filter(|row| {
        row.planner == PlannerName::PDM_CLOSED.as_str() && row.challenge == Challenge::NonReactive
    });
    let scores = rows
        .filter_map(|row| Some((row.scenario.parse().ok()?, row.score?)))
        .collect();
    let specs = hard_scenarios(&scores).with_context(|| {
        let (folder, candidates, planner) = (folder.display(), Suite::CANDIDATES.name, PlannerName::PDM_CLOSED);
        format!("in {folder}, which should be a run of `simulate --split {candidates} --planner {planner}`")
    })?;
    printer.line(hard_list(&specs).trim_end());
    if printer.is_json() {
        printer.json(&json!({"split": Suite::TEST14_HARD.name, "scenarios": specs.iter().map(ToString::to_string).collect::<Vec<_>>()}))?;
    }
    Ok(Exit::Success)
}
