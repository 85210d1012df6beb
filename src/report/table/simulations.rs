//! The drives one by one: their metrics, what made scores 0, what failed.

use super::{fill, percent_or_dash, plain, short};
use crate::metrics::MetricList;
use crate::report::number::fixed;
use crate::report::simulation_row::SimulationRow;
use console::style;

/// More drives than this are left to `summary.json`; the means stand for them.
const MOST_ROWS: usize = 60;

/// A row a drive under the name of its scenario: score x 100 and the metrics of the list.
pub(super) fn simulations(rows: &[SimulationRow], list: MetricList) -> String {
    let driven = || rows.iter().filter(|row| row.score.is_some() && row.challenge.metric_list() == list);
    let shown: Vec<&SimulationRow> = driven().take(MOST_ROWS).collect();
    let metrics = list.scored().map(|metric| metric.label);
    let header = ["simulation", "", "score"].into_iter().chain(metrics).chain(["calls"]);
    let table = plain(&header.map(str::to_owned).collect::<Vec<_>>(), shown.iter().map(|row| cells(row)).collect(), 2);
    let mut lines = table.lines();
    let mut text: Vec<String> = lines.next().map(str::to_owned).into_iter().collect();
    let mut scenario = "";
    for (row, line) in shown.iter().zip(lines) {
        if row.scenario != scenario {
            scenario = &row.scenario;
            text.push(style(scenario).bold().to_string());
        }
        text.push(line.to_owned());
    }
    let left_out = driven().count() - shown.len();
    if left_out > 0 {
        text.push(format!("and {left_out} more simulations in summary.json"));
    }
    text.join("\n")
}

fn cells(row: &SimulationRow) -> Vec<String> {
    let list = row.challenge.metric_list().scored();
    let metrics = list.map(|metric| row.metric(metric.name).map_or_else(|| "-".to_owned(), compact));
    let calls = if row.planning_calls == 0 { "-".to_owned() } else { row.planning_calls.to_string() };
    let head = [format!("  {}", row.planner), short(row.challenge).to_owned(), percent_or_dash(row.score)];
    head.into_iter().chain(metrics).chain([calls]).collect()
}

/// What the short heads mean.
pub(super) fn legend(list: MetricList, width: u16) -> String {
    let meanings = list.scored().map(|metric| format!("{} = {}", metric.label, metric.name));
    let mut lines = fill(meanings, usize::from(width));
    lines.push(
        match list {
            MetricList::ClosedLoop => "NR, R = replayed, reactive traffic  score = nuPlan's closed-loop score x 100",
            MetricList::OpenLoop => "OLS = the ego does what was recorded  score = nuPlan's open-loop score x 100",
        }
        .to_owned(),
    );
    lines.iter().map(|line| style(line).dim().to_string()).collect::<Vec<_>>().join("\n")
}

/// For each score of 0 the multipliers that made it, a line each.
pub(super) fn zeroed(rows: &[SimulationRow]) -> String {
    let mut lines: Vec<String> = Vec::new();
    let mut scenario = None;
    for row in rows.iter().filter(|row| !row.zeroed_by.is_empty()) {
        if scenario != Some(&row.scenario) {
            lines.push(row.scenario.clone());
            scenario = Some(&row.scenario);
        }
        let names = row.zeroed_by.iter();
        lines.extend(names.map(|name| format!("  {} {}: 0 because of {name}", row.planner, short(row.challenge))));
    }
    lines.join("\n")
}

/// A line a failed drive.
pub fn failures(rows: &[SimulationRow]) -> Vec<String> {
    let failed = rows.iter().filter_map(|row| row.error.as_ref().map(|error| (row, error)));
    failed.map(|(row, error)| format!("{} ({}, {}): {error}", row.scenario, row.planner, row.challenge)).collect()
}

fn compact(value: f64) -> String {
    fixed(value, if (value - value.round()).abs() < 1e-9 { 0 } else { 2 })
}
