//! Tables for the terminal, readable at 80 columns.

mod bench;
mod overview;
mod simulations;
mod study;
mod tokens;

use super::number::fixed;
use super::simulation_row::SimulationRow;
use super::summary::Summary;
use super::timing::PlannerTiming;
use crate::metrics::MetricList;
use crate::simulation::Challenge;
use comfy_table::{CellAlignment, Table, presets};
use std::fmt::Write as _;

pub use bench::{bench_markdown, bench_table};
pub use simulations::failures;
pub use study::{study_markdown, study_table};
pub use tokens::token_table;

/// The main table (a row a planner), the scenario types when there are several, the drives with their metrics up to a
/// number and a legend for each list of metrics, and what made scores 0.
pub fn main_table(summary: &Summary, planners: &[PlannerTiming], rows: &[SimulationRow], width: u16) -> String {
    let lists = [MetricList::ClosedLoop, MetricList::OpenLoop];
    let scored = |list| rows.iter().any(|row| row.score.is_some() && row.challenge.metric_list() == list);
    let driven = lists.into_iter().filter(|&list| scored(list));
    let mut parts = vec![overview::planners(summary, planners), overview::scenario_types(summary, width)];
    parts.extend(driven.flat_map(|list| [simulations::simulations(rows, list), simulations::legend(list, width)]));
    parts.push(simulations::zeroed(rows));
    parts.retain(|part| !part.is_empty());
    parts.join("\n\n")
}

/// A table without frame, its numbers to the right from column `numbers` on.
fn plain(header: &[String], rows: Vec<Vec<String>>, numbers: usize) -> String {
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

/// Adds a Markdown table behind an empty line, its numbers to the right from column `names` on.
fn markdown(text: &mut String, header: &[String], names: usize, rows: impl Iterator<Item = Vec<String>>) {
    let rule: Vec<String> = (0..header.len()).map(|i| if i < names { "---" } else { "---:" }.to_owned()).collect();
    text.push('\n');
    for cells in [header.to_vec(), rule].into_iter().chain(rows) {
        // Writing to a text cannot fail.
        let _ = writeln!(text, "| {} |", cells.join(" | "));
    }
}

/// Words in lines of at most `width` columns, two spaces between words that share one. A longer word has a line of its own.
pub fn fill(words: impl IntoIterator<Item = String>, width: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in words {
        match lines.last_mut() {
            Some(line) if console::measure_text_width(line) + 2 + console::measure_text_width(&word) <= width => {
                line.push_str("  ");
                line.push_str(&word);
            }
            _ => lines.push(word),
        }
    }
    lines
}

/// Names of the challenges in tables, as papers write them.
fn short(challenge: Challenge) -> &'static str {
    match challenge {
        Challenge::NonReactive => "NR",
        Challenge::Reactive => "R",
        Challenge::OpenLoop => "OLS",
    }
}

fn percent(score: f64) -> String {
    fixed(score * 100.0, 2)
}

fn percent_or_dash(score: Option<f64>) -> String {
    score.map_or_else(|| "-".to_owned(), percent)
}
