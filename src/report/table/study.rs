//! The tables of an experiment.

use super::{markdown, plain, short};
use crate::experiment::statistics::PairedDifference;
use crate::experiment::study::{Column, Rows, Study};
use crate::report::number::fixed;
use crate::report::{ChallengeResults, StudyResults, SuiteResults, VariantResults};
use crate::simulation::Challenge;
use std::fmt::Write as _;

/// Columns of a terminal that the tables are made for.
const COLUMNS: usize = 80;
const BILLION: f64 = 1e9;
const MILLION: f64 = 1e6;

/// A table with its texts to the left and its numbers to the right of column `texts`.
struct Sheet {
    header: Vec<String>,
    texts: usize,
    rows: Vec<Vec<String>>,
}

/// The tables for a terminal of 80 columns: one for each suite and challenge.
pub fn study_table(study: &Study, results: &StudyResults) -> String {
    let mut parts = vec![results.title.to_owned()];
    for suite in &results.suites {
        for challenge in Challenge::CLOSED_LOOP {
            let heading = format!("{}, {}: {} scenes", suite.name, traffic(challenge), suite.scenes);
            let sheet = scores(study, suite, &[challenge], Width::Narrow);
            parts.push(format!("{heading}\n{}", terminal(sheet, study.rows)));
        }
        parts.extend(costs(study, suite).map(|sheet| plain(&sheet.header, sheet.rows, sheet.texts)));
    }
    parts.push(notes(study, results).iter().flat_map(|note| wrapped(note)).collect::<Vec<_>>().join("\n"));
    parts.join("\n\n")
}

/// The same as Markdown, both challenges in one table; `command` made it, and `figures` lie beside it.
pub fn study_markdown(study: &Study, results: &StudyResults, command: &str, figures: &[String]) -> String {
    let mut text = format!("# {}\n\n```console\n$ {command}\n```\n", results.title);
    for suite in &results.suites {
        // Writing to a text cannot fail.
        let _ = writeln!(text, "\n## {}: {} scenes", suite.name, suite.scenes);
        let sheet = scores(study, suite, &Challenge::CLOSED_LOOP, Width::Wide);
        markdown(&mut text, &sheet.header, sheet.texts, sheet.rows.into_iter());
        if let Some(sheet) = costs(study, suite) {
            markdown(&mut text, &sheet.header, sheet.texts, sheet.rows.into_iter());
        }
        for figure in figures.iter().filter(|name| **name == format!("{}.svg", suite.name)) {
            let _ = writeln!(text, "\n![{} on {}]({figure})", results.title, suite.name);
        }
    }
    text.push('\n');
    for note in notes(study, results) {
        let _ = writeln!(text, "- {note}");
    }
    text
}

/// How much a table may hold.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Width {
    /// 80 columns.
    Narrow,
    /// Any number.
    Wide,
}

/// The table of scores.
fn scores(study: &Study, suite: &SuiteResults, challenges: &[Challenge], width: Width) -> Sheet {
    match study.rows {
        Rows::Variants => variants(study, suite, challenges, width),
        Rows::ScenarioTypes => scenario_types(suite, challenges, width),
    }
}

/// A row a variant: score, difference with interval, and what the paper has.
fn variants(study: &Study, suite: &SuiteResults, challenges: &[Challenge], width: Width) -> Sheet {
    let mut header: Vec<String> = study.labels.iter().map(|&label| label.to_owned()).collect();
    let texts = header.len();
    let paper = suite.variants.iter().flat_map(|variant| &variant.challenges).any(|result| result.paper.is_some());
    for &challenge in challenges {
        header.extend([short(challenge), "diff", "95 % interval"].map(str::to_owned));
        if paper {
            header.push(if width == Width::Wide { format!("paper {}", short(challenge)) } else { "paper".to_owned() });
        }
        if paper && width == Width::Wide {
            header.push("paper diff".to_owned());
        }
    }
    let rows = study.variants.iter().zip(&suite.variants).enumerate().map(|(place, (variant, results))| {
        let mut cells: Vec<String> = variant.labels.iter().map(|&label| label.to_owned()).collect();
        for result in results.challenges.iter().filter(|result| challenges.contains(&result.challenge)) {
            cells.push(results.not_simulated.map_or_else(|| number(result.score), str::to_owned));
            cells.extend(difference(result.difference, place == study.reference));
            if paper {
                cells.push(number(result.paper));
            }
            if paper && width == Width::Wide {
                cells.push(result.paper_difference.map_or_else(dash, signed));
            }
        }
        cells
    });
    Sheet { rows: rows.collect(), header, texts }
}

