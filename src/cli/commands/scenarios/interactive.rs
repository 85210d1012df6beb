//! `planagent scenarios interactive`: draws the scenarios of an interactive suite.

use crate::args::InteractiveArguments;
use crate::{Exit, Printer};
use planagent_runs::worker::interactive::{
    SCENARIOS, draw_generated, draw_recorded, generated_list, other_list, recorded_list,
};
use planagent_runs::worker::seeds::Split;
use planagent_scenario::{DataRoots, Readers};
use serde_json::json;

/// Prints the list, a scenario a line.
pub(super) fn run(arguments: &InteractiveArguments, printer: Printer) -> anyhow::Result<Exit> {
    let (words, list) = if let Some(folder) = &arguments.recordings {
        let words = draw_recorded(folder, &Readers::new(&DataRoots::from_environment()))?;
        let list = recorded_list(&words);
        (words, list)
    } else {
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
