//! The tables of a study.

use super::costs::{self, costs};
use super::{recordings, reported};
use crate::report::figure::AGREEMENT;
use crate::report::{ChallengeResults, StudyResults, SuiteResults, VariantResults};
use crate::study::{Column, Rows, Study, Variant};
use planagent_agent::simulation::Challenge;
use planagent_runs::report::table::{LineWidth, Table, or_dash, short, signed};
use planagent_runs::report::{fixed, markdown_block, markdown_line, visible, visible_line};
use planagent_runs::worker::statistics::PairedDifference;
use std::fmt::Write as _;

/// The tables for a terminal: one for each suite and challenge.
pub fn study_table(study: &Study, results: &StudyResults, width: LineWidth) -> String {
    let headed = |text: &str| width.wrapped(&visible_line(text)).join("\n");
    let mut parts = vec![headed(&results.title)];
    for suite in &results.suites {
        let challenges = suite.challenges();
        for &challenge in &challenges {
            let heading = format!(
                "{}, {}: {} scenes",
                visible_line(&suite.name),
                agents(challenge),
                suite.scenes
            );
            let table = scores(study, suite, &[challenge], Layout::Narrow);
            let table = match study.rows {
                Rows::Variants | Rows::Recordings => table.fitted(width),
                Rows::ScenarioTypes => table.fitted_below_names(width),
            };
            parts.push(format!("{}\n{table}", headed(&heading)));
        }
        parts.extend(costs(study, suite).map(|table| table.fitted(width)));
        if study.rows == Rows::Recordings {
            parts.push(recordings::calls(study, suite).fitted_below_names(width));
            parts.extend(challenges.into_iter().map(|challenge| {
                let table = recordings::recordings(suite, &[challenge]).fitted_below_names(width);
                format!(
                    "{}, {}: each recording\n{table}",
                    visible_line(&suite.name),
                    agents(challenge)
                )
            }));
        }
    }
    // In a terminal the table of reported scores would be too wide; it stands in results.md.
    parts.extend(reported::agreement(results).map(|table| table.fitted(width)));
    parts.push(
        notes(study, results)
            .iter()
            .flat_map(|note| width.wrapped(&visible(note)))
            .collect::<Vec<_>>()
            .join("\n"),
    );
    parts.join("\n\n")
}

/// The same as Markdown, all challenges in one table, with the `command` and the `figures` of the
/// folder.
pub(crate) fn study_markdown(
    study: &Study,
    results: &StudyResults,
    command: &str,
    figures: &[String],
) -> String {
    let mut text = format!(
        "# {}\n\n{}\n",
        markdown_line(&results.title),
        markdown_block("console", &format!("$ {command}"))
    );
    for suite in &results.suites {
        // Writing to a string cannot fail.
        let name = markdown_line(&suite.name);
        let _ = writeln!(text, "\n## {name}: {} scenes", suite.scenes);
        let challenges = suite.challenges();
        let table = scores(study, suite, &challenges, Layout::Wide);
        let of_recordings = (study.rows == Rows::Recordings).then(|| {
            [
                recordings::calls(study, suite),
                recordings::recordings(suite, &Challenge::CLOSED_LOOP),
            ]
        });
        for table in std::iter::once(table)
            .chain(costs(study, suite))
            .chain(of_recordings.into_iter().flatten())
        {
            let _ = write!(text, "\n{}", table.markdown());
        }
        for figure in figures
            .iter()
            .filter(|name| **name == format!("{}.svg", suite.name))
        {
            let title = markdown_line(&results.title);
            let _ = writeln!(text, "\n![{title} on {name}]({figure})");
        }
    }
    if let Some(table) = reported::reported(study) {
        let _ = write!(text, "\n## Reported scores\n\n{}", table.markdown());
    }
    if let Some(table) = reported::agreement(results) {
        let _ = write!(text, "\n## Agreement of the orders\n\n{}", table.markdown());
        for figure in figures.iter().filter(|name| *name == AGREEMENT) {
            let _ = writeln!(text, "\n![scores here and reported]({figure})");
        }
    }
    text.push('\n');
    for note in notes(study, results) {
        let _ = writeln!(text, "- {}", markdown_line(&note));
    }
    text
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Layout {
    /// A terminal.
    Narrow,
    /// Markdown, of any width.
    Wide,
}

fn scores(study: &Study, suite: &SuiteResults, challenges: &[Challenge], layout: Layout) -> Table {
    match study.rows {
        Rows::Variants | Rows::Recordings => variants(study, suite, challenges, layout),
        Rows::ScenarioTypes => scenario_types(suite, challenges, layout),
    }
}

/// A row for each variant: score, difference with interval, and the paper's values.
fn variants(
    study: &Study,
    suite: &SuiteResults,
    challenges: &[Challenge],
    layout: Layout,
) -> Table {
    let mut headers = study.labels.clone();
    let paper = has_paper(suite);
    for &challenge in challenges {
        headers.extend([short(challenge), "diff", "95 % interval"].map(str::to_owned));
        // A terminal has room for the paper's score and none for its difference.
        match layout {
            Layout::Narrow if paper => headers.push("paper".to_owned()),
            Layout::Wide if paper => headers.extend([
                format!("paper {}", short(challenge)),
                "paper diff".to_owned(),
            ]),
            _ => {}
        }
    }
    let rows = rows_of(study, suite)
        .enumerate()
        .map(|(place, (variant, results))| {
            let mut cells = variant.labels.clone();
            for result in results
                .challenges
                .iter()
                .filter(|result| challenges.contains(&result.challenge))
            {
                cells.push(
                    results
                        .not_simulated
                        .map_or_else(|| number(result.score), str::to_owned),
                );
                cells.extend(difference(result.difference, place == study.reference));
                cells.extend(paper.then(|| number(result.paper)));
                cells.extend(
                    (paper && layout == Layout::Wide)
                        .then(|| or_dash(result.paper_difference, signed)),
                );
            }
            cells
        });
    Table::new(headers, study.labels.len(), rows)
}

/// A row for each scenario type: the scores of all variants, and the difference of the last to the
/// first.
fn scenario_types(suite: &SuiteResults, challenges: &[Challenge], layout: Layout) -> Table {
    let names = suite.variants.iter().map(|variant| variant.name.clone());
    let mut headers = vec!["type".to_owned(), "n".to_owned()];
    for &challenge in challenges {
        let named = |name: String| {
            if layout == Layout::Wide {
                format!("{name} {}", short(challenge))
            } else {
                name
            }
        };
        headers.extend(
            names
                .clone()
                .map(named)
                .chain(["diff", "95 % interval"].map(str::to_owned)),
        );
    }
    let kinds = suite
        .variants
        .first()
        .map_or(&[][..], |variant| &variant.scenario_types);
    let rows = kinds.iter().map(|kind| {
        let of_kind =
            |variant: &VariantResults, challenge: Challenge| -> Option<ChallengeResults> {
                let own = variant
                    .scenario_types
                    .iter()
                    .find(|own| own.scenario_type == kind.scenario_type)?;
                own.challenges
                    .iter()
                    .find(|result| result.challenge == challenge)
                    .cloned()
            };
        let shown = kind
            .challenges
            .iter()
            .find(|result| challenges.contains(&result.challenge));
        // Failed simulations are scenes too: the count must not depend on the variant.
        let scenes = shown.map_or(0, |result| result.simulations + result.failed);
        let mut cells = vec![kind.scenario_type.clone(), scenes.to_string()];
        for &challenge in challenges {
            let results: Vec<_> = suite
                .variants
                .iter()
                .map(|variant| of_kind(variant, challenge))
                .collect();
            cells.extend(
                results
                    .iter()
                    .map(|result| number(result.as_ref().and_then(|result| result.score))),
            );
            cells.extend(difference(
                results
                    .last()
                    .and_then(|result| result.as_ref()?.difference),
                false,
            ));
        }
        cells
    });
    Table::new(headers, 1, rows)
}

pub(super) fn rows_of<'a>(
    study: &'a Study,
    suite: &'a SuiteResults,
) -> impl Iterator<Item = (&'a Variant, &'a VariantResults)> {
    study.variants.iter().zip(&suite.variants)
}

