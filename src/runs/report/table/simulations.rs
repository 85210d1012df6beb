//! The simulations of a run: their metrics, what made scores 0, which failed.

use super::terminal::LineWidth;
use super::{MANY, Table, or_dash, percent, short};
use crate::report::number::fixed;
use crate::report::simulation_row::SimulationRow;
use crate::report::visible::visible_line;
use console::{measure_text_width, style};
use planagent_agent::planner::Unreadable;
use planagent_score::metrics::{MetricList, distinct, metric};
use planagent_world::InteractionKind;
use std::collections::BTreeMap;
use std::fmt::Write;

/// Maximum number of rows; `summary.json` has all simulations.
const MAX_ROWS: usize = 60;
/// Rows of the worst simulations.
const WORST_ROWS: usize = 5;

/// A row for each simulation below the name of its scenario.
pub(super) struct SimulationTable {
    text: String,
    /// Label and name of each metric that it shows.
    labels: Vec<(&'static str, &'static str)>,
}

impl SimulationTable {
    /// The completed simulations with scores of a list: score x 100 and metrics. A column for each
    /// metric where the width has room and the scores take no others, else those below 1 in words.
    pub(super) fn new(rows: &[SimulationRow], list: MetricList, width: LineWidth) -> Self {
        let completed: Vec<&SimulationRow> = rows
            .iter()
            .filter(|row| row.score.is_some() && row.challenge.metric_list() == list)
            .collect();
        let shown = completed.get(..MAX_ROWS).unwrap_or(&completed);
        let usual: Vec<&str> = list.scored().map(|metric| metric.name).collect();
        let has_own = shown
            .iter()
            .flat_map(|row| row.scored())
            .any(|name| !usual.contains(&name));
        let wide = (!has_own)
            .then(|| with_columns(shown, list))
            .filter(|table| table.fits_below_names(width));
        let (table, labels) = match wide {
            Some(table) => {
                let labels = list.scored().map(|metric| (metric.label, metric.name));
                (table, labels.collect())
            }
            None => (in_words(shown, width), labels_below_one(shown)),
        };
        let mut text = table.fitted_below_names(width);
        let left_out = completed.len() - shown.len();
        if left_out > 0 {
            // Writing to a string cannot fail.
            let _ = write!(text, "\nand {left_out} more simulations in summary.json");
        }
        Self { text, labels }
    }

    pub(super) fn labels(&self) -> impl Iterator<Item = (&'static str, &'static str)> + '_ {
        self.labels.iter().copied()
    }

    pub(super) fn text(self) -> String {
        self.text
    }
}

/// Scenario, planner and challenge of a row, and its score x 100.
fn head(row: &SimulationRow) -> [String; 4] {
    [
        row.scenario.clone(),
        format!(" {}", row.planner),
        short(row.challenge).to_owned(),
        or_dash(row.score, percent),
    ]
}

fn calls(row: &SimulationRow) -> String {
    let calls = Some(row.planning_calls).filter(|calls| *calls > 0);
    or_dash(calls, |calls| calls.to_string())
}

/// A column for each metric of the list.
fn with_columns(rows: &[&SimulationRow], list: MetricList) -> Table {
    let labels = list.scored().map(|metric| metric.label);
    let headers = ["scenario", " planner", "", "score"]
        .into_iter()
        .chain(labels)
        .chain(["calls"]);
    let decimals = decimals(rows, list);
    let cells = |row: &&SimulationRow| {
        let metrics = list.scored().zip(&decimals).map(|(metric, &decimals)| {
            or_dash(row.metric(metric.name), |value| fixed(value, decimals))
        });
        let metrics: Vec<String> = metrics.collect();
        head(row)
            .into_iter()
            .chain(metrics)
            .chain([calls(row)])
            .collect()
    };
    Table::new(headers, 3, rows.iter().map(cells))
}

/// Decimals of the columns of metrics: none where all scores are whole, else two.
fn decimals(rows: &[&SimulationRow], list: MetricList) -> Vec<usize> {
    let is_whole = |value: f64| (value - value.round()).abs() < 1e-9;
    let of_metric = |name: &str| {
        let mut values = rows.iter().filter_map(|row| row.metric(name));
        if values.all(is_whole) { 0 } else { 2 }
    };
    list.scored().map(|metric| of_metric(metric.name)).collect()
}

/// The metrics of a score that are below 1, with their values.
fn below_one(row: &SimulationRow) -> Vec<(&'static str, &'static str, f64)> {
    let scored = row.scored().into_iter();
    scored
        .filter_map(|name| {
            let value = row.metric(name).filter(|value| *value < 1.0)?;
            Some((metric(name).map_or(name, |spec| spec.label), name, value))
        })
        .collect()
}

fn labels_below_one(rows: &[&SimulationRow]) -> Vec<(&'static str, &'static str)> {
    let all = rows.iter().flat_map(|row| below_one(row));
    distinct(all.map(|(label, name, _)| (label, name)))
}

