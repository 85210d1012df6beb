//! Tables for the terminal, readable at 80 columns.

use super::summary::Aggregate;
use crate::experiment::run::DriveRecord;
use crate::metrics::MetricName;
use comfy_table::{CellAlignment, Table, presets};
use console::style;

/// Heads of the metric columns, in the order of [`MetricName::ALL`].
const SHORT_NAMES: [&str; 8] = ["coll", "area", "prog", "dir", "rate", "ttc", "speed", "comf"];
/// More drives than this are left to `summary.json`; the means stand for them.
const MOST_ROWS: usize = 60;

/// A row a drive under the name of its scenario, with score x 100 and the eight metrics, then a legend, the causes of
/// scores of 0, and the mean of each planner and challenge.
pub fn main_table(records: &[DriveRecord], aggregates: &[Aggregate], width: u16) -> String {
    let parts = [drives(records), legend(width), zeroed(records), means(aggregates)];
    parts.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join("\n\n")
}

/// A table without frame, its numbers to the right from column `numbers` on.
fn plain(header: &[&str], rows: Vec<Vec<String>>, numbers: usize) -> String {
    let mut table = Table::new();
    table.load_style(presets::NOTHING);
    table.set_header(header);
    table.add_rows(rows);
    for (i, column) in table.column_iter_mut().enumerate() {
        column.set_padding((0, 2));
        if i >= numbers {
            column.set_cell_alignment(CellAlignment::Right);
        }
    }
    table.lines().map(|line| line.trim_end().to_owned()).collect::<Vec<_>>().join("\n")
}

fn drives(records: &[DriveRecord]) -> String {
    let shown: Vec<&DriveRecord> = records.iter().filter(|r| r.outcome.is_ok()).take(MOST_ROWS).collect();
    let rows = shown.iter().map(|record| row(record)).collect();
    let header: Vec<&str> = ["planner", "", "score"].into_iter().chain(SHORT_NAMES).chain(["calls"]).collect();
    let table = plain(&header, rows, 2);
    let mut lines = table.lines();
    let mut text: Vec<String> = lines.next().map(str::to_owned).into_iter().collect();
    let mut scenario = "";
    for (record, line) in shown.iter().zip(lines) {
        if record.scenario != scenario {
            scenario = &record.scenario;
            text.push(style(scenario).bold().to_string());
        }
        text.push(line.to_owned());
    }
    let left_out = records.iter().filter(|r| r.outcome.is_ok()).count() - shown.len();
    if left_out > 0 {
        text.push(format!("and {left_out} more drives in summary.json"));
    }
    text.join("\n")
}

fn row(record: &DriveRecord) -> Vec<String> {
    let Ok(driven) = &record.outcome else { return Vec::new() };
    let metrics = MetricName::ALL.into_iter().map(|name| compact(driven.score.metric(name)));
    let calls = if driven.calls.is_empty() { "-".to_owned() } else { driven.calls.len().to_string() };
    let head = [format!("  {}", record.planner), short(record), percent(driven.score.value)];
    head.into_iter().chain(metrics).chain([calls]).collect()
}

fn means(aggregates: &[Aggregate]) -> String {
    let rows = aggregates.iter().map(|row| {
        let score = row.score.map_or_else(|| "-".to_owned(), percent);
        vec![row.planner.clone(), row.challenge.clone(), row.scenarios.to_string(), row.failed.to_string(), score]
    });
    plain(&["planner", "challenge", "drives", "failed", "score"], rows.collect(), 2)
}

/// What the short heads mean.
fn legend(width: u16) -> String {
    let mut lines = vec![String::new()];
    for (short, name) in SHORT_NAMES.into_iter().zip(MetricName::ALL) {
        let part = format!("{short} = {name}");
        let line = lines.last_mut().map_or(0, |line| line.chars().count());
        if line > 0 && line + part.len() + 2 > usize::from(width) {
            lines.push(part);
        } else if let Some(last) = lines.last_mut() {
            if !last.is_empty() {
                last.push_str("  ");
            }
            last.push_str(&part);
        }
    }
    lines.push("NR, R = replayed, reactive traffic  score = nuPlan's closed-loop score x 100".to_owned());
    lines.iter().map(|line| style(line).dim().to_string()).collect::<Vec<_>>().join("\n")
}

/// For each score of 0 the multipliers that made it, a line each.
fn zeroed(records: &[DriveRecord]) -> String {
    let mut lines: Vec<String> = Vec::new();
    let mut scenario = None;
    for record in records {
        let Ok(driven) = &record.outcome else { continue };
        let mut names = driven.score.zero_multipliers().peekable();
        if names.peek().is_some() && scenario != Some(&record.scenario) {
            lines.push(record.scenario.clone());
            scenario = Some(&record.scenario);
        }
        lines.extend(names.map(|name| format!("  {} {}: 0 because of {name}", record.planner, short(record))));
    }
    lines.join("\n")
}

/// A line a failed drive.
pub fn failures(records: &[DriveRecord]) -> Vec<String> {
    let failed = records.iter().filter_map(|record| record.outcome.as_ref().err().map(|error| (record, error)));
    failed.map(|(r, error)| format!("{} ({}, {}): {error}", r.scenario, r.planner, r.challenge)).collect()
}

fn short(record: &DriveRecord) -> String {
    use crate::simulation::Challenge;
    match record.challenge {
        Challenge::ClosedLoopNonreactiveAgents => "NR".to_owned(),
        Challenge::ClosedLoopReactiveAgents => "R".to_owned(),
    }
}

fn percent(score: f64) -> String {
    format!("{:.2}", score * 100.0)
}

fn compact(value: f64) -> String {
    if (value - value.round()).abs() < 1e-9 { format!("{value:.0}") } else { format!("{value:.2}") }
}
