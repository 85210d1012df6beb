//! The command line: flags, commands, printing, exit codes.

mod args;
mod commands;
mod completed;
mod csv;
mod exit;
mod film;
mod help;
mod interrupt;
mod llama_options;
mod picture;
mod printer;
mod progress;
mod settings;
mod suggest;
mod words;

pub use exit::Exit;
pub use printer::Printer;

use anyhow::bail;
use args::{Arguments, Command};
use clap::error::ErrorKind;
use clap::{CommandFactory, FromArgMatches};
use planagent_runs::runner::set_build_commit;
use planagent_runs::worker::panic_guard;
use settings::Settings;
use std::process::ExitCode;

const MAX_THREADS: usize = 512;

/// Runs the program with the arguments of the process; `commit` is what it was built from.
pub fn run(commit: Option<&'static str>) -> ExitCode {
    panic_guard::install_hook();
    if let Some(commit) = commit {
        set_build_commit(commit);
    }
    if let Some(advice) = llama_options::instead(std::env::args_os()) {
        let error = Arguments::command().error(ErrorKind::UnknownArgument, advice);
        let _ = error.print();
        return Exit::Error.into();
    }
    let matches = with_negative_numbers(Arguments::command()).try_get_matches();
    let arguments = match matches.and_then(|matches| Arguments::from_arg_matches(&matches)) {
        Ok(arguments) => arguments,
        Err(mut error) => {
            suggest::add_new_command(&mut error);
            // Help and version are no errors; clap prints each where it belongs.
            let _ = error.print();
            return if error.use_stderr() {
                Exit::Error.into()
            } else {
                Exit::Success.into()
            };
        }
    };
    let global = &arguments.global;
    let printer = Printer::new(global.json, global.quiet).with_details(global.verbose);
    let outcome = execute(&arguments, printer).and_then(|exit| printer.finish().map(|()| exit));
    match outcome {
        Ok(exit) => exit.into(),
        Err(error) => {
            printer.error(&error);
            Exit::Error.into()
        }
    }
}

/// The same, whose options take `-1` as a value: then the error says which option does not.
fn with_negative_numbers(command: clap::Command) -> clap::Command {
    let taking = |arg: clap::Arg| {
        let takes_one = arg.get_action().takes_values() && !arg.is_positional();
        if takes_one {
            arg.allow_negative_numbers(true)
        } else {
            arg
        }
    };
    command
        .mut_args(taking)
        .mut_subcommands(with_negative_numbers)
}

fn execute(arguments: &Arguments, printer: Printer) -> anyhow::Result<Exit> {
    let settings = Settings::from_arguments(arguments)?;
    let config = &settings.config;
    let threads = arguments.global.threads.unwrap_or(0);
    if threads > MAX_THREADS {
        bail!("--threads is {threads}; it must be at most {MAX_THREADS}");
    }
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()?;
    pool.install(|| match &arguments.command {
        Command::Simulate(flags) => commands::simulate::run(flags, config, printer),
        Command::Plan(flags) => commands::plan::run(flags, config, printer),
        Command::Ask(flags) => commands::ask::run(flags, config, printer),
        Command::Render(flags) => commands::render::run(flags, printer),
        Command::Report(flags) => commands::report::run(flags, printer),
        Command::Serve(flags) => commands::serve::run(flags, printer),
        Command::Compare(flags) => commands::compare::run(flags, printer),
        Command::Merge(flags) => commands::merge::run(flags, printer),
        Command::Scenarios(command) => commands::scenarios::run(command, printer),
        Command::Models(command) => commands::models::run(command, config, printer),
        Command::Dataset(flags) => commands::dataset::run(flags, config, printer),
        Command::Study(flags) => commands::study::run(flags, config, printer),
        Command::Bench(flags) => commands::bench::run(flags, config, printer),
        Command::Config(_) => commands::config::run(&settings, printer),
        Command::Completions { shell } => commands::completions::run(*shell, printer),
        Command::BenchProcess(_) => commands::bench::process(config, printer),
        Command::TrialProcess => commands::trial::run(),
    })
}
