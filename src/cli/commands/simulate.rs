//! `planagent simulate`.

use crate::args::SimulateArguments;
use crate::next_steps::{Here, next_steps};
use crate::progress::listener;
use crate::{Exit, Printer};
use anyhow::anyhow;
use planagent_runs::report::{SimulationRow, failures, main_table};
use planagent_runs::runner::{self, Config, RunResults};
use std::path::Path;

/// Runs simulations; the results go to a folder, the table to stdout.
pub(crate) fn run(
    flags: &SimulateArguments,
    config: &Config,
    printer: Printer,
) -> anyhow::Result<Exit> {
    let (request, listener) = (flags.request()?, listener(printer));
    let results = match &flags.resume {
        Some(folder) => runner::resume(folder, &request, config, &listener)?,
        None => runner::start(&request, config, flags.out.as_deref(), &listener)?,
    };
    show(&results, flags.csv, printer)
}

/// Prints tables to stdout, folder and failures to stderr. Success if every simulation ended and
/// every planning call was answered.
pub(super) fn show(results: &RunResults, csv: bool, printer: Printer) -> anyhow::Result<Exit> {
    let RunResults {
        folder,
        rows,
        missing,
        ..
    } = results;
    tell_scores(results, csv, printer)?;
    if rows.is_empty() {
        printer.note("no scenario is in this shard");
    }
    printer.note(format!("results in {}", folder.display()));
    let have_ended = tell_failures(rows, printer);
    let are_answered = tell_calls(folder, rows, printer);
    for list in missing {
        printer.error(&anyhow!("not simulated: {list}"));
    }
    if !csv && !printer.is_json() {
        for line in next_steps(folder, rows, &Here::of_process(), Printer::note_width()) {
            printer.note(line);
        }
    }
    Ok(if have_ended && are_answered && missing.is_empty() {
        Exit::Success
    } else {
        Exit::SomeFailed
    })
}

/// Prints the scores in the form that was asked for.
fn tell_scores(results: &RunResults, csv: bool, printer: Printer) -> anyhow::Result<()> {
    let RunResults {
        summary,
        timing,
        rows,
        ..
    } = results;
    if csv {
        return printer.csv(&summary.scenarios);
    }
    if printer.is_json() {
        return printer.json(summary);
    }
    printer.table(main_table(
        summary,
        &timing.planners,
        rows,
        printer.line_width(),
    ));
    if let Some(total) = timing.planning_call_ms.total {
        let count = timing.planning_calls;
        printer.line(format!(
            "\n{count} planning calls: median {:.0} ms, 95th percentile {:.0} ms",
            total.p50, total.p95
        ));
    }
    Ok(())
}

/// Tells of the simulations that failed; whether there are none.
fn tell_failures(rows: &[SimulationRow], printer: Printer) -> bool {
    for line in failures(rows) {
        printer.failure(format!("failed: {line}"));
    }
    let failed = rows.iter().filter(|row| row.error.is_some()).count();
    if failed > 0 {
        printer.failure(format!("{failed} of {} simulations failed", rows.len()));
    }
    failed == 0
}

/// Tells of the planning calls that were skipped or gave no plan; whether the model answered all
/// others.
fn tell_calls(folder: &Path, rows: &[SimulationRow], printer: Printer) -> bool {
    let count = |of: fn(&SimulationRow) -> usize| rows.iter().map(of).sum::<usize>();
    let calls = count(|row| row.planning_calls);
    let gated = count(|row| row.gated_calls);
    // Gated calls are not among the planning calls, so both make up the total.
    if gated > 0 {
        printer.note(format!(
            "the gate skipped {gated} of {} planning calls",
            gated + calls
        ));
    }
    let deadlines = count(|row| row.deadlines);
    if deadlines > 0 {
        printer.note(format!(
            "{deadlines} of {calls} planning calls ended at their deadline"
        ));
    }
    let lost = count(|row| row.failed_calls);
    if lost > 0 {
        let calls_file = folder.join("calls.jsonl");
        printer.failure(format!(
            "{lost} of {calls} planning calls got no answer; {} says why",
            calls_file.display()
        ));
    }
    let without_plan = rows.iter().filter(|row| row.is_without_plan()).count();
    if without_plan > 0 {
        printer.failure(format!(
            "in {without_plan} of {} simulations no planning call gave a plan: their scores say nothing about the model's driving",
            rows.len()
        ));
    }
    lost == 0 && without_plan == 0
}
