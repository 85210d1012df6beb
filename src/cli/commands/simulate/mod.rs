//! `planagent simulate`.

pub(in crate::cli) mod selection;

use crate::cli::args::SimulateArguments;
use crate::cli::model::{self, Loaded};
use crate::cli::progress::SimulationProgress;
use crate::cli::{Config, Exit, Printer, drives};
use crate::experiment::run::SimulationTask;
use crate::planner::PlannerRegistry;
use crate::report::{
    FORMAT_VERSION, Manifest, RunFolder, Session, SimulationRow, Summary, Timing, failures, main_table, stamp,
};
use anyhow::{anyhow, bail};
use selection::Selection;
use std::collections::BTreeSet;
use std::path::Path;
use std::time::{Instant, SystemTime};

/// Drives and scores; the results go to a folder, the table to stdout.
///
/// # Errors
/// When the input, the model or the output folder cannot be used; a failed drive is no such error.
pub(in crate::cli) fn run(flags: &SimulateArguments, config: &Config, printer: Printer) -> anyhow::Result<Exit> {
    let started = Instant::now();
    let before = flags.resume.as_deref().map(RunFolder::manifest).transpose()?;
    let found = Selection::of(flags, before.as_ref(), printer).and_then(|selection| match &before {
        Some(manifest) if flags.is_plain_resume() => selection.check_unchanged(manifest),
        _ => Ok(selection),
    });
    let selection = match (found, &flags.resume, &before) {
        (Ok(selection), ..) => selection,
        (Err(trouble), Some(folder), Some(manifest)) if flags.is_plain_resume() => {
            return ended(folder, manifest, config, trouble, printer);
        }
        (Err(trouble), ..) => return Err(trouble),
    };
    let tasks = &selection.tasks;
    let registry = PlannerRegistry::default();
    let mut needs_model = false;
    for planner in &selection.planners {
        let entry = registry.find(planner.as_str())?;
        if let Some(key) = entry.unsupported(&config.agent_settings()) {
            bail!("{key} is not supported by {planner}; remove one of them");
        }
        needs_model |= entry.needs_model();
    }
    let loaded = if needs_model { Some(model::load(config, printer)?) } else { None };
    let now = manifest(&selection, config, loaded.as_ref())?;
    let (folder, manifest) = match &flags.resume {
        Some(path) => RunFolder::resume(path, &now)?,
        None => (RunFolder::create(flags.out.as_deref(), &now)?, now),
    };

    let kept = kept(&folder, tasks, flags, printer)?;
    let todo: Vec<usize> = (0..tasks.len()).filter(|number| !kept.contains(number)).collect();
    let parts = model::parts(config, loaded.as_ref());
    let progress = SimulationProgress::new(printer, todo.len());
    let driven = drives::make(&folder, tasks, &todo, &parts, &progress);
    progress.finish();
    driven?;

    let rows = drives::rows(&folder, tasks)?;
    let session = drives::session(started, todo.len(), loaded.as_ref().map(|loaded| loaded.load_s));
    let exit = finish(&folder, &manifest, config.seed, session, &rows, printer);
    for note in selection.readers.take_notes() {
        printer.note(note);
    }
    exit
}

/// A run whose scenarios are not where they were, because of `trouble`: when all its drives are made, what they gave.
fn ended(
    path: &Path,
    manifest: &Manifest,
    config: &Config,
    trouble: anyhow::Error,
    printer: Printer,
) -> anyhow::Result<Exit> {
    let started = Instant::now();
    let rows = RunFolder::read_completed(path)?.rows;
    let all = manifest.simulations();
    if rows.len() != all || manifest.config != toml::Table::try_from(config)? {
        let made = rows.len();
        return Err(
            trouble.context(format!("the run in {} ({made} of {all} drives made) cannot go on", path.display()))
        );
    }
    printer.note(format!("the run in {} has ended; its scenarios are not there any more: {trouble:#}", path.display()));
    let (folder, manifest) = RunFolder::resume(path, manifest)?;
    finish(&folder, &manifest, config.seed, drives::session(started, 0, None), &rows, printer)
}

