//! The command line: flags, commands, printing, exit codes.

mod again;
mod args;
mod commands;
mod completed;
mod csv;
mod exit;
mod explained;
mod film;
mod help;
mod interrupt;
mod llama_options;
mod next_steps;
mod picture;
mod printer;
mod progress;
mod settings;
mod suggest;
mod words;

pub(crate) use exit::Exit;
pub use printer::Printer;
pub use settings::trial_by;

use anyhow::bail;
use args::{Arguments, Command};
use clap::error::ErrorKind;
use clap::{CommandFactory, FromArgMatches};
use planagent_runs::runner::set_build_commit;
use planagent_runs::worker::panic_guard;
use settings::Settings;
use std::ffi::OsString;
use std::process::ExitCode;
use std::sync::OnceLock;

/// Maximum number of threads.
pub const MAX_THREADS: usize = 512;
/// The variable with the number of threads, where `--threads` gives none.
const THREADS_VARIABLE: &str = "RAYON_NUM_THREADS";

/// What starts the program, where that is not the executable of the process alone.
static LAUNCHER: OnceLock<Vec<OsString>> = OnceLock::new();

/// Runs the program with the arguments of the process; `commit` is what it was built from.
pub fn run(commit: Option<&'static str>) -> ExitCode {
    run_with(std::env::args_os(), commit).into()
}

/// Runs the program inside another one, which `launcher` starts as this program: a command and its
/// first arguments. The arguments begin with the name of the program. Gives the exit code.
pub fn run_inside(
    arguments: impl IntoIterator<Item = OsString>,
    launcher: Vec<OsString>,
    commit: Option<&'static str>,
) -> u8 {
    // The first call stays: a process is started in one way.
    let _ = LAUNCHER.set(launcher);
    run_with(arguments, commit).code()
}

/// What starts this program: a command and its first arguments.
fn launched() -> std::io::Result<Vec<OsString>> {
    match LAUNCHER.get().filter(|launcher| !launcher.is_empty()) {
        Some(launcher) => Ok(launcher.clone()),
        None => Ok(vec![std::env::current_exe()?.into_os_string()]),
    }
}

/// A command that starts this program.
fn this_program() -> std::io::Result<std::process::Command> {
    let launcher = launched()?;
    let [program, first @ ..] = launcher.as_slice() else {
        return Err(std::io::ErrorKind::NotFound.into());
    };
    let mut command = std::process::Command::new(program);
    command.args(first);
    Ok(command)
}

fn run_with(arguments: impl IntoIterator<Item = OsString>, commit: Option<&'static str>) -> Exit {
    panic_guard::install_hook();
    #[cfg(unix)]
    interrupt::outlive_file_limits();
    if let Some(commit) = commit {
        set_build_commit(commit);
    }
    let words: Vec<OsString> = arguments.into_iter().collect();
    again::remember(&words);
    if let Some(exit) = commands::completions::answer(&words) {
        return exit;
    }
    if let Some(advice) = llama_options::instead(&words) {
        let error = Arguments::command().error(ErrorKind::UnknownArgument, advice);
        return Printer::arguments(error, &words);
    }
    let matches = with_negative_numbers(Arguments::command()).try_get_matches_from(&words);
    let arguments = match matches.and_then(|matches| Arguments::from_arg_matches(&matches)) {
        Ok(arguments) => arguments,
        // Help and version are no errors.
        Err(mut error) => {
            suggest::add_new_command(&mut error);
            return Printer::arguments(error, &words);
        }
    };
    let global = &arguments.global;
    let printer = Printer::new(global.json, global.quiet).with_details(global.verbose);
    let outcome = execute(&arguments, printer).and_then(|exit| printer.finish().map(|()| exit));
    match outcome {
        Ok(exit) => exit,
        Err(error) => {
            printer.error(&error);
            Exit::Error
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
    // rayon takes it where no number is given.
    let of_environment = std::env::var(THREADS_VARIABLE).ok();
    let too_many = |text: &String| text.parse().is_ok_and(|count: usize| count > MAX_THREADS);
    if let Some(text) = of_environment.filter(|text| threads == 0 && too_many(text)) {
        bail!("{THREADS_VARIABLE} is {text}; it must be at most {MAX_THREADS}");
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
        Command::Memory(command) => commands::memory::run(command, config, printer),
        Command::Study(flags) => commands::study::run(flags, config, printer),
        Command::Card(flags) => commands::card::run(flags, config, printer),
        Command::Bench(flags) => commands::bench::run(flags, config, printer),
        Command::Config(flags) => commands::config::run(flags, &settings, printer),
        Command::Completions { shell } => commands::completions::run(*shell, printer),
        Command::BenchProcess(flags) => commands::bench::process(flags.candle, config, printer),
        Command::TrialProcess => commands::trial::run(),
    })
}
