//! `planagent scenarios list|show|statistics|generate|export|hard`.

mod export;
mod generate;
mod hard;
mod interactive;
mod list;
mod show;
mod statistics;
mod twins;

use crate::args::ScenariosCommand;
use crate::{Exit, Printer};
use planagent_scenario::Scenario;
use serde::Serialize;

/// Runs one of the subcommands.
pub(crate) fn run(command: &ScenariosCommand, printer: Printer) -> anyhow::Result<Exit> {
    match command {
        ScenariosCommand::List(arguments) => list::run(arguments, printer),
        ScenariosCommand::Show(arguments) => show::run(arguments, printer),
        ScenariosCommand::Statistics(arguments) => statistics::run(arguments, printer),
        ScenariosCommand::Generate(arguments) => generate::run(arguments, printer),
        ScenariosCommand::Export(arguments) => export::run(arguments, printer),
        ScenariosCommand::Interactive(arguments) => interactive::run(arguments, printer),
        ScenariosCommand::Twins(arguments) => twins::run(arguments, printer),
        ScenariosCommand::Hard { run } => hard::run(run, printer),
    }
}

/// What both `list` and `show` print of a scenario; null is what is unknown before opening.
#[derive(Debug, Clone, PartialEq, Serialize)]
struct About {
    id: String,
    /// The word of the command line that names it.
    source: String,
    scenario_type: String,
    log_name: String,
    /// Iterations of a simulation.
    iterations: Option<usize>,
    /// Lanes for motor vehicles, lane connectors included.
    lanes: Option<usize>,
}

/// A scenario as JSON: the common fields, then those of one command.
#[derive(Debug, Serialize)]
struct Details<T> {
    #[serde(flatten)]
    about: About,
    #[serde(flatten)]
    more: T,
}

impl About {
    /// Of an opened scenario; `source` is the word that named it.
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
