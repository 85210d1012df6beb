//! Tables for the terminal, readable at 80 columns.

use super::summary::Aggregate;
use crate::experiment::run::DriveRecord;
use crate::metrics::{MetricList, MetricName};
use comfy_table::{CellAlignment, Table, presets};
use console::style;

/// Head of the column of a metric.
fn short_name(name: MetricName) -> &'static str {
    match name {
        MetricName::NoEgoAtFaultCollisions => "coll",
        MetricName::DrivableAreaCompliance => "area",
        MetricName::EgoIsMakingProgress => "prog",
        MetricName::DrivingDirectionCompliance => "dir",
        MetricName::EgoProgressAlongExpertRoute => "rate",
        MetricName::TimeToCollisionWithinBound => "ttc",
        MetricName::SpeedLimitCompliance => "speed",
        MetricName::EgoIsComfortable => "comf",
        MetricName::PlannerMissRateWithinBound => "miss",
        MetricName::PlannerExpertAverageL2ErrorWithinBound => "ADE",
        MetricName::PlannerExpertFinalL2ErrorWithinBound => "FDE",
        MetricName::PlannerExpertAverageHeadingErrorWithinBound => "AHE",
        MetricName::PlannerExpertFinalHeadingErrorWithinBound => "FHE",
    }
}

/// More drives than this are left to `summary.json`; the means stand for them.
const MOST_ROWS: usize = 60;

/// A row a drive under the name of its scenario, with score x 100 and its metrics, then a legend, for each list of metrics;
/// then the causes of scores of 0, and the mean of each planner and challenge.
pub fn main_table(records: &[DriveRecord], aggregates: &[Aggregate], width: u16) -> String {
    let lists = [MetricList::ClosedLoop, MetricList::OpenLoop];
    let driven = lists.into_iter().filter(|list| records.iter().any(|r| r.challenge.metric_list() == *list));
    let drives = driven.flat_map(|list| [drives(records, list), legend(list, width)]);
    drives.chain([zeroed(records), means(aggregates)]).filter(|part| !part.is_empty()).collect::<Vec<_>>().join("\n\n")
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

fn drives(records: &[DriveRecord], list: MetricList) -> String {
    let ended: Vec<&DriveRecord> =
        records.iter().filter(|r| r.outcome.is_ok() && r.challenge.metric_list() == list).collect();
    let shown = &ended[..ended.len().min(MOST_ROWS)];
    let rows = shown.iter().map(|record| row(record)).collect();
    let header: Vec<&str> = {
        let metrics = list.scored().iter().map(|&name| short_name(name));
        ["planner", "", "score"].into_iter().chain(metrics).chain(["calls"]).collect()
    };
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
    let left_out = ended.len() - shown.len();
    if left_out > 0 {
        text.push(format!("and {left_out} more drives in summary.json"));
    }
    text.join("\n")
}

fn row(record: &DriveRecord) -> Vec<String> {
    let Ok(driven) = &record.outcome else { return Vec::new() };
    let metrics = driven.score.parts.iter().map(|part| compact(part.score));
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
fn legend(list: MetricList, width: u16) -> String {
    let mut lines = vec![String::new()];
    for &name in list.scored() {
        let part = format!("{} = {name}", short_name(name));
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
    lines.push(
        match list {
            MetricList::ClosedLoop => "NR, R = replayed, reactive traffic  score = nuPlan's closed-loop score x 100",
            MetricList::OpenLoop => "OL = the ego does what was recorded  score = nuPlan's open-loop score x 100",
        }
        .to_owned(),
    );
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
        Challenge::OpenLoopBoxes => "OL".to_owned(),
    }
}

fn percent(score: f64) -> String {
    format!("{:.2}", score * 100.0)
}

fn compact(value: f64) -> String {
    if (value - value.round()).abs() < 1e-9 { format!("{value:.0}") } else { format!("{value:.2}") }
}
