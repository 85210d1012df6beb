//! The drives of a run's folder: which are there, the others made, the files at the end.

use super::Printer;
use super::machine::cpu;
use super::progress::SimulationProgress;
use crate::experiment::run::{self, AgentParts, SimulationTask};
use crate::report::{Manifest, ReportError, RunFolder, Session, SimulationRow, Summary, Timing};
use anyhow::bail;
use std::collections::BTreeSet;
use std::time::Instant;

/// The numbers of the drives that have ended and are not made again, and how many are made again because they had failed.
///
/// # Errors
/// When the folder cannot be read, or holds other drives.
pub(super) fn kept(
    folder: &RunFolder,
    tasks: &[SimulationTask],
    retry_failed: bool,
    printer: Printer,
) -> anyhow::Result<(BTreeSet<usize>, usize)> {
    let completed = folder.completed(tasks)?;
    for path in &completed.damaged {
        printer.note(format!("the record in {} is damaged; its drive is made again", path.display()));
    }
    let all: BTreeSet<usize> = completed.rows.iter().map(|row| row.number).collect();
    let failed = completed.rows.iter().filter(|row| retry_failed && row.error.is_some());
    let again: BTreeSet<usize> = failed.map(|row| row.number).collect();
    folder.discard(&again)?;
    Ok((all.difference(&again).copied().collect(), again.len()))
}

/// Makes drives, each written when it ends.
///
/// # Errors
/// When one cannot be written; a failed drive is no such error.
pub(super) fn make(
    folder: &RunFolder,
    tasks: &[SimulationTask],
    todo: &[usize],
    parts: &AgentParts,
    progress: &SimulationProgress,
) -> Result<(), ReportError> {
    run::run(tasks, todo, parts, &|_| progress.iteration(), &|number, record| {
        folder.commit(number, &record)?;
        progress.drive_ended(record.outcome.is_err());
        Ok(())
    })
}

/// The rows of all drives.
///
/// # Errors
/// When some are missing or cannot be read.
pub(super) fn rows(folder: &RunFolder, tasks: &[SimulationTask]) -> anyhow::Result<Vec<SimulationRow>> {
    let rows = folder.completed(tasks)?.rows;
    if rows.len() != tasks.len() {
        let missing = tasks.len() - rows.len();
        bail!("{missing} of {} drives left no record in {}", tasks.len(), folder.path().display());
    }
    Ok(rows)
}

/// Writes the files of a run whose drives are all made.
///
/// # Errors
/// When one cannot be written.
pub(super) fn finish(
    folder: &RunFolder,
    manifest: &Manifest,
    seed: u64,
    session: Session,
    rows: &[SimulationRow],
) -> anyhow::Result<(Summary, Timing)> {
    let model = manifest.model.clone().map(toml::Table::try_into).transpose()?;
    let summary = Summary::new(seed, model, &manifest.scenarios.missing, rows);
    let timing = Timing::new(session, rows);
    folder.finish(manifest, &summary, &timing, rows)?;
    Ok((summary, timing))
}

/// This machine, and what this session has done since it was `started`.
pub(super) fn session(started: Instant, simulations: usize, load_s: Option<f64>) -> Session {
    let (threads, wall_s) = (rayon::current_num_threads(), started.elapsed().as_secs_f64());
    Session { cpu: cpu(), threads, wall_s, simulations, load_s }
}
