//! Tables for the terminal, readable at 80 columns.

use crate::experiment::run::DriveRecord;
use crate::metrics::MetricName;
use crate::report::Aggregate;
use comfy_table::{CellAlignment, ContentArrangement, Table, presets};

/// Heads of the metric columns, in the order of [`MetricName::ALL`].
const SHORT_NAMES: [&str; 8] = ["coll", "area", "prog", "dir", "rate", "ttc", "speed", "comf"];

fn table(width: u16) -> Table {
    let mut table = Table::new();
    table.load_style(presets::UTF8_HORIZONTAL_ONLY);
    table.set_content_arrangement(ContentArrangement::Dynamic).set_width(width);
    table
}

/// A row a drive with score x 100 and the eight metrics, a legend, and the mean of each planner and challenge.
pub fn main_table(records: &[DriveRecord], aggregates: &[Aggregate], width: u16) -> String {
    let mut drives = table(width);
    drives.set_header(["scenario", "planner", "", "score"].into_iter().chain(SHORT_NAMES).chain(["calls"]));
    for record in records {
        let Ok(driven) = &record.outcome else { continue };
        let name = record.scenario.strip_prefix("generated/").unwrap_or(&record.scenario).to_owned();
        let head = [name, record.planner.to_string(), short(&record.challenge.to_string()).to_owned()];
        let metrics = MetricName::ALL.into_iter().map(|name| compact(driven.score.metric(name)));
        let calls = if driven.calls.is_empty() { "-".to_owned() } else { driven.calls.len().to_string() };
        drives.add_row(head.into_iter().chain([percent(driven.score.value)]).chain(metrics).chain([calls]));
    }
    for column in drives.column_iter_mut().skip(3) {
        column.set_cell_alignment(CellAlignment::Right);
        column.set_padding((0, 1));
    }
    let mut means = table(width);
    means.set_header(["planner", "challenge", "drives", "failed", "score"]);
    for row in aggregates {
        let score = row.score.map_or_else(|| "-".to_owned(), percent);
        means.add_row([
            row.planner.clone(),
            row.challenge.clone(),
            row.scenarios.to_string(),
            row.failed.to_string(),
            score,
        ]);
    }
    let legend = legend(width);
    let zeroed = zeroed(records);
    [drives.to_string(), legend, zeroed, means.to_string()]
        .into_iter()
        .filter(|part| !part.is_empty())
        .collect::<Vec<_>>()
        .join("\n\n")
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
    lines.push("NR = non-reactive, R = reactive traffic; score = nuPlan's closed-loop score x 100".to_owned());
    lines.join("\n")
}

/// A line for each score of 0: the multipliers that made it.
fn zeroed(records: &[DriveRecord]) -> String {
    let lines = records.iter().filter_map(|record| {
        let driven = record.outcome.as_ref().ok()?;
        let names: Vec<&str> = driven.score.zero_multipliers().map(MetricName::as_str).collect();
        let challenge = short(&record.challenge.to_string()).to_owned();
        (!names.is_empty())
            .then(|| format!("{} {} {challenge}: 0 because of {}", record.scenario, record.planner, names.join(", ")))
    });
    lines.collect::<Vec<_>>().join("\n")
}

/// A line a failed drive.
pub fn failures(records: &[DriveRecord]) -> Vec<String> {
    let failed = records.iter().filter_map(|record| record.outcome.as_ref().err().map(|error| (record, error)));
    failed.map(|(r, error)| format!("{} ({}, {}): {error}", r.scenario, r.planner, r.challenge)).collect()
}

fn short(challenge: &str) -> &'static str {
    if challenge.contains("nonreactive") { "NR" } else { "R" }
}

fn percent(score: f64) -> String {
    format!("{:.2}", score * 100.0)
}

fn compact(value: f64) -> String {
    if (value - value.round()).abs() < 1e-9 { format!("{value:.0}") } else { format!("{value:.2}") }
}
