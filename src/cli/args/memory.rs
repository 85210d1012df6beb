//! `memory`.

use super::model::ModelArguments;
use clap::{Args, Subcommand, ValueEnum};
use std::path::PathBuf;

/// The subcommands of `memory`.
#[derive(Debug, Subcommand)]
pub(crate) enum MemoryCommand {
    /// Fill a memory from generated scenarios of training seeds.
    ///
    /// dilu: the model drives them; decisions of drives without an accident are kept, and after an
    /// accident the model is asked for the lesson. agent-driver: the logged motions are kept, and
    /// no model is needed.
    Fill(FillArguments),
}

/// Arguments of `memory fill`.
#[derive(Debug, Args)]
pub(crate) struct FillArguments {
    /// The agent.
    #[arg(value_enum)]
    pub(crate) agent: MemoryAgent,
    /// The file that is written.
    #[arg(long, value_name = "FILE")]
    pub(crate) out: PathBuf,
    /// Scenarios that are driven; `--seed` draws others.
    #[arg(long, value_name = "N", default_value_t = 20)]
    pub(crate) scenarios: usize,
    #[command(flatten)]
    pub(super) model: ModelArguments,
}

/// An agent with a memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum MemoryAgent {
    Dilu,
    AgentDriver,
}
