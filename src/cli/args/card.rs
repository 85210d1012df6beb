//! `card`.

use super::model::ModelArguments;
use crate::words::count;
use clap::Args;
use planagent_lab::card::DEFAULT_LIMIT;
use std::path::PathBuf;

/// Arguments of `card`.
#[derive(Debug, Args)]
pub(crate) struct CardArguments {
    /// Folder for the card and its runs [default: runs/cards/NAME, with the model's name].
    ///
    /// Completed simulations and answers in it are not repeated, so the same command goes on after
    /// an interruption.
    #[arg(long, value_name = "FOLDER")]
    pub(crate) out: Option<PathBuf>,
    /// Scenes of each suite, and pairs of text twins; four times as many states.
    #[arg(long, value_name = "N", value_parser = count, default_value_t = DEFAULT_LIMIT)]
    pub(crate) limit: usize,
    /// Take the measured times of an earlier card: its folder, or its card.json.
    ///
    /// Then the whole card is the same bytes each time. Without it, the block `measured` differs.
    #[arg(long, value_name = "CARD")]
    pub(crate) latency_of: Option<PathBuf>,
    /// Repeat failed simulations.
    #[arg(long, hide_short_help = true)]
    pub(crate) retry_failed: bool,
    #[command(flatten)]
    pub(super) model: ModelArguments,
}
