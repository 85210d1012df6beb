//! `planagent completions`: a script for a shell, which asks this program at each press of Tab how
//! the line may go on.
//!
//! The engine is that of clap, whose interface between script and program may change with each
//! version. So the script is written again when a shell starts, and is no file. The engine inserts
//! what it finds without quotes, and a shell would run a name such as `$(x)`: only names that need
//! no quotes are offered.

use crate::args::{ALL_STUDIES, Arguments};
use crate::settings::{Settings, keys};
use crate::{Exit, Printer};
use anyhow::Context;
use clap::{Arg, Command, CommandFactory, Parser, ValueHint};
use clap_complete::Shell;
use clap_complete::engine::{
    ArgValueCompleter, CompletionCandidate, PathCompleter, ValueCompleter,
};
use clap_complete::env::{CompleteEnv, Shells};
use planagent_files::quoted;
use planagent_lab::study;
use planagent_lab::study_runs::{TOKENS, TWINS};
use planagent_planners::all_planners;
use planagent_runs::runner::{Config, model_registry, silent};
use planagent_runs::worker::interactive::NAMES as INTERACTIVE;
use planagent_runs::worker::suite::Suite;
use planagent_scenario::generator::types;
use planagent_scenario::{DataRoots, Readers};
use planagent_world::InteractionKind;
use std::ffi::{OsStr, OsString};
use std::path::Path;

/// The program as a shell knows it.
const PROGRAM: &str = "planagent";
/// The variable by which a script asks; it names the shell.
const VARIABLE: &str = "PLANAGENT_COMPLETE";
/// The prompt sets and challenges, as their options name them.
const PROMPT_SETS: [&str; 4] = ["paper", "brief", "compact", "compact-2"];
const CHALLENGES: [&str; 4] = ["nonreactive", "reactive", "both", "open-loop"];

/// Prints the script that completes commands in a shell.
pub(crate) fn run(shell: Shell, printer: Printer) -> anyhow::Result<Exit> {
    let program = std::env::args_os().next().map_or_else(
        || PROGRAM.to_owned(),
        |word| program_of(&word, std::env::current_dir().ok().as_deref()),
    );
    let shells = Shells::builtins();
    let completer = shells
        .completer(&shell.to_string())
        .with_context(|| format!("no completions for the shell {shell}"))?;
    let mut script = Vec::new();
    completer.write_registration(VARIABLE, PROGRAM, PROGRAM, &program, &mut script)?;
    printer.text(String::from_utf8(script)?.trim_end());
    Ok(Exit::Success)
}

/// What a script calls: the program where it was named by a path, else the one of this name.
fn program_of(word: &OsStr, here: Option<&Path>) -> String {
    let path = Path::new(word);
    let is_program = path.file_stem().is_some_and(|stem| stem == PROGRAM);
    match here {
        Some(here) if is_program && path.components().count() > 1 => {
            here.join(path).to_string_lossy().into_owned()
        }
        _ => PROGRAM.to_owned(),
    }
}

/// Answers a script that asks how a line goes on; `None` where none asks.
pub(crate) fn answer(words: &[OsString]) -> Option<Exit> {
    let asked = CompleteEnv::with_factory(|| completed(Arguments::command()))
        .var(VARIABLE)
        .bin(PROGRAM);
    let here = std::env::current_dir().ok();
    match asked.try_complete(words.iter().cloned(), here.as_deref()) {
        Ok(false) => None,
        Ok(true) => Some(Exit::Success),
        Err(error) => Some(Printer::arguments(error, words)),
    }
}

/// The command with the names that its values may have. Other values stay possible: the program
/// itself does not read these.
fn completed(command: Command) -> Command {
    let name = command.get_name().to_owned();
    command
        .mut_args(|arg| offered(&name, arg))
        .mut_subcommands(completed)
}

/// An argument of a command with the values that it may have.
fn offered(command: &str, arg: Arg) -> Arg {
    let of_models = ["bench", "show", "check", "fetch", "quantize"];
    let id = arg.get_id().as_str();
    let names: fn() -> Vec<String> = match id {
        "planner" if command == "simulate" || command == "render" => planners,
        "splits" => splits,
        "suites" if command == "study" => splits,
        "types" => || types::in_suites().map(|kind| kind.to_string()).collect(),
        "modify" => || owned(&InteractionKind::ALL.map(InteractionKind::name)),
        "name" if command == "study" => studies,
        "model" => models,
        "models" if of_models.contains(&command) => models,
        "set" => settings,
        "prompt_set" => || owned(&PROMPT_SETS),
        "challenge" => || owned(&CHALLENGES),
        _ => Vec::new,
    };
    let of_paths = [
        "run", "runs", "first", "second", "resume", "out", "model", "models",
    ];
    let hint = arg.get_value_hint();
    let paths = of_paths.contains(&id) || !matches!(hint, ValueHint::Unknown | ValueHint::Other);
    if !arg.get_action().takes_values() || !arg.get_possible_values().is_empty() {
        return arg;
    }
    arg.add(ArgValueCompleter::new(Offers { names, paths }))
}

