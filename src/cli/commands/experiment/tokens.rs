//! `planagent experiment tokens`: how many tokens the description of a scene takes.

use super::suites::Suite;
use crate::cli::{Config, Exit, Printer, model};
use crate::experiment::study::SuiteName;
use crate::experiment::tokens::{TokenCounter, TokenRow, TokenTable, count};
use crate::report::{StudyFolder, json_value, token_table};
use crate::scenario::ScenarioRef;
use rayon::prelude::*;
use serde::Serialize;
use std::fmt::Write as _;
use std::path::PathBuf;
use std::rc::Rc;

/// Its suites, unless others are asked for.
pub(super) const SUITES: &[SuiteName] = &[SuiteName::Common, SuiteName::Recorded];
/// What it shows.
const TITLE: &str = "Tokens that the description of a scene takes";

/// What the descriptions of a suite take.
#[derive(Debug, Serialize)]
struct SuiteTokens {
    /// Its name.
    suite: String,
    /// How many scenes it has.
    scenes: usize,
    /// BLAKE3 of their names.
    blake3: String,
    /// States that have no lane graph.
    left_out: usize,
    /// Scenes that cannot be opened, with the reason.
    failed: Vec<String>,
    /// The counts.
    #[serde(flatten)]
    table: TokenTable,
}

/// Counts the descriptions of all states of suites at which PlanAgent would call its model.
///
/// # Errors
/// When the model cannot be loaded or the folder cannot be written; a scene that cannot be opened is no such error.
pub(super) fn run(
    suites: &[Rc<Suite>],
    folder: PathBuf,
    command: &str,
    config: &Config,
    printer: Printer,
) -> anyhow::Result<Exit> {
    let opened = model::open(config, printer)?;
    let counter = TokenCounter::new(Some(opened.model()));
    let counted: Vec<SuiteTokens> = suites.iter().map(|suite| counted(suite, counter, config, printer)).collect();
    let folder = StudyFolder::new(folder);
    folder.write_files(&[
        ("results.md", markdown(&counted, command)),
        ("results.json", serde_json::to_string_pretty(&json_value(&counted)?)? + "\n"),
    ])?;
    if printer.is_json() {
        printer.json(&counted)?;
    } else {
        for suite in &counted {
            let heading =
                format!("{TITLE}\n\n{}: {} states of {} scenes", suite.suite, suite.table.states, suite.scenes);
            printer.line(format!("{heading}\n{}\n", token_table(&suite.table)));
        }
    }
    printer.note(format!("results in {}", folder.path().display()));
    let failed = || counted.iter().flat_map(|suite| &suite.failed);
    failed().for_each(|line| printer.note(format!("failed: {line}")));
    Ok(if failed().next().is_none() { Exit::Success } else { Exit::SomeFailed })
}

fn counted(suite: &Suite, counter: TokenCounter<'_>, config: &Config, printer: Printer) -> SuiteTokens {
    let bar = printer.progress(suite.sources.len() as u64, "scenes");
    let of_source = |source: &ScenarioRef| {
        let opened = source.open().map_err(|error| format!("{source}: {error}"));
        bar.inc(1);
        opened.map(|scenario| count(&scenario, config.reasoning.interval, config.environment.node_length_m, &counter))
    };
    let counts: Vec<_> = suite.sources.par_iter().map(of_source).collect();
    bar.finish_and_clear();
    let states = || counts.iter().flatten().flatten();
    let rows: Vec<TokenRow> = states().filter_map(|row| row.as_ref().ok()).cloned().collect();
    SuiteTokens {
        suite: suite.name.clone(),
        scenes: suite.sources.len(),
        blake3: suite.list.blake3.clone(),
        left_out: states().count() - rows.len(),
        failed: counts.iter().filter_map(|count| count.as_ref().err().cloned()).collect(),
        table: TokenTable::new(&rows, counter.model_name()),
    }
}

fn markdown(suites: &[SuiteTokens], command: &str) -> String {
    let mut text = format!("# {TITLE}\n\n```console\n$ {command}\n```\n");
    for suite in suites {
        // Writing to a text cannot fail.
        let _ = write!(text, "\n## {}: {} scenes\n\n{}", suite.suite, suite.scenes, suite.table.markdown());
        if suite.left_out > 0 {
            let _ = writeln!(text, "- {} states have no lane graph and are left out.", suite.left_out);
        }
    }
    text
}
