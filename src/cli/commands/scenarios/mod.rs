//! `planagent scenarios list|show|generate|export|hard`.

mod export;
mod generate;
mod hard;
mod list;
mod show;

use crate::cli::args::ScenariosCommand;
use crate::cli::{Exit, Printer};
use crate::scenario::Scenario;
use serde::Serialize;

/// Runs one of the subcommands.
///
/// # Errors
/// When a source cannot be read or a file cannot be written.
pub(in crate::cli) fn run(command: &ScenariosCommand, printer: Printer) -> anyhow::Result<Exit> {
    match command {
        ScenariosCommand::List { sources, split } => list::run(sources, split, printer),
        ScenariosCommand::Show(arguments) => show::run(arguments, printer),
        ScenariosCommand::Generate(arguments) => generate::run(arguments, printer),
        ScenariosCommand::Export(arguments) => export::run(arguments, printer),
        ScenariosCommand::Hard { run } => hard::run(run, printer),
    }
}

/// What `list` and `show` tell alike of a scenario; null is what is not known before it is opened.
#[derive(Debug, Clone, PartialEq, Serialize)]
struct About {
    /// Its name.
    id: String,
    /// The word that names it on the command line.
    source: String,
    /// nuPlan's type.
    scenario_type: String,
    /// Name of the log that it was cut from.
    log_name: String,
    /// Iterations that a simulation drives.
    iterations: Option<usize>,
    /// Lanes for motor vehicles, lane connectors included.
    lanes: Option<usize>,
}

/// A scenario as JSON: what is told of it everywhere, then what one command alone tells.
#[derive(Debug, Serialize)]
struct Told<T> {
    #[serde(flatten)]
    about: About,
    #[serde(flatten)]
    more: T,
}

impl About {
    /// Of a scenario that is open; `source` is the word that named it.
    fn scenario(scenario: &Scenario, source: &str) -> Self {
        Self {
            id: scenario.id.clone(),
            source: source.to_owned(),
            scenario_type: scenario.scenario_type.clone(),
            log_name: scenario.log_name.clone(),
            iterations: Some(scenario.iterations()),
            lanes: Some(scenario.map.lanes().len()),
        }
    }
}
