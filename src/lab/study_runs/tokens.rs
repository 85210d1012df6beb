//! The study `tokens`: how many tokens the description of a scene takes.

use super::suites::SelectedSuite;
use crate::report::{StudyFolder, token_markdown};
use crate::tokens::{TokenCounter, TokenRow, TokenTable, count};
use planagent_agent::reflection::steps_of;
use planagent_runs::report::{json_value, markdown_block, markdown_line};
use planagent_runs::runner::Config;
use planagent_runs::runner::RunnerError;
use planagent_runs::runner::model::OpenModel;
use planagent_runs::runner::{Event, Listener};
use planagent_runs::worker::suite::{RECORDED, Suite};
use planagent_scenario::ScenarioRef;
use rayon::prelude::*;
use serde::Serialize;
use std::fmt::Write as _;
use std::rc::Rc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Its suites, unless the request names others.
pub(super) const SUITES: &[&str] = &[Suite::TEST14.name, RECORDED];
/// Its title.
pub const TITLE: &str = "Tokens of a scene description";

/// The tokens of a suite's scene descriptions.
#[derive(Debug, Clone, Serialize)]
pub struct SuiteTokens {
    /// Its name.
    pub suite: String,
    /// How many scenes it has.
    pub scenes: usize,
    /// BLAKE3 of their names.
    pub blake3: String,
    /// States that have no lane graph.
    pub left_out: usize,
    /// Scenes that cannot be opened, with the reason.
    pub failed: Vec<String>,
    /// The counts.
    #[serde(flatten)]
    pub table: TokenTable,
}

/// Counts the descriptions of all states of suites at which PlanAgent would call its model.
pub(super) fn count_all(
    suites: &[Rc<SelectedSuite>],
    config: &Config,
    listener: &Listener,
) -> Result<Vec<SuiteTokens>, RunnerError> {
    let opened = OpenModel::open(config, listener)?;
    let counter = TokenCounter::new(Some(opened.model()));
    Ok(suites
        .iter()
        .map(|suite| counted(suite, counter, config, listener))
        .collect())
}

/// Writes the results; `command` made them.
pub(super) fn write(
    folder: &StudyFolder,
    counted: &[SuiteTokens],
    command: &str,
) -> Result<(), RunnerError> {
    let json = serde_json::to_string_pretty(&json_value(&counted)?)? + "\n";
    Ok(folder.write_files(&[
        ("results.md", markdown(counted, command)),
        ("results.json", json),
    ])?)
}

fn counted(
    suite: &SelectedSuite,
    counter: TokenCounter<'_>,
    config: &Config,
    listener: &Listener,
) -> SuiteTokens {
    let (total, done) = (suite.sources.len(), AtomicUsize::new(0));
    let of_source = |source: &ScenarioRef| {
        let opened = source.open().map_err(|error| format!("{source}: {error}"));
        listener(Event::ScenesCounted {
            done: done.fetch_add(1, Ordering::Relaxed) + 1,
            total,
        });
        opened.map(|scenario| {
            count(
                &scenario,
                steps_of(config.agent.interval_s),
                config.environment.node_length_m,
                &counter,
            )
        })
    };
    // `collect` keeps the order of the scenes, so threads do not show in the table.
    let counts: Vec<_> = suite.sources.par_iter().map(of_source).collect();
    let states = || counts.iter().flatten().flatten();
    let rows: Vec<TokenRow> = states()
        .filter_map(|row| row.as_ref().ok())
        .cloned()
        .collect();
    SuiteTokens {
        suite: suite.name.clone(),
        scenes: total,
        blake3: suite.list.blake3.clone(),
        left_out: states().count() - rows.len(),
        failed: counts
            .iter()
            .filter_map(|count| count.as_ref().err().cloned())
            .collect(),
        table: TokenTable::new(&rows, counter.model_name()),
    }
}

fn markdown(suites: &[SuiteTokens], command: &str) -> String {
    let command = markdown_block("console", &format!("$ {command}"));
    let mut text = format!("# {TITLE}\n\n{command}\n");
    for suite in suites {
        // Writing to a text cannot fail.
        let _ = write!(
            text,
            "\n## {}: {} scenes\n\n{}",
            markdown_line(&suite.suite),
            suite.scenes,
            token_markdown(&suite.table)
        );
        if suite.left_out > 0 {
            let _ = writeln!(
                text,
                "- {} states have no lane graph and are left out.",
                suite.left_out
            );
        }
    }
    text
}
