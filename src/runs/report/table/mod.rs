//! Tables of results, printed to the terminal or to Markdown.

mod failures;
mod markdown;
mod overview;
mod paired;
mod simulations;
pub mod terminal;

pub use failures::failures;
pub use paired::comparison_table;
pub use terminal::fill;

use super::number::fixed;
use super::simulation_row::SimulationRow;
use super::summary::Summary;
use super::timing::PlannerTiming;
use super::visible::visible_line;
use planagent_agent::simulation::Challenge;
use planagent_score::metrics::MetricList;

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Table {
    headers: Vec<String>,
    alignment: Vec<Alignment>,
    rows: Vec<Vec<String>>,
}

/// Where the text of a column stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Alignment {
    Left,
    Right,
}

impl Table {
    /// A table whose first `names` columns are text; the others are numbers.
    pub fn new(
        headers: impl IntoIterator<Item = impl Into<String>>,
        names: usize,
        rows: impl IntoIterator<Item = Vec<String>>,
    ) -> Self {
        let headers: Vec<String> = headers.into_iter().map(Into::into).collect();
        let side = |column| {
            if column < names {
                Alignment::Left
            } else {
                Alignment::Right
            }
        };
        // Names come from recordings and models.
        let shown = |row: Vec<String>| {
            row.into_iter()
                .map(|cell| visible_line(&cell).into_owned())
                .collect()
        };
        Self {
            alignment: (0..headers.len()).map(side).collect(),
            headers,
            rows: rows.into_iter().map(shown).collect(),
        }
    }
}

/// The tables of a run: planners, scenario types if there are several, simulations, and the
/// multipliers that made scores 0. Then come the planning calls whose attempts were all refused,
/// and one legend.
pub fn main_table(
    summary: &Summary,
    planners: &[PlannerTiming],
    rows: &[SimulationRow],
    width: u16,
) -> String {
    let scored = |list| {
        rows.iter()
            .any(|row| row.score.is_some() && row.challenge.metric_list() == list)
    };
    let lists = [MetricList::ClosedLoop, MetricList::OpenLoop]
        .into_iter()
        .filter(|&list| scored(list));
    let mut parts = vec![
        overview::planners(summary, planners),
        overview::scenario_types(summary, width),
    ];
    let lists: Vec<MetricList> = lists.collect();
    parts.extend(lists.iter().map(|&list| simulations::table(rows, list)));
    parts.push(simulations::zeroed(rows));
    parts.push(simulations::refused(rows));
    parts.push(simulations::legend(rows, &lists, width));
    parts.retain(|part| !part.is_empty());
    parts.join("\n\n")
}

/// Names of the challenges in tables, as papers write them.
pub fn short(challenge: Challenge) -> &'static str {
    match challenge {
        Challenge::NonReactive => "NR",
        Challenge::Reactive => "R",
        Challenge::OpenLoop => "OLS",
        own => own.short_name(),
    }
}

/// The text of a value, or a dash.
pub fn or_dash<T>(value: Option<T>, text: impl FnOnce(T) -> String) -> String {
    value.map_or_else(|| "-".to_owned(), text)
}

/// A score in [0, 1], times 100.
fn percent(score: f64) -> String {
    fixed(score * 100.0, 2)
}

/// A difference of scores with its sign, unless it rounds to zero.
pub fn signed(value: f64) -> String {
    let text = fixed(value, 2);
    if value > 0.0 && text != "0.00" {
        format!("+{text}")
    } else {
        text
    }
}

/// A measurement with three significant digits.
pub fn three_digits(value: f64) -> String {
    let decimals = match value.abs() {
        size if size >= 100.0 => 0,
        size if size >= 10.0 => 1,
        size if size >= 0.1 => 2,
        _ => 4,
    };
    fixed(value, decimals)
}

/// Measurements with equal decimals: as many as the smallest needs for two significant digits, at
/// most three.
fn measurements(values: &[Option<f64>]) -> Vec<String> {
    let smallest = values
        .iter()
        .flatten()
        .map(|value| value.abs())
        .filter(|size| *size > 0.0)
        .fold(f64::INFINITY, f64::min);
    let decimals = match smallest {
        size if size >= 10.0 => 0,
        size if size >= 1.0 => 1,
        size if size >= 0.1 => 2,
        _ => 3,
    };
    values
        .iter()
        .map(|value| or_dash(*value, |value| fixed(value, decimals)))
        .collect()
}

/// A number of weights in millions or billions.
pub fn weights(count: u64) -> String {
    let (million, billion) = (1e6, 1e9);
    let count = count as f64;
    if count < billion {
        format!("{:.1} M", count / million)
    } else {
        format!("{:.2} B", count / billion)
    }
}
