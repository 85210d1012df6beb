//! `planagent merge`.

use super::simulate::show;
use crate::args::MergeArguments;
use crate::{Exit, Printer};
use planagent_runs::runner;

/// Merges shards to one run; its table goes to stdout.
pub(crate) fn run(flags: &MergeArguments, printer: Printer) -> anyhow::Result<Exit> {
    let results = runner::merge(&flags.runs, flags.out.as_deref())?;
    show(&results, false, printer)
}
