//! Tables of results, printed to the terminal, to Markdown or to HTML.

mod failures;
mod html;
mod markdown;
mod overview;
mod paired;
mod simulations;
pub mod terminal;

pub(crate) use failures::Failure;
pub use failures::failures;
pub use paired::comparison_table;
pub use terminal::{LineWidth, fill};

use super::number::fixed;
use super::simulation_row::SimulationRow;
use super::summary::Summary;
use super::timing::PlannerTiming;
use super::visible::{visible, visible_line};
use planagent_agent::simulation::Challenge;
use planagent_score::metrics::{MetricList, distinct};
use simulations::SimulationTable;

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Table {
    headers: Vec<String>,
    alignment: Vec<Alignment>,
    rows: Vec<Vec<String>>,
    /// Columns between two columns.
    gap: usize,
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
        // A header may have several lines.
        let headers: Vec<String> = headers
            .into_iter()
            .map(|header| visible(&header.into()).into_owned())
            .collect();
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
            gap: terminal::GAP,
        }
    }
}

/// Simulations from which on the worst ones are listed apart.
const MANY: usize = 10;

/// The tables of a run, the means last, where a terminal shows them: simulations, the multipliers
/// that made scores 0, the planning calls whose attempts were all refused, the legend, the means by
/// scenario type if there are several, the worst simulations of many, and the means of planners.
pub fn main_table(
    summary: &Summary,
    planners: &[PlannerTiming],
    rows: &[SimulationRow],
    width: LineWidth,
) -> String {
    let scored = |list| {
        rows.iter()
            .any(|row| row.score.is_some() && row.challenge.metric_list() == list)
    };
    let lists: Vec<MetricList> = [MetricList::ClosedLoop, MetricList::OpenLoop]
        .into_iter()
        .filter(|&list| scored(list))
        .collect();
    let tables = lists
        .iter()
        .map(|&list| SimulationTable::new(rows, list, width));
    let tables: Vec<SimulationTable> = tables.collect();
    let types = overview::scenario_types(summary, width);
    let labels = tables.iter().flat_map(SimulationTable::labels);
    let mut meanings: Vec<String> = distinct(labels)
        .into_iter()
        .filter(|(label, name)| label != name)
        .map(|(label, name)| format!("{label} = {name}"))
        .collect();
    meanings.extend(overview::meanings(summary, planners, !types.is_empty()));
    let mut parts: Vec<String> = tables.into_iter().map(SimulationTable::text).collect();
    // From the single simulation to the means, because a terminal shows the end.
    parts.push(simulations::zeroed(rows, width));
    parts.push(simulations::refused(rows, width));
    parts.push(simulations::without_plan(rows, width));
    parts.push(simulations::legend(rows, &lists, meanings, width));
    parts.push(types);
    parts.push(simulations::worst(rows, width));
    parts.push(overview::planners(summary, planners, width));
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

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::report::paired::{ComparedScene, ComparedScores, PlannerPair, RunComparison};
    use crate::report::simulation_row::MetricScore;
    use crate::worker::statistics::{Bootstrap, PairedDifference};
    use console::measure_text_width;

    /// The widths of terminals that tables are made for.
    const TERMINALS: [u16; 4] = [60, 80, 100, 160];
    /// The scenario type with the longest name.
    const LONGEST: &str = "starting_straight_traffic_light_intersection_traversal";

    /// Fails if a line of a text is wider than a terminal.
    pub(super) fn assert_fits(text: &str, columns: u16) {
        let wide = text
            .lines()
            .find(|line| measure_text_width(line) > usize::from(columns));
        assert!(wide.is_none(), "wider than {columns}: {wide:?}\n{text}");
    }

    /// A simulation whose metrics are 1, apart from the progress.
    fn row(kind: &str, seed: usize, planner: &str, score: f64) -> SimulationRow {
        let challenge = if seed.is_multiple_of(2) {
            Challenge::NonReactive
        } else {
            Challenge::Reactive
        };
        let mut row = SimulationRow::example(kind, seed, planner, challenge, Some(score));
        let metric = |name: &str, value: f64| MetricScore {
            name: name.to_owned(),
            score: Some(value),
        };
        row.metrics = MetricList::ClosedLoop
            .scored()
            .map(|spec| metric(spec.name, if spec.label == "prog" { score } else { 1.0 }))
            .collect();
        row
    }

    fn summary(rows: &[SimulationRow]) -> Summary {
        Summary::new(0, None, &[], rows)
    }

    fn shown(rows: &[SimulationRow], width: LineWidth) -> String {
        console::set_colors_enabled(false);
        let planners = distinct(rows.iter().map(|row| row.planner.as_str()));
        let timings = planners
            .iter()
            .map(|name| PlannerTiming::from_rows(name, rows));
        main_table(&summary(rows), &timings.collect::<Vec<_>>(), rows, width)
    }

    #[test]
    fn the_tables_of_a_run_fit_every_terminal() {
        let own = "a-planner-of-ones-own-with-a-name-of-more-columns-than-a-terminal";
        let mut rows = Vec::new();
        for planner in ["plan-agent", "raster-model-small", own] {
            for seed in 0..6 {
                rows.push(row(LONGEST, seed, planner, 0.5 + seed as f64 / 20.0));
                rows.push(row("changing_lane", seed, planner, 1.0));
            }
        }
        let mut kind = row("approaching_construction_zone", 2, "idm", 0.0);
        kind.scenario = format!("generated/{LONGEST}/2~approaching_construction_zone");
        let passed = "ego_sorts_construction_zone".to_owned();
        kind.metrics.extend([
            MetricScore {
                name: "lane_changes_to_goal".to_owned(),
                score: Some(0.5),
            },
            MetricScore {
                name: passed.clone(),
                score: Some(0.0),
            },
        ]);
        kind.zeroed_by = vec![passed.clone()];
        rows.push(kind);
        for terminal in TERMINALS {
            let text = shown(&rows, LineWidth::terminal(terminal));
            assert_fits(&text, terminal);
            assert!(text.contains("raster-model-small"), "{text}");
            assert!(text.contains(&passed), "{text}");
            assert!(text.contains("lanes 0.50"), "{text}");
        }
        // In a pipe a name stays in one line, so that it can be found.
        let text = shown(&rows, LineWidth::PIPE);
        assert!(
            text.contains(&format!(
                "\ngenerated/{LONGEST}/2~approaching_construction_zone\n"
            )),
            "{text}"
        );
    }

    #[test]
    fn means_and_the_worst_simulations_come_last_and_the_legend_names_every_column() {
        let rows: Vec<SimulationRow> = (0..12)
            .map(|seed| row("changing_lane", seed, "idm", 1.0 - seed as f64 / 100.0))
            .collect();
        let text = shown(&rows, LineWidth::PIPE);
        let place = |what: &str| {
            text.find(what)
                .unwrap_or_else(|| panic!("no {what}: {text}"))
        };
        let (worst, means) = (place("lowest scores"), place("ms/step  "));
        assert!(place("score = ") < worst && worst < means, "{text}");
        let lowest = text.get(worst..means).unwrap();
        let scenarios: Vec<&str> = lowest
            .lines()
            .filter(|line| line.starts_with("generated/"))
            .collect();
        assert_eq!(
            scenarios,
            [11, 10, 9, 8, 7].map(|seed| format!("generated/changing_lane/{seed}")),
            "{text}"
        );
        for label in [
            "coll", "area", "moves", "dir", "prog", "TTC", "speed", "comf", "calls",
        ] {
            assert!(text.contains(&format!("{label} = ")), "{label}: {text}");
        }
        assert!(
            text.contains("ms/step = ") && text.contains("NR, R = "),
            "{text}"
        );
        // A few simulations are all seen at once.
        let text = shown(rows.get(..3).unwrap(), LineWidth::PIPE);
        assert!(!text.contains("lowest scores"), "{text}");
    }

    #[test]
    fn a_comparison_fits_every_terminal() {
        console::set_colors_enabled(false);
        let planners = PlannerPair {
            first: "plan-agent".to_owned(),
            second: "a-planner-of-the-future".to_owned(),
        };
        let challenge = Challenge::NonReactive;
        let difference = PairedDifference {
            mean: -12.5,
            low: -100.0,
            high: 75.25,
            pairs: 1200,
            clusters: 1200,
        };
        let scores = |scenario_type: Option<&str>| ComparedScores {
            planners: planners.clone(),
            challenge,
            scenario_type: scenario_type.map(str::to_owned),
            first: 100.0,
            second: 87.5,
            difference,
        };
        let scene = |seed: usize| ComparedScene {
            scenario: format!("generated/{LONGEST}/{seed}"),
            scenario_type: LONGEST.to_owned(),
            planners: planners.clone(),
            challenge,
            first: 50.0,
            second: seed as f64,
        };
        let comparison = RunComparison {
            bootstrap: Bootstrap::default(),
            differences: vec!["config.reasoning.prompt_set: \"paper\" and \"brief\"".repeat(3)],
            scores: vec![scores(None)],
            scenario_types: vec![scores(Some(LONGEST)), scores(Some("changing_lane"))],
            scenes: (0..100).map(scene).collect(),
            unpaired: 3,
        };
        for terminal in TERMINALS {
            let width = LineWidth::terminal(terminal);
            let names = ["runs/a/folder/of/some/length/0001", "runs/0002"];
            let text = comparison_table(&comparison, names, true, width);
            assert_fits(&text, terminal);
            assert!(text.contains("-100.00 to +75.25"), "{text}");
        }
    }
}
