//! The simulations of a run: their metrics, what made scores 0, which failed.

use super::{Table, fill, or_dash, percent, short};
use crate::report::number::fixed;
use crate::report::simulation_row::SimulationRow;
use crate::report::visible::visible_line;
use console::style;
use planagent_score::metrics::{MetricList, distinct};
use planagent_world::InteractionKind;
use std::fmt::Write;

/// Maximum number of rows; `summary.json` has all simulations.
const MAX_ROWS: usize = 60;

/// A row for each simulation below the name of its scenario: score x 100 and the metrics of the
/// list.
pub(super) fn table(rows: &[SimulationRow], list: MetricList) -> String {
    let completed = || {
        rows.iter()
            .filter(|row| row.score.is_some() && row.challenge.metric_list() == list)
    };
    let labels = list.scored().map(|metric| metric.label);
    let headers = ["scenario", " planner", "", "score"]
        .into_iter()
        .chain(labels)
        .chain(["calls"]);
    let decimals = decimals(&completed().take(MAX_ROWS), list);
    let table = Table::new(
        headers,
        3,
        completed().take(MAX_ROWS).map(|row| cells(row, &decimals)),
    );
    let left_out = completed().count() - table.rows.len();
    let mut text = table.terminal_below_names();
    if left_out > 0 {
        // Writing to a string cannot fail.
        let _ = write!(text, "\nand {left_out} more simulations in summary.json");
    }
    text
}

/// Decimals of the columns of metrics: none where all scores are whole, else two.
fn decimals<'a>(
    rows: &(impl Iterator<Item = &'a SimulationRow> + Clone),
    list: MetricList,
) -> Vec<usize> {
    let is_whole = |value: f64| (value - value.round()).abs() < 1e-9;
    let of_metric = |name: &str| {
        let whole = rows
            .clone()
            .filter_map(|row| row.metric(name))
            .all(is_whole);
        if whole { 0 } else { 2 }
    };
    list.scored().map(|metric| of_metric(metric.name)).collect()
}

fn cells(row: &SimulationRow, decimals: &[usize]) -> Vec<String> {
    let list = row.challenge.metric_list().scored().zip(decimals);
    let metrics = list.map(|(metric, &decimals)| {
        or_dash(row.metric(metric.name), |value| fixed(value, decimals))
    });
    let calls = or_dash(
        Some(row.planning_calls).filter(|calls| *calls > 0),
        |calls| calls.to_string(),
    );
    let planner = format!(" {}", row.planner);
    let head = [
        row.scenario.clone(),
        planner,
        short(row.challenge).to_owned(),
        or_dash(row.score, percent),
    ];
    head.into_iter().chain(metrics).chain([calls]).collect()
}

/// What the score of a modified scenario is.
const INTERPLAN: &str =
    "Scenarios of interPlan's kinds have interPlan's score, with metrics that report shows.";

/// The meaning of the labels of the metrics and of the challenges, each once.
pub(super) fn legend(rows: &[SimulationRow], lists: &[MetricList], width: u16) -> String {
    let metrics = lists.iter().flat_map(|list| list.scored());
    let meanings = distinct(metrics.map(|metric| format!("{} = {}", metric.label, metric.name)));
    let challenges = lists.iter().map(|list| list.meaning());
    let of_kinds = rows
        .iter()
        .any(|row| InteractionKind::named(&row.scenario_type).is_some());
    let of_kinds = of_kinds.then(|| INTERPLAN.to_owned());
    let own = distinct(rows.iter().filter_map(|row| row.challenge.own_agents()));
    let own = own.iter().map(|name| {
        format!("{name} = agents under the policy {name}: no challenge of nuPlan, so compare it with neither")
    });
    let lines = fill(meanings, usize::from(width))
        .into_iter()
        .chain(challenges.map(str::to_owned))
        .chain(of_kinds)
        .chain(own);
    lines
        .map(|line| style(line).dim().to_string())
        .collect::<Vec<_>>()
        .join("\n")
}

/// The multipliers that made scores 0, a line each, below the name of the scenario.
pub(super) fn zeroed(rows: &[SimulationRow]) -> String {
    let mut lines: Vec<String> = Vec::new();
    let mut scenario = None;
    for row in rows.iter().filter(|row| !row.zeroed_by.is_empty()) {
        if scenario.replace(&row.scenario) != Some(&row.scenario) {
            lines.push(visible_line(&row.scenario).into_owned());
        }
        let names = row.zeroed_by.iter();
        lines.extend(names.map(|name| {
            format!(
                "  {} {}: 0 because of {name}",
                row.planner,
                short(row.challenge)
            )
        }));
    }
    lines.join("\n")
}

/// A line for each planner some of whose planning calls were refused whole.
pub(super) fn refused(rows: &[SimulationRow]) -> String {
    let planners = distinct(
        rows.iter()
            .filter(|row| row.refused_calls > 0)
            .map(|row| row.planner.as_str()),
    );
    let line = |planner: &str| {
        let sum = |of: fn(&SimulationRow) -> usize| {
            rows.iter()
                .filter(|r| r.planner == planner)
                .map(of)
                .sum::<usize>()
        };
        let (refused, calls) = (sum(|row| row.refused_calls), sum(|row| row.planning_calls));
        format!("{planner}: all attempts refused in {refused} of {calls} planning calls")
    };
    planners
        .into_iter()
        .map(line)
        .collect::<Vec<_>>()
        .join("\n")
}
