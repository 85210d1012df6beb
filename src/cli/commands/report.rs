//! `planagent report`.

use crate::args::ReportArguments;
use crate::completed::note_damage;
use crate::picture::check_output;
use crate::{Exit, Printer};
use anyhow::{Context, bail};
use planagent_runs::report::page::{self, PageSettings};
use planagent_runs::report::{RunFolder, check_own, check_writable, last_run};

/// What the beginning of a page has.
const PAGE_MARKS: [&str; 2] = ["<!doctype html>", "<title>PlanAgent"];
/// Bytes of a megabyte.
const MEGABYTE: f64 = 1e6;

/// Writes the page of one or more runs.
pub(crate) fn run(flags: &ReportArguments, printer: Printer) -> anyhow::Result<Exit> {
    if !flags.max_mb.is_finite() || flags.max_mb <= 0.0 {
        bail!("--max-mb is {}; it must be greater than 0", flags.max_mb);
    }
    let mut runs = flags.runs.clone();
    if runs.is_empty() {
        runs.push(last_run()?);
    }
    let first = runs.first().context("name the folder of a run")?;
    RunFolder::manifest(first)?;
    // Said before the work, not after it.
    match &flags.out {
        Some(out) => {
            check_output(out)?;
            check_own(out, &PAGE_MARKS)?;
        }
        None => check_writable(first)?,
    }
    let settings = PageSettings {
        max_bytes: (flags.max_mb * MEGABYTE) as usize,
        scenario: flags.scenario.clone(),
    };
    let bar = printer.progress(0, "simulations");
    let written = page::write(&runs, flags.out.as_deref(), &settings, &|done, all| {
        bar.set_length(all as u64);
        bar.set_position(done as u64);
    });
    bar.finish_and_clear();
    let contents = written?;
    if flags.open
        && let Err(error) = open::that_detached(&contents.page)
    {
        // The page is written all the same, and its path is on stdout.
        printer.note(format!("cannot open a browser: {error}"));
    }
    note_damage(&contents.damaged, printer);
    for problem in &contents.unread {
        printer.failure(format!(
            "{problem}; the page has the scores of its simulation alone"
        ));
    }
    if printer.is_json() {
        printer.json(&contents)?;
        return Ok(Exit::Success);
    }
    printer.line(contents.page.display().to_string());
    let megabytes = contents.bytes as f64 / MEGABYTE;
    printer.note(format!(
        "{} simulations, {} with replay, {megabytes:.1} MB",
        contents.simulations, contents.replays
    ));
    if contents.without_replay > 0 {
        printer.note(format!(
            "{} simulations have no replay: they failed, or the file is lost; resume their run to make it again",
            contents.without_replay
        ));
    }
    if contents.bytes > settings.max_bytes {
        printer.note(format!(
            "tables and statistics alone take {megabytes:.1} MB, more than --max-mb"
        ));
    }
    let left_out = contents.simulations - contents.replays - contents.without_replay;
    if left_out > 0 && flags.scenario.is_none() {
        printer.note(format!(
            "{left_out} replays did not fit; raise --max-mb or select some by --scenario"
        ));
    }
    Ok(Exit::Success)
}