/// The metrics that are below 1 in the last column, whatever metrics the scores take.
fn in_words(rows: &[&SimulationRow], width: LineWidth) -> Table {
    let cells = |row: &&SimulationRow| {
        let words = below_one(row).into_iter();
        let words: Vec<String> = words
            .map(|(label, _, value)| format!("{label} {}", fixed(value, 2)))
            .collect();
        let words = if words.is_empty() {
            "none".to_owned()
        } else {
            words.join(", ")
        };
        head(row).into_iter().chain([calls(row), words]).collect()
    };
    let headers = [
        "scenario",
        " planner",
        "",
        "score",
        "calls",
        "metrics below 1",
    ];
    let mut table = Table::new(headers, 3, rows.iter().map(cells)).ending_in_text();
    table.wrap_last(width);
    table
}

/// The simulations with the lowest scores below 1, where a run has many.
pub(super) fn worst(rows: &[SimulationRow], width: LineWidth) -> String {
    let scored = rows.iter().filter_map(|row| Some((row.score?, row)));
    let mut scored: Vec<(f64, &SimulationRow)> = scored.collect();
    if scored.len() < MANY {
        return String::new();
    }
    scored.retain(|(score, _)| *score < 1.0);
    scored.sort_by(|(a, _), (b, _)| a.total_cmp(b));
    let mut worst: Vec<&SimulationRow> = scored.into_iter().map(|(_, row)| row).collect();
    worst.truncate(WORST_ROWS);
    if worst.is_empty() {
        return String::new();
    }
    let table = in_words(&worst, width).fitted_below_names(width);
    format!("lowest scores\n{table}")
}

/// What the score of a modified scenario is.
const INTERPLAN: &str =
    "Scenarios of interPlan's kinds have interPlan's score, with metrics of its own.";

/// The `meanings` of columns, and those of the challenges, each once.
pub(super) fn legend(
    rows: &[SimulationRow],
    lists: &[MetricList],
    meanings: Vec<String>,
    width: LineWidth,
) -> String {
    let has_calls = rows.iter().any(|row| row.planning_calls > 0);
    let of_lists = lists.iter().flat_map(|list| list.meanings());
    let of_lists = of_lists.map(|meaning| (*meaning).to_owned());
    let calls = has_calls.then(|| "calls = planning calls".to_owned());
    let of_kinds = rows
        .iter()
        .any(|row| InteractionKind::named(&row.scenario_type).is_some())
        .then(|| INTERPLAN.to_owned());
    let own = distinct(rows.iter().filter_map(|row| row.challenge.own_agents()));
    let own = own.iter().map(|name| {
        format!("{name} = agents under the policy {name}: no challenge of nuPlan, so compare it with neither")
    });
    let short = width.listed(meanings.into_iter().chain(of_lists).chain(calls));
    let sentences = of_kinds.into_iter().chain(own);
    let sentences = sentences.flat_map(|sentence| width.wrapped(&sentence));
    short
        .into_iter()
        .chain(sentences)
        .map(|line| style(line).dim().to_string())
        .collect::<Vec<_>>()
        .join("\n")
}

/// The multipliers that made scores 0, a line each, below the name of the scenario.
pub(super) fn zeroed(rows: &[SimulationRow], width: LineWidth) -> String {
    let mut lines: Vec<String> = Vec::new();
    let mut scenario = None;
    for row in rows.iter().filter(|row| !row.zeroed_by.is_empty()) {
        if scenario.replace(&row.scenario) != Some(&row.scenario) {
            lines.extend(width.name(&visible_line(&row.scenario)));
        }
        for name in &row.zeroed_by {
            let planner = visible_line(&row.planner);
            let (challenge, name) = (short(row.challenge), visible_line(name));
            let line = format!("  {planner} {challenge}: 0 because of {name}");
            if measure_text_width(&line) <= width.columns() {
                lines.push(line);
            } else {
                lines.extend(width.wrapped(&line));
            }
        }
    }
    lines.join("\n")
}

/// A line for each planner some of whose planning calls were refused whole.
pub(super) fn refused(rows: &[SimulationRow], width: LineWidth) -> String {
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
        .flat_map(|planner| width.wrapped(&line(planner)))
        .collect::<Vec<_>>()
        .join("\n")
}

/// A line for each planner some of whose planning calls gave no plan: how many, and why.
pub(super) fn without_plan(rows: &[SimulationRow], width: LineWidth) -> String {
    let has_such = |row: &&SimulationRow| row.failed_calls + row.unreadable() > 0;
    let planners = distinct(rows.iter().filter(has_such).map(|row| row.planner.as_str()));
    let line = |planner: &str| {
        let own = || rows.iter().filter(|row| row.planner == planner);
        let mut causes: BTreeMap<Unreadable, usize> = BTreeMap::new();
        for (cause, count) in own().flat_map(|row| &row.unreadable_calls) {
            *causes.entry(*cause).or_default() += count;
        }
        let failed: usize = own().map(|row| row.failed_calls).sum();
        let failed = (failed > 0).then(|| format!("{failed} without an answer"));
        let causes = causes.iter();
        let unreadable = causes.map(|(cause, count)| format!("{count} because {cause}"));
        let whys: Vec<String> = failed.into_iter().chain(unreadable).collect();
        let lost: usize = own().map(|row| row.failed_calls + row.unreadable()).sum();
        let calls: usize = own().map(|row| row.planning_calls).sum();
        format!(
            "{planner}: {lost} of {calls} planning calls gave no plan: {}",
            whys.join(", ")
        )
    };
    planners
        .into_iter()
        .flat_map(|planner| width.wrapped(&line(planner)))
        .collect::<Vec<_>>()
        .join("\n")
}
