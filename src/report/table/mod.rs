//! Tables for the terminal, readable at 80 columns.

mod drives;
mod overview;

use super::drive_row::DriveRow;
use super::summary::Summary;
use super::timing::PlannerTiming;
use crate::simulation::Challenge;
use comfy_table::{CellAlignment, Table, presets};

pub use drives::failures;

/// The main table (a row a planner), the scenario types when there are several, the drives with their metrics up to a
/// number, a legend, and what made scores 0.
pub fn main_table(summary: &Summary, planners: &[PlannerTiming], rows: &[DriveRow], width: u16) -> String {
    let parts = [
        overview::planners(summary, planners),
        overview::scenario_types(summary, width),
        drives::drives(rows),
        drives::legend(width),
        drives::zeroed(rows),
    ];
    parts.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join("\n\n")
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

/// Names of the challenges in tables, as papers write them.
fn short(challenge: Challenge) -> &'static str {
    match challenge {
        Challenge::ClosedLoopNonreactiveAgents => "NR",
        Challenge::ClosedLoopReactiveAgents => "R",
    }
}

fn percent(score: f64) -> String {
    format!("{:.2}", score * 100.0)
}

fn percent_or_dash(score: Option<f64>) -> String {
    score.map_or_else(|| "-".to_owned(), percent)
}
