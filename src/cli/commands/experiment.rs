//! `planagent experiment`.

use crate::cli::args::{ALL_EXPERIMENTS, ExperimentArguments};
use crate::cli::progress::listener;
use crate::cli::{Exit, Printer};
use crate::experiment::study;
use crate::report::{failures, study_table, token_table};
use crate::runner::{Config, Experiments, StudyOutcome, SuiteTokens, TOKENS, TOKENS_TITLE};
use anyhow::anyhow;
use std::path::Path;

/// Runs the simulations of experiments that are not completed; the results go to a folder, the tables to stdout.
pub(in crate::cli) fn run(flags: &ExperimentArguments, config: &Config, printer: Printer) -> anyhow::Result<Exit> {
    let (request, listener) = (flags.request(), listener(printer));
    let mut experiments = Experiments::new(&request, config, &listener)?;
    let mut exit = Exit::Success;
    if [ALL_EXPERIMENTS, TOKENS].contains(&flags.name.as_str()) {
        let (counted, folder) = experiments.count_tokens()?;
        exit = show_tokens(&counted, &folder, printer)?;
    }
    if flags.name != TOKENS {
        let all = flags.name == ALL_EXPERIMENTS;
        let words = if all { study::names().collect() } else { vec![flags.name.as_str()] };
        exit = exit.max(show(&experiments.simulate(words)?, printer)?);
    }
    Ok(exit)
}

/// Prints tables to stdout, folders and failures to stderr.
fn show(outcome: &StudyOutcome, printer: Printer) -> anyhow::Result<Exit> {
    for (study, results, folder) in &outcome.studies {
        if printer.is_json() {
            printer.json(results)?;
        } else {
            printer.line(study_table(study, results));
            printer.line("");
        }
        printer.note(format!("results in {}", folder.display()));
    }
    for line in failures(&outcome.failed) {
        printer.note(format!("failed: {line}"));
    }
    let lost = outcome.failed_calls;
    if lost > 0 {
        printer.note(format!("{lost} planning calls got no answer; calls.jsonl of the runs says why"));
    }
    for list in &outcome.missing {
        printer.error(&anyhow!("not simulated: {list}"));
    }
    let succeeded = outcome.failed.is_empty() && lost == 0 && outcome.missing.is_empty();
    Ok(if succeeded { Exit::Success } else { Exit::SomeFailed })
}

fn show_tokens(counted: &[SuiteTokens], folder: &Path, printer: Printer) -> anyhow::Result<Exit> {
    if printer.is_json() {
        printer.json(&counted)?;
    } else {
        for suite in counted {
            let heading =
                format!("{TOKENS_TITLE}\n\n{}: {} states of {} scenes", suite.suite, suite.table.states, suite.scenes);
            printer.line(format!("{heading}\n{}\n", token_table(&suite.table)));
        }
    }
    printer.note(format!("results in {}", folder.display()));
    let failed = || counted.iter().flat_map(|suite| &suite.failed);
    failed().for_each(|line| printer.note(format!("failed: {line}")));
    Ok(if failed().next().is_none() { Exit::Success } else { Exit::SomeFailed })
}
