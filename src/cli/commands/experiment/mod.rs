//! `planagent experiment`.

mod runs;
mod suites;
mod tokens;

use crate::cli::args::{ALL_EXPERIMENTS, ExperimentArguments, TOKENS_EXPERIMENT};
use crate::cli::{Config, Exit, Printer};
use crate::experiment::study::{self, Quick, Study};
use crate::report::{
    BenchFigures, BenchFolder, ModelFigures, Outcome, SimulationRow, StudyFolder, StudyResults, SuiteSimulations,
    VariantSimulations, failures, study_table,
};
use anyhow::{anyhow, bail};
use indicatif::HumanDuration;
use runs::Runs;
use std::path::PathBuf;
use std::rc::Rc;
use std::time::Instant;
use suites::{Suite, Suites};

/// Folder of the runs, beside those of the results.
const DRIVES: &str = "drives";

/// Name of a variant's run, or why there is none.
type RunName = Result<String, &'static str>;

/// A study with the suites that it is driven on, and for each the names of its variants' runs.
struct Planned {
    study: Study,
    suites: Vec<(Rc<Suite>, Vec<RunName>)>,
}

/// Makes the drives of experiments that are not there yet; the results go to a folder, the tables to stdout.
///
/// # Errors
/// When the input, a model or a folder cannot be used; a failed drive is no such error.
pub(in crate::cli) fn run(flags: &ExperimentArguments, config: &Config, printer: Printer) -> anyhow::Result<Exit> {
    let mut suites = Suites::new(flags, printer)?;
    let all = flags.name == ALL_EXPERIMENTS;
    let mut exit = Exit::Success;
    if all || flags.name == TOKENS_EXPERIMENT {
        let suites = suites.of(TOKENS_EXPERIMENT, tokens::SUITES)?;
        let (folder, command) = (folder(TOKENS_EXPERIMENT, flags), command(TOKENS_EXPERIMENT, flags));
        exit = tokens::run(&suites, folder, &command, config, printer)?;
    }
    if flags.name != TOKENS_EXPERIMENT {
        exit = exit.max(drive_and_tell(&mut suites, flags, config, printer)?);
    }
    Ok(exit)
}

/// Makes the drives of the studies that are meant, and their results of these.
fn drive_and_tell(
    suites: &mut Suites<'_>,
    flags: &ExperimentArguments,
    config: &Config,
    printer: Printer,
) -> anyhow::Result<Exit> {
    let started = Instant::now();
    let studies =
        if flags.name == ALL_EXPERIMENTS { study::all() } else { study::named(&flags.name).into_iter().collect() };
    let bench = bench(flags)?;
    let mut runs = Runs::new(flags.out.join(DRIVES), config, printer)?;
    let mut planned = Vec::new();
    for study in studies {
        planned.push(plan(study, suites, &mut runs)?);
    }
    drive(&mut runs, flags, printer, started)?;
    for Planned { study, suites } in &planned {
        let drives: Vec<SuiteSimulations> = suites.iter().map(|(suite, names)| driven(suite, names, &runs)).collect();
        let quick = flags.quick.then_some(Quick::DEFAULT);
        let results = StudyResults::new(study, &drives, quick, config.seed, &bench);
        let folder = StudyFolder::new(folder(study.name, flags));
        folder.write(study, &results, &command(study.name, flags))?;
        if printer.is_json() {
            printer.json(&results)?;
        } else {
            printer.line(study_table(study, &results));
            printer.line("");
        }
        printer.note(format!("results in {}", folder.path().display()));
    }
    Ok(tell(&planned, &runs, printer))
}

/// Finds the suites of a study and takes up the runs of its variants.
fn plan(study: Study, suites: &mut Suites<'_>, runs: &mut Runs<'_>) -> anyhow::Result<Planned> {
    let mut planned = Vec::new();
    for suite in suites.of(study.name, study.suites)? {
        let names = study.variants.iter().map(|variant| runs.add(&suite, variant)).collect::<anyhow::Result<_>>()?;
        planned.push((suite, names));
    }
    Ok(Planned { study, suites: planned })
}

