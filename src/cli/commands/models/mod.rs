//! `planagent models`.

mod check;
mod check_server;
mod families;
mod fetch;
mod list;
pub(crate) mod quantize;
mod row;
mod show;

use crate::args::ModelsCommand;
use crate::progress::listener;
use crate::{Exit, Printer};
use planagent_runs::runner::{Config, model_registry};

/// Lists, shows, checks, fetches or quantizes models, or lists families.
pub(crate) fn run(
    command: &ModelsCommand,
    config: &Config,
    printer: Printer,
) -> anyhow::Result<Exit> {
    let registry = model_registry(config, &listener(printer));
    match command {
        // An adapter is one for the model that is named.
        ModelsCommand::List { csv } => list::run(&registry.with_adapter(None), *csv, printer),
        ModelsCommand::Families { markdown } => families::run(*markdown, printer),
        ModelsCommand::Show { model, .. } => show::run(model, &registry, printer),
        ModelsCommand::Check { models, .. } if models.is_empty() => {
            check::run(models, &registry.with_adapter(None), config, printer)
        }
        ModelsCommand::Check { models, .. } => check::run(models, &registry, config, printer),
        ModelsCommand::Fetch { models, .. } => fetch::run(models, &registry, printer),
        ModelsCommand::Quantize(flags) => quantize::run(flags, &registry, printer),
    }
}
