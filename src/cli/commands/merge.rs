//! `planagent merge`.

use super::simulate::show;
use crate::cli::args::MergeArguments;
use crate::cli::{Exit, Printer};
use planagent_runs::runner;

/// Merges shards to one run; its table goes to stdout.
pub(in crate::cli) fn run(flags: &MergeArguments, printer: Printer) -> anyhow::Result<Exit> {
    let results = runner::merge(&flags.runs, flags.out.as_deref())?;
    show(&results, false, printer)
}
