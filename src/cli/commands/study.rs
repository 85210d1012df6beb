//! `planagent study`.

use crate::args::{ALL_STUDIES, StudyArguments};
use crate::progress::listener;
use crate::{Exit, Printer, interrupt};
use anyhow::anyhow;
use planagent_lab::report::{ChallengeResults, StudyResults, study_table, token_table, twin_table};
use planagent_lab::study::{self, StudyError};
use planagent_lab::study_runs::{Studies, StudyOutcome, SuiteTokens, TOKENS, TOKENS_TITLE, TWINS};
use planagent_lab::twins::TwinResults;
use planagent_runs::report::failures;
use planagent_runs::runner::Config;
use serde::Serialize;
use std::path::Path;

/// Runs the simulations of studies that are not completed; the results go to a folder, the
/// tables to stdout.
pub(crate) fn run(
    flags: &StudyArguments,
    config: &Config,
    printer: Printer,
) -> anyhow::Result<Exit> {
    check_name(&flags.name)?;
    interrupt::advise("the same command goes on", printer)?;
    let (request, listener) = (flags.request()?, listener(printer));
    let mut studies = Studies::new(&request, config, &listener)?;
    let mut exit = Exit::Success;
    if [ALL_STUDIES, TOKENS].contains(&flags.name.as_str()) {
        let (counted, folder) = studies.count_tokens()?;
        exit = show_tokens(&counted, &folder, flags.csv, printer)?;
    }
    // Their lists are no suites of simulations.
    if flags.name == TWINS || (flags.name == ALL_STUDIES && flags.suites.is_empty()) {
        let (results, folder) = studies.ask_twins()?;
        exit = exit.max(show_twins(&results, &folder, flags.csv, printer)?);
    }
    if ![TOKENS, TWINS].contains(&flags.name.as_str()) {
        let all = flags.name == ALL_STUDIES;
        let words = if all {
            study::names().collect()
        } else {
            vec![flags.name.as_str()]
        };
        exit = exit.max(show(&studies.simulate(words)?, flags.csv, printer)?);
    }
    Ok(exit)
}

/// Refuses an unknown name. `Study::find` does not know the words that name no study file.
fn check_name(name: &str) -> anyhow::Result<()> {
    if [ALL_STUDIES, TOKENS, TWINS].contains(&name) {
        return Ok(());
    }
    match study::find(name) {
        Err(StudyError::Unknown { word, known }) => Err(StudyError::Unknown {
            word,
            known: format!("{known}, {TOKENS}, {TWINS}, {ALL_STUDIES}"),
        }
        .into()),
        other => Ok(other.map(|_| ())?),
    }
}

/// A score of a variant for CSV.
#[derive(Serialize)]
struct Row<'a> {
    study: &'a str,
    suite: &'a str,
    variant: &'a str,
    planner: &'a str,
    #[serde(flatten)]
    result: &'a ChallengeResults,
}

fn csv_rows(results: &StudyResults) -> Vec<Row<'_>> {
    let mut rows = Vec::new();
    for suite in &results.suites {
        for variant in &suite.variants {
            rows.extend(variant.challenges.iter().map(|result| Row {
                study: &results.study,
                suite: &suite.name,
                variant: &variant.name,
                planner: &variant.planner,
                result,
            }));
        }
    }
    rows
}

/// Prints tables to stdout, folders and failures to stderr.
fn show(outcome: &StudyOutcome, csv: bool, printer: Printer) -> anyhow::Result<Exit> {
    if csv {
        printer.csv(
            &outcome
                .studies
                .iter()
                .flat_map(|(_, results, _)| csv_rows(results))
                .collect::<Vec<_>>(),
        )?;
    }
    for (study, results, folder) in &outcome.studies {
        if printer.is_json() {
            printer.json(results)?;
        } else if !csv {
            printer.table(study_table(study, results, printer.line_width()));
            printer.line("");
        }
        printer.note(format!("results in {}", folder.display()));
    }
    // What failed comes last, where a person at a terminal looks first.
    for line in failures(&outcome.failed) {
        printer.failure(format!("failed: {line}"));
    }
    let lost = outcome.failed_calls;
    if lost > 0 {
        printer.failure(format!(
            "{lost} planning calls got no answer; calls.jsonl of the runs says why"
        ));
    }
    let without_plan = outcome.without_plan;
    if without_plan > 0 {
        printer.failure(format!(
            "in {without_plan} simulations no planning call gave a plan; calls.jsonl of the runs says why"
        ));
    }
    for list in &outcome.missing {
        printer.error(&anyhow!("not simulated: {list}"));
    }
    let answered = lost == 0 && without_plan == 0;
    let succeeded = outcome.failed.is_empty() && answered && outcome.missing.is_empty();
    Ok(if succeeded {
        Exit::Success
    } else {
        Exit::SomeFailed
    })
}

/// A row of a list or suite for CSV.
#[derive(Serialize)]
struct NamedRow<'a, T> {
    list: &'a str,
    #[serde(flatten)]
    row: &'a T,
}

fn named<'a, T>(list: &'a str, rows: &'a [T]) -> impl Iterator<Item = NamedRow<'a, T>> {
    rows.iter().map(move |row| NamedRow { list, row })
}

fn show_tokens(
    counted: &[SuiteTokens],
    folder: &Path,
    csv: bool,
    printer: Printer,
) -> anyhow::Result<Exit> {
    if csv {
        let rows = counted
            .iter()
            .flat_map(|one| named(&one.suite, &one.table.rows));
        printer.csv(&rows.collect::<Vec<_>>())?;
    } else if printer.is_json() {
        printer.json(&counted)?;
    } else {
        for suite in counted {
            let heading = format!(
                "{TOKENS_TITLE}\n\n{}: {} states of {} scenes",
                suite.suite, suite.table.states, suite.scenes
            );
            printer.line(heading);
            printer.table(token_table(&suite.table, printer.line_width()));
            printer.line("");
        }
    }
    printer.note(format!("results in {}", folder.display()));
    // Scenes that cannot be opened come last, where a person at a terminal looks first.
    let failed = || counted.iter().flat_map(|suite| &suite.failed);
    failed().for_each(|line| printer.note(format!("failed: {line}")));
    Ok(if failed().next().is_none() {
        Exit::Success
    } else {
        Exit::SomeFailed
    })
}

fn show_twins(
    results: &[TwinResults],
    folder: &Path,
    csv: bool,
    printer: Printer,
) -> anyhow::Result<Exit> {
    if csv {
        let rows = results.iter().flat_map(|one| named(&one.list, &one.rows));
        printer.csv(&rows.collect::<Vec<_>>())?;
    } else if printer.is_json() {
        printer.json(&results)?;
    } else {
        for list in results {
            printer.line(&list.list);
            printer.table(twin_table(list, printer.line_width()));
        }
    }
    printer.note(format!("results in {}", folder.display()));
    Ok(Exit::Success)
}