/// Makes the drives that are left, and says beforehand how many these are and how long they will take.
fn drive(runs: &mut Runs<'_>, flags: &ExperimentArguments, printer: Printer, started: Instant) -> anyhow::Result<()> {
    runs.open(flags.retry_failed)?;
    let (made, left) = runs.drives();
    printer.note(format!(
        "{}: {} drives in {} runs; {made} are made, {left} are left",
        flags.name,
        made + left,
        runs.count()
    ));
    runs.measure()?;
    if left > 0 {
        let (_, left) = runs.drives();
        let (time, threads) = (HumanDuration(runs.left()), rayon::current_num_threads());
        printer.note(format!("about {time} for {left} drives on {threads} threads"));
    }
    runs.make(started)
}

/// What was driven on a suite.
fn driven(suite: &Suite, names: &[Result<String, &'static str>], runs: &Runs<'_>) -> SuiteSimulations {
    let variant = |name: &Result<String, &'static str>| match name {
        Ok(name) => {
            let run = runs.get(name);
            let rows = run.map_or_else(Vec::new, |run| run.rows().to_vec());
            let outcome = Outcome::Simulated { run: format!("../{DRIVES}/{name}"), rows };
            VariantSimulations { outcome, parameters: run.and_then(runs::Run::parameters) }
        }
        Err(why) => VariantSimulations { outcome: Outcome::NotSimulated(why), parameters: None },
    };
    SuiteSimulations {
        name: suite.name.clone(),
        scenes: suite.sources.len(),
        blake3: suite.list.blake3.clone(),
        variants: names.iter().map(variant).collect(),
    }
}

/// The models of the bench that is named.
fn bench(flags: &ExperimentArguments) -> anyhow::Result<Vec<ModelFigures>> {
    let Some(path) = &flags.bench else { return Ok(Vec::new()) };
    let figures = BenchFigures::of(&BenchFolder::read(path)?);
    if figures.models.is_empty() {
        bail!("the bench in {} has measured no model", path.display());
    }
    Ok(figures.models)
}

/// The folder of an experiment's results.
fn folder(name: &str, flags: &ExperimentArguments) -> PathBuf {
    flags.out.join(if flags.quick { format!("{name}-quick") } else { name.to_owned() })
}

/// The command that makes the results of an experiment.
fn command(name: &str, flags: &ExperimentArguments) -> String {
    let mut words = vec!["planagent experiment".to_owned(), name.to_owned()];
    words.extend(flags.quick.then(|| "--quick".to_owned()));
    if !flags.suites.is_empty() {
        words.push(format!("--suite {}", flags.suites.join(",")));
    }
    words.join(" ")
}

/// Failures to stderr, and how the program ends.
fn tell(planned: &[Planned], runs: &Runs<'_>, printer: Printer) -> Exit {
    let rows = || runs.all().flat_map(runs::Run::rows);
    let all: Vec<SimulationRow> = rows().filter(|row| row.error.is_some()).cloned().collect();
    for line in failures(&all) {
        printer.note(format!("failed: {line}"));
    }
    let lost: usize = rows().map(|row| row.failed_calls).sum();
    if lost > 0 {
        printer.note(format!("{lost} planning calls got no answer; calls.jsonl of the runs says why"));
    }
    let mut missing: Vec<_> = Vec::new();
    for list in planned.iter().flat_map(|planned| &planned.suites).flat_map(|(suite, _)| &suite.list.missing) {
        if !missing.contains(&list) {
            printer.error(&anyhow!("not driven: {list}"));
            missing.push(list);
        }
    }
    if all.is_empty() && lost == 0 && missing.is_empty() { Exit::Success } else { Exit::SomeFailed }
}
