//! `planagent simulate`.

use crate::cli::args::SimulateArguments;
use crate::cli::model::{self, Loaded};
use crate::cli::{Config, Exit, Printer};
use crate::experiment::nuplan_data::NuPlanData;
use crate::experiment::run::{self, Assignment, PlannerKind};
use crate::experiment::source::ScenarioSource;
use crate::report::{RunFolder, Summary, Timing, failures, main_table};
use crate::scenario::generator;
use crate::scenario::nuplan::DataRoots;
use crate::simulation::Challenge;
use anyhow::Context;
use std::time::Instant;

/// Drives and scores; the results go to a folder, the table to stdout.
///
/// # Errors
/// When the input, the model or the output folder cannot be used; a failed drive is no such error.
pub(in crate::cli) fn run(flags: &SimulateArguments, config: &Config, printer: Printer) -> anyhow::Result<Exit> {
    let started = Instant::now();
    let assignments = assignments(flags)?;
    let needs_model = assignments.iter().any(|a| a.planner == PlannerKind::PlanAgent);
    let loaded = if needs_model { Some(model::load(config, printer)?) } else { None };
    let folder = RunFolder::create(flags.out.as_deref())?;
    let parts = loaded.as_ref().map(|loaded: &Loaded| &loaded.parts);
    let bar = printer.progress(assignments.len() as u64, "drives");
    let iterations = std::sync::atomic::AtomicUsize::new(0);
    let records = run::run(&assignments, parts, &|progress| {
        let done = iterations.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1;
        bar.set_message(format!("{done} iterations"));
        if progress.done == progress.total {
            bar.inc(1);
        }
    });
    bar.finish_and_clear();

    let described = parts.map(|parts| parts.model.describe());
    let summary = Summary::new(config.seed, described, &records);
    let load_s = loaded.as_ref().map(|loaded| loaded.load_s);
    let threads = rayon::current_num_threads();
    let timing = Timing::new(cpu(), threads, started.elapsed().as_secs_f64(), load_s, &records);
    folder.write(&toml::to_string_pretty(config)?, &summary, &timing, &records)?;

    if printer.is_json() {
        printer.json(&summary)?;
    } else {
        printer.line(main_table(&records, &summary.aggregates, printer.width()));
        if let Some(total) = timing.planning_call_ms.total {
            let count = timing.planning_calls;
            printer.line(format!("\n{count} planning calls: p50 {:.0} ms, p95 {:.0} ms", total.p50, total.p95));
        }
    }
    printer.note(format!("results in {}", folder.path().display()));
    let failed = failures(&records);
    for line in &failed {
        printer.note(format!("failed: {line}"));
    }
    Ok(if failed.is_empty() { Exit::Success } else { Exit::SomeFailed })
}

/// Every scenario with every planner in every challenge.
fn assignments(flags: &SimulateArguments) -> anyhow::Result<Vec<Assignment>> {
    let challenges = match flags.challenge.as_str() {
        "both" => Challenge::ALL.to_vec(),
        one => vec![one.parse::<Challenge>().context("--challenge takes nonreactive, reactive or both")?],
    };
    let planners = flags.planner.iter().map(|name| name.parse()).collect::<Result<Vec<PlannerKind>, _>>()?;
    let data = NuPlanData::new(DataRoots::from_environment());
    let mut sources = Vec::new();
    for word in &flags.scenarios {
        sources.extend(ScenarioSource::find(word, &data)?);
    }
    if flags.scenarios.is_empty() {
        sources.push(ScenarioSource::Generated(generator::DEFAULT));
    }
    let mut all: Vec<Assignment> = Vec::new();
    for source in &sources {
        for &planner in &planners {
            let drives = challenges.iter().map(|&challenge| Assignment { source: source.clone(), planner, challenge });
            // A scenario or planner that is named twice is driven once, or it would count twice in the means.
            let new: Vec<Assignment> = drives.filter(|drive| !all.contains(drive)).collect();
            all.extend(new);
        }
    }
    Ok(all)
}

/// The processor's name as the system gives it.
fn cpu() -> String {
    let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = info.lines().find_map(|line| line.strip_prefix("model name")).and_then(|rest| rest.split_once(':'));
    model.map_or_else(|| std::env::consts::ARCH.to_owned(), |(_, name)| name.trim().to_owned())
}