fn has_paper(suite: &SuiteResults) -> bool {
    suite
        .variants
        .iter()
        .flat_map(|variant| &variant.challenges)
        .any(|result| result.paper.is_some())
}

/// The explanations below the tables.
fn notes(study: &Study, results: &StudyResults) -> Vec<String> {
    let mut notes = Vec::new();
    if let Some(quick) = results.quick {
        notes.push(format!(
            "Quick: only the first {} scenes of each type; intervals are wide.",
            quick.per_type
        ));
    }
    let bootstrap = results.bootstrap;
    notes.push(format!(
        "NR, R = non-reactive, reactive agents; nuPlan's score x 100. diff = score minus that of {} on the same scenes. Its \
         {} % interval is a percentile bootstrap over {} ({} resamples, seed {}).",
        results.reference,
        fixed(bootstrap.level * 100.0, 0),
        if study.rows == Rows::Recordings { "recordings" } else { "scenes" },
        bootstrap.resamples,
        bootstrap.seed
    ));
    for suite in results.suites.iter().filter(|suite| has_paper(suite)) {
        if let Some(benchmark) = suite.benchmark {
            let (paper, name) = (benchmark.name(), &suite.name);
            notes.push(format!(
                "paper = the paper's result on nuPlan's {paper}. Its scenes differ from {name}: compare only the direction."
            ));
        }
    }
    if results
        .suites
        .iter()
        .any(|suite| !suite.agreement.is_empty())
    {
        notes.push(reported::NOTE.to_owned());
    }
    let variants = || {
        results
            .suites
            .iter()
            .flat_map(|suite| suite.variants.iter().map(move |variant| (suite, variant)))
    };
    if variants().any(|(_, variant)| variant.model.as_ref().is_some_and(|model| model.benched)) {
        notes.push("Times of models that were not simulated are from a bench.".to_owned());
    }
    if study.columns.contains(&Column::Lost) {
        notes.push(costs::LOST_NOTE.to_owned());
    }
    notes.extend(study.remarks.iter().cloned());
    // Failures come last, closest to the prompt of the terminal.
    for (suite, variant) in variants() {
        let failed: usize = variant.challenges.iter().map(|result| result.failed).sum();
        if failed > 0 {
            let (name, suite) = (&variant.name, &suite.name);
            notes.push(format!(
                "{failed} simulations of {name} on {suite} failed and do not count."
            ));
        }
    }
    notes
}

fn agents(challenge: Challenge) -> &'static str {
    match challenge {
        Challenge::NonReactive => "non-reactive agents",
        Challenge::Reactive => "reactive agents",
        Challenge::OpenLoop => "open loop",
        own => own.short_name(),
    }
}

/// The difference and its interval.
fn difference(difference: Option<PairedDifference>, is_reference: bool) -> [String; 2] {
    let missing = if is_reference { "reference" } else { "-" };
    [
        or_dash(difference, |d| signed(d.mean)),
        difference.map_or_else(|| missing.to_owned(), |d| d.interval(signed)),
    ]
}

fn number(value: Option<f64>) -> String {
    or_dash(value, |value| fixed(value, 2))
}
