//! The settings of a command, and where each comes from.

use super::args::{Arguments, Command, SimulateArguments, TRIAL_PROCESS};
use super::launched;
use super::suggest::{nearest, similar_exists};
use super::words::planner_words;
use anyhow::{Context, bail};
use planagent_agent::planner::{LanguageAgentSettings, LearnedSettings};
use planagent_agent::reasoning::built_in_prompts;
use planagent_files::word_of;
use planagent_mllm::trial::Trial;
use planagent_mllm::{AdapterSpec, Trust, offline_variable};
use planagent_planners::all_planners;
use planagent_runs::report::RenamedSetting;
use planagent_runs::runner::{Config, agent_tables, language_agents};
use planagent_scenario::absolute_path;
use serde::Serialize;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use toml::{Table, Value};

/// Keys without a default value, beside the memories of language agents and the checkpoints of learned
/// planners; the others are those of [`Config::default`].
const OPTIONAL: [&str; 9] = [
    "mllm.adapter",
    "mllm.quantize",
    "mllm.context",
    "agent.deadline_ms",
    "agent.gate",
    "environment.oncoming_lane",
    "reasoning.prompt_set",
    "reasoning.proposals",
    "reasoning.speculation",
];

/// The settings of a command.
pub(super) struct Settings {
    /// The settings.
    pub(super) config: Config,
    /// What replaced defaults, in order, with its name.
    layers: Vec<(String, Table)>,
}

/// A setting with its origin.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Setting {
    /// Its key with the section.
    pub(super) key: String,
    /// Its value; none for an optional setting that is not set.
    pub(super) value: Option<Value>,
    /// What set it.
    pub(super) origin: String,
}

impl Settings {
    /// The settings of arguments: a file or the run that is resumed, below `HF_HUB_OFFLINE`, below
    /// `--set`, below options of their own.
    pub(super) fn from_arguments(arguments: &Arguments) -> anyhow::Result<Self> {
        let global = &arguments.global;
        let mut settings = base(arguments)?;
        settings.take_environment();
        for text in &global.set {
            let table = parse(text)?;
            let origin = format!("--set {text}");
            settings.config = settings.config.overlaid_at(&table, &origin)?;
            settings.layers.push(("--set".to_owned(), table));
        }
        settings.take_options(arguments);
        settings.take_checkpoints(arguments)?;
        Ok(settings)
    }

    /// Takes what the variables of the hub's own tools say.
    fn take_environment(&mut self) {
        if let Some(variable) = offline_variable() {
            let table = nested("mllm.offline", true.into());
            self.layers.push((variable.to_owned(), table));
            self.config.mllm.offline = true;
        }
    }

    fn take_options(&mut self, arguments: &Arguments) {
        let flags = arguments.command.model_flags();
        let mut note = |option: &str, key: &str, value: Value| {
            self.layers.push((option.to_owned(), nested(key, value)));
        };
        let config = &mut self.config;
        if let Some(seed) = arguments.global.seed {
            config.seed = seed;
            note("--seed", "seed", Value::Integer(seed as i64));
        }
        if let Some(model) = flags.model {
            note("--model", "mllm.model", model.clone().into());
            config.mllm.model = model;
            config.of_run.name("mllm.model");
        }
        if let Some(set) = flags.prompt_set {
            note("--prompt-set", "reasoning.prompt_set", set.clone().into());
            config.reasoning.prompt_set = Some(set);
        }
        if let Some(path) = flags.adapter {
            let word = word_of(path.as_os_str());
            note("--adapter", "mllm.adapter", word.into());
            config.mllm.adapter = Some(AdapterSpec::new(path));
        }
        if let Some(format) = flags.quantize {
            note("--quantize", "mllm.quantize", format.to_string().into());
            config.mllm.quantize = Some(format);
        }
        if let Some(context) = flags.context {
            note("--context", "mllm.context", Value::Integer(context as i64));
            config.mllm.context = Some(context);
        }
        if flags.ignore_memory {
            note("--ignore-memory", "mllm.ignore_memory", true.into());
            config.mllm.ignore_memory = true;
        }
        if flags.offline {
            note("--offline", "mllm.offline", true.into());
            config.mllm.offline = true;
        }
        config.mllm.trust = if flags.trust_model {
            Trust::Caller
        } else {
            trial()
        };
        // Absolute paths let `--resume` work from any directory.
        if let Some(adapter) = &mut config.mllm.adapter {
            adapter.path = std::path::absolute(&adapter.path).unwrap_or(adapter.path.clone());
        }
        config
            .learned
            .all_mut()
            .chain(config.language_agents.memories_mut())
            .for_each(|path| *path = absolute_path(path));
        for word in [
            Some(&mut config.mllm.model),
            config.reasoning.prompt_set.as_mut(),
        ]
        .into_iter()
        .flatten()
        {
            if word.contains(['/', '\\']) && Path::new(word).exists() {
                *word = absolute_path(word);
            }
        }
    }