/// A row a scenario type: the scores of all variants, and the difference of the last to the first.
fn scenario_types(suite: &SuiteResults, challenges: &[Challenge], width: Width) -> Sheet {
    let names = suite.variants.iter().map(|variant| variant.name.clone());
    let mut header = vec!["type".to_owned(), "n".to_owned()];
    for &challenge in challenges {
        let named = |name: String| if width == Width::Wide { format!("{name} {}", short(challenge)) } else { name };
        header.extend(names.clone().map(named).chain(["diff", "95 % interval"].map(str::to_owned)));
    }
    let kinds = suite.variants.first().map_or(&[][..], |variant| &variant.scenario_types);
    let rows = kinds.iter().map(|kind| {
        let of_kind = |variant: &VariantResults, challenge: Challenge| -> Option<ChallengeResults> {
            let own = variant.scenario_types.iter().find(|own| own.scenario_type == kind.scenario_type)?;
            own.challenges.iter().find(|result| result.challenge == challenge).cloned()
        };
        let scenes = kind.challenges.first().map_or(0, |result| result.simulations + result.failed);
        let mut cells = vec![kind.scenario_type.clone(), scenes.to_string()];
        for &challenge in challenges {
            let results: Vec<_> = suite.variants.iter().map(|variant| of_kind(variant, challenge)).collect();
            cells.extend(results.iter().map(|result| number(result.as_ref().and_then(|result| result.score))));
            cells.extend(difference(results.last().and_then(|result| result.as_ref()?.difference), false));
        }
        cells
    });
    Sheet { rows: rows.collect(), header, texts: 1 }
}

/// What the study tells beside scores; none where it tells nothing.
fn costs(study: &Study, suite: &SuiteResults) -> Option<Sheet> {
    let mut header: Vec<String> = study.labels.iter().map(|&label| label.to_owned()).collect();
    let texts = header.len();
    for column in study.columns {
        let heads: &[&str] = match column {
            Column::Calls => &["calls/sim"],
            Column::Parameters => &["params", "paper"],
            Column::CallTime => &["ms/call p50", "paper ms"],
        };
        header.extend(heads.iter().map(|&head| head.to_owned()));
    }
    let rows = study.variants.iter().zip(&suite.variants).map(|(variant, results)| {
        let mut cells: Vec<String> = variant.labels.iter().map(|&label| label.to_owned()).collect();
        let model = results.model.as_ref();
        let paper = model.and_then(|model| model.paper);
        for column in study.columns {
            match column {
                Column::Calls => cells.push(results.calls_per_simulation.map_or_else(dash, |calls| fixed(calls, 1))),
                Column::Parameters => cells.extend([
                    model.and_then(|model| model.parameters).map_or_else(dash, weights),
                    paper.and_then(|paper| paper.parameters).map_or_else(dash, str::to_owned),
                ]),
                Column::CallTime => cells.extend([
                    model.and_then(|model| model.call_ms).map_or_else(dash, |ms| fixed(ms, usize::from(ms < 100.0))),
                    paper.map_or_else(dash, |paper| paper.time_ms.to_string()),
                ]),
            }
        }
        cells
    });
    (!study.columns.is_empty()).then(|| Sheet { rows: rows.collect(), header, texts })
}