/// The values of an argument.
struct Offers {
    names: fn() -> Vec<String>,
    paths: bool,
}

impl ValueCompleter for Offers {
    fn complete(&self, current: &OsStr) -> Vec<CompletionCandidate> {
        // Lists have commas, whether or not the argument is split by clap.
        let text = current.to_string_lossy();
        let start = text.rfind(',').map_or(0, |comma| comma + 1);
        let (before, begun) = text.split_at(start);
        let names = (self.names)().into_iter();
        let mut found: Vec<CompletionCandidate> = names
            .filter(|name| name.starts_with(begun) && is_plain(name))
            .map(|name| CompletionCandidate::new(format!("{before}{name}")))
            .collect();
        if self.paths {
            let paths = PathCompleter::any().complete(current);
            found.extend(
                paths
                    .into_iter()
                    .filter(|path| path.get_value().to_str().is_some_and(is_plain)),
            );
        }
        found
    }
}

/// Whether a shell takes a word as it stands.
fn is_plain(word: &str) -> bool {
    quoted(word) == word
}

fn owned(names: &[&str]) -> Vec<String> {
    names.iter().map(ToString::to_string).collect()
}

fn planners() -> Vec<String> {
    let registry = all_planners();
    let entries = registry.entries().iter();
    entries.map(|entry| entry.name.to_string()).collect()
}

fn splits() -> Vec<String> {
    let mut splits = owned(&Readers::new(&DataRoots::default()).splits());
    splits.extend(Suite::ALL.map(|suite| suite.name.to_owned()));
    splits.extend(owned(&INTERACTIVE));
    splits
}

fn studies() -> Vec<String> {
    let names = study::names().chain([TOKENS, TWINS, ALL_STUDIES]);
    names.map(str::to_owned).collect()
}

/// The settings with the sign before their value.
fn settings() -> Vec<String> {
    let keys = keys().expect("the default settings are a table of TOML");
    keys.into_iter().map(|key| format!("{key}=")).collect()
}

/// The described models of this folder, and the one of its `planagent.toml`. A file that cannot be
/// read gives none; a command that uses it says why.
fn models() -> Vec<String> {
    let read = Arguments::try_parse_from([PROGRAM, "config"])
        .map(|arguments| Settings::from_arguments(&arguments));
    let configured = match read {
        Ok(Ok(settings)) => settings.config,
        _ => Config::default(),
    };
    let registry = model_registry(&configured, &silent());
    let mut names = registry.names().unwrap_or_default();
    if !names.contains(&configured.mllm.model) {
        names.push(configured.mllm.model);
    }
    names
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_script_calls_the_program_that_wrote_it() {
        let here = Some(Path::new("/work"));
        let program = |word: &str| program_of(OsStr::new(word), here);
        assert_eq!(program("planagent"), "planagent");
        assert_eq!(program("./bin/planagent"), "/work/./bin/planagent");
        assert_eq!(program("/opt/planagent"), "/opt/planagent");
        assert_eq!(program("/usr/bin/python3"), "planagent");
        assert_eq!(program_of(OsStr::new("a/planagent"), None), "planagent");
    }

    #[test]
    fn only_words_that_need_no_quotes_are_offered() {
        let offers = Offers {
            names: || owned(&["pdm-closed", "$(x)", "a b", "\u{1b}[2J", "plan-agent"]),
            paths: false,
        };
        let offered = |current: &str| -> Vec<String> {
            let found = offers.complete(OsStr::new(current));
            let words = found.iter().map(|one| one.get_value().to_string_lossy());
            words.map(std::borrow::Cow::into_owned).collect()
        };
        assert_eq!(offered(""), ["pdm-closed", "plan-agent"]);
        assert_eq!(offered("idm,pd"), ["idm,pdm-closed"]);
        assert_eq!(offered("$"), Vec::<String>::new());
    }
}
