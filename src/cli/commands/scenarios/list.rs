//! `planagent scenarios list`: one scenario after another, as far as each is known before opening.

use super::{About, Details};
use crate::args::ListArguments;
use crate::{Exit, Printer};
use anyhow::{anyhow, bail};
use planagent_runs::worker::split::split;
use planagent_scenario::generator::{Spec, types};
use planagent_scenario::{Contents, Readers, ScenarioRef, UNKNOWN_TYPE};
use planagent_world::STEP_S;
use serde::Serialize;
use serde_json::json;

/// Counts of a recording that `show` does not print.
#[derive(Debug, Clone, Copy, Serialize)]
struct Recorded {
    /// Place in a file of several recordings, from 0.
    record: Option<usize>,
    /// Recorded steps at 10 Hz.
    steps: usize,
    /// Recorded objects.
    tracks: usize,
}

/// How the scenarios are printed.
#[derive(Clone, Copy)]
struct Output {
    printer: Printer,
    csv: bool,
}

/// A row for CSV.
#[derive(Debug, Serialize)]
struct Row {
    #[serde(flatten)]
    about: About,
    split: Option<String>,
    #[serde(flatten)]
    recorded: Option<Recorded>,
}

/// Lists the scenarios of words and splits, or the types of generated scenarios when neither is
/// given.
pub(super) fn run(arguments: &ListArguments, printer: Printer) -> anyhow::Result<Exit> {
    let ListArguments {
        sources,
        split,
        csv,
    } = arguments;
    let output = Output { printer, csv: *csv };
    let mut rows = Vec::new();
    let complete = if sources.is_empty() && split.splits.is_empty() {
        if split.data.modifies() {
            bail!("--modify needs scenarios or a split to modify");
        }
        list_types(output, &mut rows)?
    } else {
        let readers = split.data.readers();
        let mut complete = list_splits(
            &split.data.modified(&split.splits)?,
            &readers,
            output,
            &mut rows,
        )?;
        for word in &split.data.modified(sources)? {
            for scenario in readers.find(word)? {
                complete &= list(&scenario, None, output, &mut rows)?;
            }
        }
        for note in readers.take_notes() {
            printer.note(note);
        }
        complete
    };
    // CSV alone waits for all rows; the other outputs show each scenario as it is found.
    if *csv {
        printer.csv(&rows)?;
    }
    Ok(if complete {
        Exit::Success
    } else {
        Exit::SomeFailed
    })
}

fn list_types(output: Output, rows: &mut Vec<Row>) -> anyhow::Result<bool> {
    let note = "types of generated scenarios; name one as generated/TYPE/SEED or generated/TYPE/SEED.TRAFFIC";
    output.printer.note(note);
    for scenario_type in types::in_suites() {
        list(&Spec::new(scenario_type, 0).into(), None, output, rows)?;
    }
    Ok(true)
}

/// Whether all scenarios of the splits exist and all their files can be read.
fn list_splits(
    names: &[String],
    readers: &Readers,
    output: Output,
    rows: &mut Vec<Row>,
) -> anyhow::Result<bool> {
    let mut complete = true;
    for name in names {
        let found = split(name, readers, &|_, _| {})?;
        for scenario in found.scenarios {
            complete &= list(&scenario, Some(name), output, rows)?;
        }
        for note in found.notes {
            output.printer.note(format!("{name}: {note}"));
        }
        if !found.missing.is_empty() {
            output.printer.error(&anyhow!("{}", found.missing));
            complete = false;
        }
    }
    Ok(complete)
}

/// Lists a scenario; false when its file cannot be read.
fn list(
    scenario: &ScenarioRef,
    split: Option<&str>,
    output: Output,
    rows: &mut Vec<Row>,
) -> anyhow::Result<bool> {
    let printer = output.printer;
    let contents = match (scenario.fault(), scenario.contents()) {
        (Some(fault), _) => {
            printer.error(&anyhow!("{fault}"));
            return Ok(false);
        }
        (None, Err(error)) => {
            printer.error(&error.into());
            return Ok(false);
        }
        (None, Ok(contents)) => contents,
    };
    let source = scenario.to_string();
    let about = About {
        id: scenario.id().unwrap_or(&source).to_owned(),
        scenario_type: scenario.scenario_type().unwrap_or(UNKNOWN_TYPE).to_owned(),
        log_name: scenario.log_name().to_owned(),
        iterations: contents.map(|contents| contents.iterations),
        lanes: contents.map(|contents| contents.lanes),
        source,
    };
    if output.csv {
        let recorded = contents.map(
            |Contents {
                 record,
                 steps,
                 tracks,
                 ..
             }| Recorded {
                record,
                steps,
                tracks,
            },
        );
        rows.push(Row {
            about,
            split: split.map(str::to_owned),
            recorded,
        });
        return Ok(true);
    }
    let Some(Contents {
        record,
        steps,
        iterations,
        tracks,
        lanes,
    }) = contents
    else {
        // The name of a generated scenario holds its type.
        let details = if about.source == about.id {
            ""
        } else {
            &about.scenario_type
        };
        printer.named(&about.source, details);
        if printer.is_json() {
            printer.json(&Details {
                about,
                more: json!({"split": split}),
            })?;
        }
        return Ok(true);
    };
    let simulated_s = iterations.saturating_sub(1) as f64 * STEP_S;
    let counts = format!(
        "{steps:>4} steps  {simulated_s:>5.1} s simulated  {tracks:>4} tracks  {lanes:>4} lanes"
    );
    // Most files and folders have the id in their name.
    let details = if about.source.contains(&about.id) {
        counts
    } else {
        format!("{counts}  {}", about.id)
    };
    printer.named(&about.source, &details);
    if printer.is_json() {
        printer.json(&Details {
            about,
            more: Recorded {
                record,
                steps,
                tracks,
            },
        })?;
    }
    Ok(true)
}