/// What a reader has to know of the numbers.
fn notes(study: &Study, results: &StudyResults) -> Vec<String> {
    let mut notes = Vec::new();
    if let Some(quick) = results.quick {
        notes.push(format!("Quick: only the first {} scenes of each type; intervals are wide.", quick.per_type));
    }
    let bootstrap = results.bootstrap;
    notes.push(format!(
        "NR, R = replayed, reactive traffic; nuPlan's score x 100. diff = score minus that of {} on the same scenes; its \
         interval holds {} % of {} means over scenes drawn anew (percentile bootstrap, seed {}).",
        results.reference,
        fixed(bootstrap.level * 100.0, 0),
        bootstrap.resamples,
        bootstrap.seed
    ));
    for suite in &results.suites {
        let shown = suite.variants.iter().flat_map(|variant| &variant.challenges).any(|result| result.paper.is_some());
        if let Some(benchmark) = suite.benchmark.filter(|_| shown) {
            let (paper, name) = (benchmark.name(), &suite.name);
            notes.push(format!(
                "paper = the paper's on nuPlan's {paper}: other scenes than {name}, for the direction alone."
            ));
        }
    }
    if results.suites.iter().flat_map(|suite| &suite.variants).any(|v| v.model.as_ref().is_some_and(|m| m.benched)) {
        notes.push("Times of models that were not simulated come from a bench's.".to_owned());
    }
    notes.extend(study.remarks.iter().map(|&remark| remark.to_owned()));
    for suite in &results.suites {
        for variant in &suite.variants {
            let failed: usize = variant.challenges.iter().map(|result| result.failed).sum();
            if failed > 0 {
                let (name, suite) = (&variant.name, &suite.name);
                notes.push(format!("{failed} simulations of {name} on {suite} failed and count in no mean."));
            }
        }
    }
    notes
}

fn traffic(challenge: Challenge) -> &'static str {
    match challenge {
        Challenge::NonReactive => "replayed traffic",
        Challenge::Reactive => "reactive traffic",
        Challenge::OpenLoop => "open loop",
    }
}

/// A table of the terminal.
fn terminal(sheet: Sheet, rows: Rows) -> String {
    match rows {
        Rows::Variants => plain(&sheet.header, sheet.rows, sheet.texts),
        Rows::ScenarioTypes => below_names(sheet),
    }
}

/// The first cell of each row on a line of its own and the others below it: names of types are long.
fn below_names(mut sheet: Sheet) -> String {
    let rows = std::iter::once(&mut sheet.header).chain(&mut sheet.rows);
    let names: Vec<String> = rows.filter(|row| !row.is_empty()).map(|row| row.remove(0)).collect();
    let table = plain(&sheet.header, sheet.rows, 0);
    names
        .iter()
        .map(String::as_str)
        .zip(table.lines())
        .flat_map(|(name, line)| [name, line])
        .collect::<Vec<_>>()
        .join("\n")
}

/// The difference and its interval.
fn difference(difference: Option<PairedDifference>, is_reference: bool) -> [String; 2] {
    match difference {
        Some(PairedDifference { mean, low, high, .. }) => {
            [signed(mean), format!("{} to {}", signed(low), signed(high))]
        }
        None if is_reference => [dash(), "reference".to_owned()],
        None => [dash(), dash()],
    }
}

/// With its sign, unless it rounds to zero.
fn signed(value: f64) -> String {
    let text = fixed(value, 2);
    if value > 0.0 && text != "0.00" { format!("+{text}") } else { text }
}

fn number(value: Option<f64>) -> String {
    value.map_or_else(dash, |value| fixed(value, 2))
}

fn weights(count: u64) -> String {
    let count = count as f64;
    if count < BILLION { format!("{:.1} M", count / MILLION) } else { format!("{:.1} B", count / BILLION) }
}

fn dash() -> String {
    "-".to_owned()
}

/// A sentence in lines of a terminal.
fn wrapped(text: &str) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if line.chars().count() + 1 + word.chars().count() <= COLUMNS => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}
