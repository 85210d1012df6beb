//! The command line: flags, commands, printing, exit codes.

mod args;
mod commands;
mod exit;
mod help;
mod picture;
mod printer;
mod progress;

use crate::experiment::panic_guard;
use crate::runner::Config;
use crate::scenario::absolute_path;
use anyhow::bail;
use args::{Arguments, Command, SimulateArguments};
use clap::Parser;
use std::path::Path;
use std::process::ExitCode;

pub use exit::Exit;
pub use printer::Printer;

const MAX_THREADS: usize = 512;

/// Runs the program with the arguments of the process.
pub fn run() -> ExitCode {
    panic_guard::install_hook();
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => {
            // Help and version are no errors; clap prints each where it belongs.
            let _ = error.print();
            return if error.use_stderr() { Exit::Error.into() } else { Exit::Success.into() };
        }
    };
    let printer = Printer::new(arguments.json, arguments.quiet).with_details(arguments.verbose);
    let outcome = execute(&arguments, printer).and_then(|exit| printer.finish().map(|()| exit));
    match outcome {
        Ok(exit) => exit.into(),
        Err(error) => {
            printer.error(&error);
            Exit::Error.into()
        }
    }
}

fn execute(arguments: &Arguments, printer: Printer) -> anyhow::Result<Exit> {
    let mut config = configuration(arguments)?;
    if let Some(seed) = arguments.seed {
        config.seed = seed;
    }
    if let Some(model) = &arguments.model {
        config.mllm.model.clone_from(model);
    }
    config.mllm.quantize = arguments.quantize.or(config.mllm.quantize);
    config.mllm.ignore_memory |= arguments.ignore_memory;
    config.mllm.offline |= arguments.offline;
    // Absolute paths let `--resume` work from any directory.
    for word in [Some(&mut config.mllm.model), config.reasoning.prompt_set.as_mut()].into_iter().flatten() {
        if word.contains(['/', '\\']) && Path::new(word).exists() {
            *word = absolute_path(word);
        }
    }
    let threads = arguments.threads.unwrap_or(0);
    if threads > MAX_THREADS {
        bail!("--threads is {threads}; it must be at most {MAX_THREADS}");
    }
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
    pool.install(|| match &arguments.command {
        Command::Simulate(flags) => commands::simulate::run(flags, &config, printer),
        Command::Plan(flags) => commands::plan::run(flags, &config, printer),
        Command::Render(flags) => commands::render::run(flags, printer),
        Command::Report(flags) => commands::report::run(flags, printer),
        Command::Scenarios(command) => commands::scenarios::run(command, printer),
        Command::Models(command) => commands::models::run(command, &config, printer),
        Command::Dataset(flags) => commands::dataset::run(flags, &config, printer),
        Command::Experiment(flags) => commands::experiment::run(flags, &config, printer),
        Command::Bench(flags) => commands::bench::run(flags, &config, printer),
        Command::BenchProcess => commands::bench::process(&config, printer),
    })
}

/// The configuration of the file that `--config` names; without it, that of the run that is resumed.
fn configuration(arguments: &Arguments) -> anyhow::Result<Config> {
    Ok(match &arguments.command {
        Command::Simulate(SimulateArguments { resume: Some(folder), .. }) if arguments.config.is_none() => {
            Config::of_run(folder)?
        }
        // The parent process sends this one all that it needs.
        Command::BenchProcess => Config::default(),
        _ => Config::load(arguments.config.as_deref())?,
    })
}
