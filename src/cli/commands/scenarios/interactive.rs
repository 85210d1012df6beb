//! `planagent scenarios interactive`: draws the scenarios of an interactive suite.

use crate::args::InteractiveArguments;
use crate::{Exit, Printer};
use planagent_runs::worker::interactive::{
    RecordedDraw, SCENARIOS, draw_generated, draw_recorded, generated_list, other_list,
    recorded_list,
};
use planagent_runs::worker::seeds::Split;
use planagent_scenario::{DataRoots, Readers};
use serde_json::json;

/// Most recordings that are listed as left out, one by one.
const MAX_SHOWN: usize = 20;

/// Prints the list, a scenario a line.
pub(super) fn run(arguments: &InteractiveArguments, printer: Printer) -> anyhow::Result<Exit> {
    if let Some(folder) = &arguments.recordings {
        let readers = Readers::new(&DataRoots::from_environment());
        let drawn = draw_recorded(folder, &readers)?;
        for note in readers.take_notes() {
            printer.note(note);
        }
        return show_recorded(&drawn, printer);
    }
    let (words, list) = {
        let seeds = match arguments.seeds.as_str() {
            "train" => Split::Train,
            "test" => Split::Test,
            _ => Split::Validation,
        };
        let words = draw_generated(seeds, arguments.count)?;
        let is_suite = seeds == Split::Test && arguments.count == SCENARIOS;
        let list = if is_suite {
            generated_list(&words)
        } else {
            other_list(&words, seeds, arguments.count)
        };
        (words, list)
    };
    printer.line(list.trim_end());
    if printer.is_json() {
        printer.json(&json!({"scenarios": words}))?;
    }
    Ok(Exit::Success)
}

/// Prints what was drawn, and on stderr what could not be opened.
fn show_recorded(drawn: &RecordedDraw, printer: Printer) -> anyhow::Result<Exit> {
    let RecordedDraw { words, refused } = drawn;
    printer.line(recorded_list(words).trim_end());
    if printer.is_json() {
        printer.json(&json!({"scenarios": words, "refused": refused}))?;
    }
    for problem in refused.iter().take(MAX_SHOWN) {
        printer.failure(format!("left out: {problem}"));
    }
    if refused.len() > MAX_SHOWN {
        printer.failure(format!("left out: {} more", refused.len() - MAX_SHOWN));
    }
    Ok(if refused.is_empty() {
        Exit::Success
    } else {
        Exit::SomeFailed
    })
}
