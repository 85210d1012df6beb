//! `planagent completions`.

use crate::args::{ALL_STUDIES, Arguments};
use crate::settings::keys;
use crate::{Exit, Printer};
use clap::builder::PossibleValuesParser;
use clap::{Arg, Command, CommandFactory, ValueHint};
use clap_complete::{Shell, generate};
use planagent_lab::study;
use planagent_lab::study_runs::{TOKENS, TWINS};
use planagent_planners::all_planners;
use planagent_runs::runner::{Config, model_registry, silent};
use planagent_runs::worker::interactive::NAMES as INTERACTIVE;
use planagent_runs::worker::suite::Suite;
use planagent_scenario::generator::types;
use planagent_scenario::{DataRoots, Readers};
use planagent_world::InteractionKind;

/// The prompt sets and challenges, as their options name them.
const PROMPT_SETS: [&str; 4] = ["paper", "brief", "compact", "compact-2"];
const CHALLENGES: [&str; 4] = ["nonreactive", "reactive", "both", "open-loop"];

/// Prints the script that completes commands in a shell.
pub(crate) fn run(shell: Shell, printer: Printer) -> anyhow::Result<Exit> {
    let values = Values::known()?;
    let mut command = values.within(Arguments::command());
    let name = command.get_name().to_owned();
    let mut script = Vec::new();
    generate(shell, &mut command, name, &mut script);
    printer.text(String::from_utf8(script)?.trim_end());
    Ok(Exit::Success)
}

/// The names that a script offers as values. Other values stay possible: the program itself does
/// not read these.
struct Values {
    planners: Vec<String>,
    splits: Vec<String>,
    types: Vec<String>,
    kinds: Vec<String>,
    studies: Vec<String>,
    models: Vec<String>,
    settings: Vec<String>,
}

impl Values {
    /// Those of the registries, the models of this working directory among them.
    fn known() -> anyhow::Result<Self> {
        let owned = |names: &[&str]| names.iter().map(ToString::to_string).collect::<Vec<_>>();
        let registry = all_planners();
        let planners = registry.entries().iter();
        let mut splits = owned(&Readers::new(&DataRoots::default()).splits());
        splits.extend(Suite::ALL.map(|suite| suite.name.to_owned()));
        splits.extend(owned(&INTERACTIVE));
        let studies = study::names().chain([TOKENS, TWINS, ALL_STUDIES]);
        let settings = keys()?.into_iter().map(|key| format!("{key}="));
        Ok(Self {
            planners: planners.map(|entry| entry.name.to_string()).collect(),
            splits,
            types: types::in_suites().map(|kind| kind.to_string()).collect(),
            kinds: owned(&InteractionKind::ALL.map(InteractionKind::name)),
            studies: studies.map(str::to_owned).collect(),
            models: model_registry(&Config::default(), &silent()).names()?,
            settings: settings.collect(),
        })
    }

    /// The command with these values.
    fn within(&self, command: Command) -> Command {
        let name = command.get_name().to_owned();
        command
            .mut_args(|arg| self.offered(&name, arg))
            .mut_subcommands(|command| self.within(command))
    }

    /// An argument of a command with the values that it may have.
    fn offered(&self, command: &str, arg: Arg) -> Arg {
        let of_models = ["bench", "show", "check", "fetch", "quantize"];
        let offers = match arg.get_id().as_str() {
            "planner" if command == "simulate" || command == "render" => &self.planners,
            "splits" => &self.splits,
            "types" => &self.types,
            "modify" => &self.kinds,
            "suites" if command == "study" => &self.splits,
            "name" if command == "study" => &self.studies,
            "model" => &self.models,
            "models" if of_models.contains(&command) => &self.models,
            "set" => &self.settings,
            "prompt_set" => return arg.value_parser(PROMPT_SETS),
            "challenge" => return arg.value_parser(CHALLENGES),
            "run" | "runs" | "first" | "second" | "resume" | "out" => {
                return arg.value_hint(ValueHint::AnyPath);
            }
            _ => return arg,
        };
        // clap wants texts that live as long as the program, which ends with the script.
        let offers = offers.iter().map(|name| &*name.clone().leak());
        arg.value_parser(PossibleValuesParser::new(offers))
    }
}