    /// Takes `--checkpoint FILE` for the one learned planner that is named, and `--checkpoint
    /// PLANNER=FILE`.
    fn take_checkpoints(&mut self, arguments: &Arguments) -> anyhow::Result<()> {
        let Command::Simulate(flags) = &arguments.command else {
            return Ok(());
        };
        for word in &flags.checkpoint {
            // A file name may have an `=` of its own, so only a learned planner's name counts
            // before one.
            let named = word
                .split_once('=')
                .filter(|(planner, _)| is_learned(planner));
            let (planner, file) = match named {
                Some((planner, _))
                    if flags.resume.is_none()
                        && !planner_words(&flags.planner)
                            .iter()
                            .any(|one| one == planner) =>
                {
                    bail!(
                        "--checkpoint {word}: {planner} is not among the planners; add it to --planner"
                    )
                }
                Some((planner, file)) => (planner.to_owned(), file),
                None => (the_learned(flags, word)?, word.as_str()),
            };
            let file = absolute_path(file);
            let key = checkpoint_key(&planner);
            let table = nested(&key, file.clone().into());
            self.layers.push(("--checkpoint".to_owned(), table));
            self.config.learned.set(&planner, file);
            self.config.of_run.name(&key);
        }
        Ok(())
    }

    /// Every setting in the order of the file, optional ones at the end of their section.
    pub(super) fn list(&self) -> anyhow::Result<Vec<Setting>> {
        let mut table = Table::try_from(&self.config)?;
        // A configuration has this section only where it differs from its defaults.
        table.extend(agent_tables(&self.config.language_agents)?.parse::<Table>()?);
        Ok(keys()?
            .into_iter()
            .map(|key| {
                let set_by = self
                    .layers
                    .iter()
                    .rev()
                    .find(|(_, layer)| value_at(layer, &key).is_some());
                let origin = set_by.map_or("default", |(origin, _)| origin).to_owned();
                let value = value_at(&table, &key).cloned();
                Setting { key, value, origin }
            })
            .collect())
    }
}

/// Whether a planner needs a checkpoint.
fn is_learned(planner: &str) -> bool {
    all_planners()
        .learned()
        .any(|learned| learned.as_str() == planner)
}

/// The key of a learned planner's checkpoint.
fn checkpoint_key(planner: &str) -> String {
    format!("learned.{}", LearnedSettings::key(planner))
}

/// The one learned planner of a command, for the value of `--checkpoint` that names none.
fn the_learned(flags: &SimulateArguments, word: &str) -> anyhow::Result<String> {
    let mut planners = planner_words(&flags.planner);
    planners.retain(|planner| is_learned(planner));
    match <[String; 1]>::try_from(planners) {
        Ok([planner]) => Ok(planner),
        Err(planners) if planners.is_empty() => {
            bail!(
                "--checkpoint {word}: no learned planner is named; add --planner, for example --planner plantf"
            )
        }
        Err(planners) => {
            bail!(
                "--checkpoint {word}: {} are named; write --checkpoint PLANNER=FILE for each",
                planners.join(" and ")
            )
        }
    }
}

/// A trial of the model's files by this program.
fn trial() -> Trust {
    // Without a path of the program there is nothing to try with, and nobody vouches for the files.
    launched().map_or(Trust::Nobody, |launcher| trial_by(&launcher))
}

/// A trial of a model's files by what starts this program: a command and its first arguments.
pub fn trial_by(launcher: &[OsString]) -> Trust {
    let Some((program, first)) = launcher.split_first() else {
        return Trust::Nobody;
    };
    let words: Vec<&str> = first
        .iter()
        .filter_map(|word| word.to_str())
        .chain([TRIAL_PROCESS, "--threads", "1"])
        .collect();
    let samples = built_in_prompts().map(str::to_owned);
    Trust::Trial(Trial::by(program, &words, samples))
}

/// The settings before options: those of the file that `--config` names; without it, of the run
/// that is resumed, or of planagent.toml.
fn base(arguments: &Arguments) -> anyhow::Result<Settings> {
    let file = arguments.global.config.as_deref();
    let (config, layers) = match &arguments.command {
        Command::Simulate(SimulateArguments {
            resume: Some(folder),
            ..
        }) if file.is_none() => {
            let config = Config::of_run(folder)?;
            let table = Table::try_from(&config)?;
            (config, vec![(format!("run {}", folder.display()), table)])
        }
        // The parent process sends this one all that it needs.
        Command::BenchProcess(_) | Command::TrialProcess => (Config::default(), Vec::new()),
        _ => {
            let config = Config::load(file)?;
            let layers =
                match file.map_or_else(Config::default_file, |file| Some(PathBuf::from(file))) {
                    Some(path) => {
                        let text =
                            planagent_files::read_text(&path, planagent_files::MAX_SETTINGS_BYTES)
                                .with_context(|| format!("cannot read {}", path.display()))?;
                        vec![(path.display().to_string(), text.parse()?)]
                    }
                    None => Vec::new(),
                };
            (config, layers)
        }
    };
    Ok(Settings { config, layers })
}