/// Writes the files of a run whose drives are all made, and tells what they gave.
fn finish(
    folder: &RunFolder,
    manifest: &Manifest,
    seed: u64,
    session: Session,
    rows: &[SimulationRow],
    printer: Printer,
) -> anyhow::Result<Exit> {
    let missing = &manifest.scenarios.missing;
    let (summary, timing) = drives::finish(folder, manifest, seed, session, rows)?;
    let all_well = tell(&summary, &timing, rows, folder.path(), printer)?;
    for list in missing {
        printer.error(&anyhow!("not driven: {list}"));
    }
    Ok(if all_well && missing.is_empty() { Exit::Success } else { Exit::SomeFailed })
}

/// What this run would be started with.
fn manifest(selection: &Selection, config: &Config, loaded: Option<&Loaded>) -> anyhow::Result<Manifest> {
    Ok(Manifest {
        format_version: FORMAT_VERSION,
        planagent: env!("CARGO_PKG_VERSION").to_owned(),
        started: stamp(SystemTime::now()),
        planners: selection.planners.iter().map(ToString::to_string).collect(),
        challenges: selection.challenges.iter().map(ToString::to_string).collect(),
        scenarios: selection.list.clone(),
        model: loaded.map(|loaded| toml::Table::try_from(&loaded.about)).transpose()?,
        config: toml::Table::try_from(config)?,
    })
}

/// The numbers of the drives that have ended in an earlier session and are not made again.
fn kept(
    folder: &RunFolder,
    tasks: &[SimulationTask],
    flags: &SimulateArguments,
    printer: Printer,
) -> anyhow::Result<BTreeSet<usize>> {
    let (kept, again) = drives::kept(folder, tasks, flags.retry_failed, printer)?;
    if flags.resume.is_some() {
        let left = tasks.len() - kept.len();
        let failed = match again {
            0 => String::new(),
            count => format!(", {count} of them had failed"),
        };
        printer.note(format!("{} of {} drives are done, {left} are left{failed}", kept.len(), tasks.len()));
    }
    Ok(kept)
}

/// Tables to stdout, place and failures to stderr. Says whether every drive ended well and every planning call was
/// answered.
fn tell(
    summary: &Summary,
    timing: &Timing,
    rows: &[SimulationRow],
    folder: &Path,
    printer: Printer,
) -> anyhow::Result<bool> {
    if printer.is_json() {
        printer.json(summary)?;
    } else {
        printer.line(main_table(summary, &timing.planners, rows, printer.width()));
        if let Some(total) = timing.planning_call_ms.total {
            let count = timing.planning_calls;
            printer.line(format!("\n{count} planning calls: p50 {:.0} ms, p95 {:.0} ms", total.p50, total.p95));
        }
    }
    printer.note(format!("results in {}", folder.display()));
    let failed = failures(rows);
    for line in &failed {
        printer.note(format!("failed: {line}"));
    }
    if !failed.is_empty() {
        printer.note(format!("{} of {} drives failed", failed.len(), rows.len()));
    }
    let count = |of: fn(&SimulationRow) -> usize| rows.iter().map(of).sum::<usize>();
    let (calls, deadlines, lost) =
        (count(|row| row.planning_calls), count(|row| row.deadlines), count(|row| row.failed_calls));
    let gated = count(|row| row.gated_calls);
    if gated > 0 {
        printer.note(format!("the gate skipped {gated} of {} planning calls", gated + calls));
    }
    if deadlines > 0 {
        printer.note(format!("{deadlines} of {calls} planning calls ended by their deadline"));
    }
    if lost > 0 {
        printer.note(format!("{lost} of {calls} planning calls got no answer; calls.jsonl says why"));
    }
    Ok(failed.is_empty() && lost == 0)
}
