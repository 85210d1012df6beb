//! `memory`.

use super::model::ModelArguments;
use clap::builder::{PossibleValue, PossibleValuesParser};
use clap::{Args, Subcommand};
use planagent_lab::memory::agents;
use std::path::PathBuf;

/// The subcommands of `memory`.
#[derive(Debug, Subcommand)]
pub(crate) enum MemoryCommand {
    /// Fill a memory from generated scenarios of training seeds.
    Fill(FillArguments),
}

/// Arguments of `memory fill`.
#[derive(Debug, Args)]
pub(crate) struct FillArguments {
    /// The agent.
    #[arg(value_parser = remembering())]
    pub(crate) agent: String,
    /// The file that is written.
    #[arg(long, value_name = "FILE")]
    pub(crate) out: PathBuf,
    /// Scenarios that are driven; `--seed` draws others.
    #[arg(long, value_name = "N", default_value_t = 20)]
    pub(crate) scenarios: usize,
    #[command(flatten)]
    pub(super) model: ModelArguments,
}

/// The agents with a memory, each with what is kept.
fn remembering() -> PossibleValuesParser {
    let agents = agents().into_iter();
    agents
        .map(|filler| PossibleValue::new(filler.keys.planner).help(filler.about))
        .collect::<Vec<_>>()
        .into()
}