/// The table of a value of `--set`.
fn parse(text: &str) -> anyhow::Result<Table> {
    let Some((key, value)) = text.split_once('=') else {
        bail!("--set {text}: expected KEY=VALUE, for example reflection.threshold=0.5");
    };
    let (key, value) = (key.trim(), value.trim());
    // Words need no quotes: what is no value of TOML is a text.
    let parsed = format!("value = {value}")
        .parse::<Table>()
        .ok()
        .and_then(|mut table| table.remove("value"));
    let table = nested(
        key,
        parsed.unwrap_or_else(|| Value::String(value.to_owned())),
    );
    if let Some(renamed) = RenamedSetting::all_in(&table).first() {
        bail!("--set {text}: {renamed}");
    }
    let known = keys()?;
    if !known.iter().any(|one| one == key) {
        let tip = match nearest(key, known.iter().map(String::as_str)) {
            Some(similar) => similar_exists("setting", similar),
            None => "`planagent config` lists all settings".to_owned(),
        };
        bail!("--set {text}: there is no setting '{key}'\n  tip: {tip}");
    }
    Ok(table)
}

/// The keys of all settings in the order of the file, optional ones at the end of their section.
pub(super) fn keys() -> anyhow::Result<Vec<String>> {
    let (mut keys, mut section) = (Vec::new(), String::new());
    // A table forgets the order of its keys; the text of the defaults has it.
    let defaults = Config::default();
    let agents = agent_tables(&defaults.language_agents)?;
    for line in toml::to_string(&defaults)?.lines().chain(agents.lines()) {
        if let Some(name) = line
            .strip_prefix('[')
            .and_then(|rest| rest.strip_suffix(']'))
        {
            section = format!("{name}.");
        } else if let Some((key, _)) = line.split_once(" = ") {
            keys.push(format!("{section}{key}"));
        }
    }
    let checkpoints = all_planners();
    let checkpoints = checkpoints
        .learned()
        .map(|planner| checkpoint_key(planner.as_str()));
    let remembering = language_agents().into_iter().filter(|keys| keys.has_memory);
    let memories = remembering.map(|keys| LanguageAgentSettings::memory_key(keys.planner));
    let optional = OPTIONAL.into_iter().map(str::to_owned);
    for optional in optional.chain(memories).chain(checkpoints) {
        let section = optional.rsplit_once('.').map_or("", |(section, _)| section);
        let is_of_section =
            |key: &String| key.rsplit_once('.').map_or("", |(own, _)| own) == section;
        let last = keys.iter().rposition(is_of_section);
        keys.insert(last.map_or(keys.len(), |place| place + 1), optional);
    }
    Ok(keys)
}

fn value_at<'a>(table: &'a Table, key: &str) -> Option<&'a Value> {
    match key.split_once('.') {
        Some((section, key)) => value_at(table.get(section)?.as_table()?, key),
        None => table.get(key),
    }
}

fn nested(key: &str, value: Value) -> Table {
    match key.split_once('.') {
        Some((section, key)) => {
            Table::from_iter([(section.to_owned(), Value::Table(nested(key, value)))])
        }
        None => Table::from_iter([(key.to_owned(), value)]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn a_text_needs_no_quotes() {
        let value = |text: &str| {
            value_at(
                &parse(text).unwrap(),
                text.split('=').next().unwrap().trim(),
            )
            .cloned()
            .unwrap()
        };
        assert_eq!(value("reflection.threshold=0.5"), Value::Float(0.5));
        assert_eq!(value("mllm.model = nano"), Value::String("nano".to_owned()));
        assert_eq!(
            value("mllm.model=\"nano\""),
            Value::String("nano".to_owned())
        );
        assert_eq!(value("seed=3"), Value::Integer(3));
        assert_eq!(
            value("reasoning.rounds=[\"code\"]"),
            Value::Array(vec!["code".into()])
        );
        assert!(parse("reflection={}").is_err() && parse("seed").is_err());
        let renamed = parse("reasoning.interval=5").unwrap_err().to_string();
        assert_eq!(
            renamed,
            "--set reasoning.interval=5: reasoning.interval is agent.interval_s now, in seconds; \
             write agent.interval_s = 0.5"
        );
    }

    #[test]
    fn the_keys_are_those_of_the_configuration_file() {
        let text =
            std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../../planagent.toml"))
                .unwrap();
        // Optional keys are shown as comments.
        let mut section = String::new();
        let mut shown = BTreeSet::new();
        for line in text.lines() {
            if let Some(name) = line.strip_prefix('[') {
                section = name.replace(']', ".");
            }
            let assignment = line.trim_start_matches("# ").split_once(" = ");
            let key = assignment
                .map(|(key, _)| key)
                .filter(|key| key.chars().all(|c| c.is_ascii_lowercase() || c == '_'));
            shown.extend(key.map(|key| format!("{section}{key}")));
        }
        assert_eq!(keys().unwrap().into_iter().collect::<BTreeSet<_>>(), shown);
    }
}
