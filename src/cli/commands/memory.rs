//! `planagent memory`.

use crate::args::{FillArguments, MemoryCommand};
use crate::picture::check_output;
use crate::progress::listener;
use crate::{Exit, Printer};
use anyhow::{Context, bail};
use planagent_files::write_whole;
use planagent_lab::memory::{Filled, Training, agents, fill_from_drives, fill_from_logs};
use planagent_runs::report::check_own;
use planagent_runs::runner::{Config, load_model};

/// What the beginning of a memory has.
const MEMORY_MARKS: [&str; 2] = ["\"format\":", "\"agent\":"];
/// Most scenarios of a memory: those of a seed.
const MAX_SCENARIOS: usize = 100_000;

/// Runs a subcommand.
pub(crate) fn run(
    command: &MemoryCommand,
    config: &Config,
    printer: Printer,
) -> anyhow::Result<Exit> {
    let MemoryCommand::Fill(flags) = command;
    if flags.scenarios == 0 || flags.scenarios > MAX_SCENARIOS {
        bail!(
            "--scenarios is {}; it must be 1 to {MAX_SCENARIOS}",
            flags.scenarios
        );
    }
    if flags.out.is_dir() {
        bail!("--out {} is a folder; name a file", flags.out.display());
    }
    // Before the drives, whose minutes would be lost if the file could not be written.
    check_output(&flags.out)?;
    check_own(&flags.out, &MEMORY_MARKS)?;
    let training = Training {
        seed: config.seed,
        scenarios: flags.scenarios,
    };
    let mut agents = agents().into_iter();
    let filler = agents
        .find(|filler| filler.keys.planner == flags.agent)
        .with_context(|| format!("{} has no memory", flags.agent))?;
    if let Some(filled) = fill_from_logs(&filler, training) {
        return write(flags, &filled, printer);
    }
    let loaded = load_model(config, &listener(printer))?;
    let bar = printer.progress(flags.scenarios as u64, "drives");
    let parts = loaded.agent_parts(config, &listener(printer))?;
    let filled = fill_from_drives(&filler, training, &parts, &|| bar.inc(1))?;
    bar.finish_and_clear();
    let filled = filled.with_context(|| format!("{} is filled by no drives", flags.agent))?;
    write(flags, &filled, printer)
}

fn write(flags: &FillArguments, filled: &Filled, printer: Printer) -> anyhow::Result<Exit> {
    for note in &filled.notes {
        printer.note(format!("nothing is kept of {note}"));
    }
    let count = filled.memory.items.len();
    if count == 0 {
        bail!(
            "no scenario left anything to remember; {} is not written",
            flags.out.display()
        );
    }
    let mut text = serde_json::to_string_pretty(&filled.memory)?;
    text.push('\n');
    write_whole(&flags.out, text.as_bytes())
        .with_context(|| format!("cannot write {}", flags.out.display()))?;
    if printer.is_json() {
        printer.json(&serde_json::json!({"file": flags.out, "items": count}))?;
    } else {
        printer.note(format!("{}: {count} items", flags.out.display()));
    }
    Ok(Exit::Success)
}
