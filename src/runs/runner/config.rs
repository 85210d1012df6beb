//! The configuration of a run.

use super::agent_tables;
use super::of_run::OfRun;
use super::tables::{collect_changes, leaves, line_of, overlay};
use crate::report::RenamedSetting;
use planagent_agent::environment::BevView;
use planagent_agent::environment::lane_graph::{MAX_NODE_LENGTH, MIN_NODE_LENGTH};
use planagent_agent::planner::{
    CallSettings, EnvironmentSettings, LanguageAgentSettings, LearnedSettings, PlanAgentSettings,
    ReflectionSettings,
};
use planagent_agent::reasoning::{PromptSet, ReasoningConfig, Round};
use planagent_mllm::{AdapterSpec, Trust, WeightFormat};
use planagent_planners::all_planners;
use planagent_world::STEP_S;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Longest time between two planning calls, seconds.
const MAX_INTERVAL_S: f64 = 100.0;

/// The configuration, in the sections of its file. `planagent.toml` at the root of the project has
/// every key with its default.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// Seed of all random numbers.
    pub seed: u64,
    /// The model.
    pub mllm: MllmConfig,
    /// A planning call as a whole.
    pub agent: CallSettings,
    /// Inputs of the model.
    pub environment: EnvironmentSettings,
    /// Rounds and prompts of the model.
    pub reasoning: ReasoningConfig,
    /// How plans are scored and executed.
    pub reflection: ReflectionSettings,
    /// Checkpoints of learned planners.
    #[serde(skip_serializing_if = "LearnedSettings::is_empty")]
    pub learned: LearnedSettings,
    /// The other language agents of the paper's comparison.
    #[serde(
        with = "agent_tables",
        skip_serializing_if = "agent_tables::is_default"
    )]
    pub language_agents: LanguageAgentSettings,
    /// What the folder of a run decides alone, for a configuration that comes from one. No file
    /// sets it.
    #[serde(skip)]
    pub of_run: OfRun,
}

/// Section `mllm`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MllmConfig {
    /// Name of a `models/NAME.toml` or the path of such a file, a folder in Hugging Face's layout,
    /// a GGUF file, or a hub id `org/name` (`org/name/file.gguf`).
    pub model: String,
    /// Do not use the network: a hub id must be in the cache, a server on this machine.
    pub offline: bool,
    /// What is merged into the weights: the path of an adapter, or a table with `path` and
    /// `changed_base`. `None` for that of the description.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub adapter: Option<AdapterSpec>,
    /// Weight format in memory; `None` for that of the description or the files.
    #[serde(
        skip_serializing_if = "Option::is_none",
        deserialize_with = "WeightFormat::choice"
    )]
    pub quantize: Option<WeightFormat>,
    /// Longest chat, tokens: prompts, image and answers. It bounds the memory of keys and values.
    /// `None` for that of the model.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub context: Option<usize>,
    /// Load a model even if it seems to need more memory than is free.
    pub ignore_memory: bool,
    /// Why the chat template and the tokenizer of a model may be opened. No file sets it.
    #[serde(skip)]
    pub trust: Trust,
}

impl Default for MllmConfig {
    fn default() -> Self {
        Self {
            model: "nano".to_owned(),
            offline: false,
            adapter: None,
            quantize: None,
            context: None,
            ignore_memory: false,
            trust: Trust::default(),
        }
    }
}

/// Why a configuration cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs, reason = "the message of a variant says what it is")]
pub enum ConfigError {
    #[error("cannot read the configuration {}: {source}", path.display())]
    Read {
        path: PathBuf,
        source: std::io::Error,
    },
    #[error("in the configuration {place}: {source}")]
    Parse {
        place: String,
        source: Box<toml::de::Error>,
    },
    #[error("in the configuration {place}: {fault}")]
    Value { place: String, fault: String },
    #[error(
        "in the configuration {place}{}: learned.{key} is the key of no learned planner; known keys are {known}",
        line.map_or_else(String::new, |line| format!(", line {line}"))
    )]
    Learned {
        place: String,
        line: Option<usize>,
        key: String,
        known: String,
    },
    #[error("cannot serialize the configuration")]
    Serialize(#[from] toml::ser::Error),
}

impl Config {
    /// The settings that differ from the defaults, sorted by their dotted keys.
    ///
    /// # Errors
    /// When the configuration cannot be serialized.
    pub fn changes(&self) -> Result<Vec<(String, toml::Value)>, toml::ser::Error> {
        let mut changes = Vec::new();
        collect_changes(
            "",
            &toml::Table::try_from(self)?,
            &toml::Table::try_from(Self::default())?,
            &mut changes,
        );
        Ok(changes)
    }

    /// Reads a file. `None` reads `planagent.toml` in the working directory; without that file the
    /// defaults apply.
    pub fn load(path: Option<&Path>) -> Result<Self, ConfigError> {
        let found: Option<PathBuf> = match path {
            Some(path) => Some(path.to_owned()),
            None => Self::default_file(),
        };
        let Some(path) = found else {
            return Ok(Self::default());
        };
        let place = path.display().to_string();
        let text = planagent_files::read_text(&path, planagent_files::MAX_SETTINGS_BYTES)
            .map_err(|source| ConfigError::Read { path, source })?;
        // Old names first: serde would only say that a field is unknown, not what replaced it.
        if let Ok(settings) = text.parse::<toml::Table>() {
            check_names(&settings, |old| line_of(&text, old.section, old.name)).map_err(
                |fault| ConfigError::Value {
                    place: place.clone(),
                    fault,
                },
            )?;
        }
        let parsed = toml::from_str::<Self>(&text);
        let config = parsed.map_err(|source| ConfigError::Parse {
            place: place.clone(),
            source: Box::new(source),
        })?;
        match config.unknown_learned() {
            Some(unknown) => Err(ConfigError::Learned {
                line: line_of(&text, "learned", &unknown),
                place,
                known: known_learned(),
                key: unknown,
            }),
            None => config.checked(place),
        }
    }

    /// A key of `learned` that is no planner's.
    fn unknown_learned(&self) -> Option<String> {
        let registry = all_planners();
        let known: BTreeSet<String> = registry
            .learned()
            .map(|planner| LearnedSettings::key(planner.as_str()))
            .collect();
        let unknown = self.learned.keys().find(|key| !known.contains(*key));
        unknown.map(str::to_owned)
    }

    /// This configuration with some keys replaced.
    pub fn overlaid(&self, settings: &toml::Table) -> Result<Self, ConfigError> {
        self.overlaid_at(settings, &format!("settings {settings}"))
    }

    /// The same; errors say that the keys come from `place`.
    pub fn overlaid_at(&self, settings: &toml::Table, place: &str) -> Result<Self, ConfigError> {
        let place = || place.to_owned();
        let parse_error = |source| ConfigError::Parse {
            place: place(),
            source: Box::new(source),
        };
        check_names(settings, |_| None).map_err(|fault| ConfigError::Value {
            place: place(),
            fault,
        })?;
        let mut table = toml::Table::try_from(self)?;
        overlay(&mut table, settings.clone());
        let mut config = table.try_into::<Self>().map_err(parse_error)?;
        config.mllm.trust = self.mllm.trust.clone();
        config.of_run = self.of_run.clone();
        leaves("", settings, &mut |key| config.of_run.name(key));
        config.checked(place())
    }

    /// Vouches for the chat template and the tokenizer of the model, as `AgentBuilder::trust_model`
    /// does.
    #[must_use]
    pub fn trust_model(mut self) -> Self {
        self.mllm.trust = Trust::Caller;
        self
    }

    /// The file that is read if none is named: `planagent.toml` in the working directory, if it
    /// exists.
    pub fn default_file() -> Option<PathBuf> {
        Some(PathBuf::from("planagent.toml")).filter(|default| default.is_file())
    }

    pub(super) fn checked(self, place: String) -> Result<Self, ConfigError> {
        if let Some(key) = self.unknown_learned() {
            return Err(ConfigError::Learned {
                place,
                line: None,
                key,
                known: known_learned(),
            });
        }
        match self.check() {
            Ok(()) => Ok(self),
            Err(fault) => Err(ConfigError::Value { place, fault }),
        }
    }

    /// The settings of agents, apart from the model.
    pub fn agent_settings(&self) -> PlanAgentSettings {
        PlanAgentSettings {
            agent: self.agent.clone(),
            environment: EnvironmentSettings {
                oncoming_lane: self.names_oncoming_lane(),
                ..self.environment.clone()
            },
            reflection: self.reflection.clone(),
            learned: self.learned.clone(),
            language_agents: self.language_agents.clone(),
            seed: self.seed,
        }
    }

    /// Whether codes may name the oncoming lane: as the key says, else as the prompt set that is
    /// named. `None` leaves it to the prompt set of the model.
    fn names_oncoming_lane(&self) -> Option<bool> {
        let set = || PromptSet::open(self.reasoning.prompt_set.as_deref()?).ok();
        self.environment
            .oncoming_lane
            .or_else(|| Some(set()?.forms().scene_text.names_oncoming_lane()))
    }

    /// Refuses intervals and limits of the other language agents that make no sense.
    fn check_language_agents(&self) -> Result<(), String> {
        for (agent, set) in self.language_agents.set() {
            let key = |key: &str| format!("language_agents.{agent}.{key}");
            // Defaults make sense.
            let interval_s = set.interval_s.unwrap_or(STEP_S);
            if !(STEP_S..=MAX_INTERVAL_S).contains(&interval_s) {
                return Err(format!(
                    "{} is {:e}; it must lie in {STEP_S} to {MAX_INTERVAL_S}",
                    key("interval_s"),
                    interval_s
                ));
            }
            check_whole_iterations(&key("interval_s"), interval_s)?;
            if set.max_tokens == Some(0) {
                return Err(format!("{} is 0; it must be at least 1", key("max_tokens")));
            }
        }
        Ok(())
    }

    /// Refuses values of the right type that make no sense; names the key, its value and its range.
    fn check(&self) -> Result<(), String> {
        // serde checks types alone: a value of another unit is found here.
        let within = |key: &str, value: f64, range: std::ops::RangeInclusive<f64>| {
            if range.contains(&value) {
                return Ok(());
            }
            Err(format!(
                "{key} is {value:e}; it must lie in {} to {}",
                range.start(),
                range.end()
            ))
        };
        let Self {
            environment,
            reasoning,
            reflection,
            ..
        } = self;
        if self.agent.deadline_ms == Some(0) {
            return Err(
                "agent.deadline_ms is 0; it must be at least 1, or absent for no deadline"
                    .to_owned(),
            );
        }
        if self.mllm.context == Some(0) {
            return Err(
                "mllm.context is 0; it must be at least 1, or absent for the context of the model"
                    .to_owned(),
            );
        }
        self.check_language_agents()?;
        for (key, value) in [
            ("agent.interval_s", self.agent.interval_s),
            ("agent.blocked_interval_s", self.agent.blocked_interval_s),
        ] {
            within(key, value, STEP_S..=MAX_INTERVAL_S)?;
            check_whole_iterations(key, value)?;
        }
        within("agent.gate", self.agent.gate.unwrap_or(0.0), 0.0..=1.0)?;
        within(
            "environment.view_m",
            environment.view_m,
            BevView::MIN_METERS..=BevView::MAX_METERS,
        )?;
        within(
            "environment.node_length_m",
            environment.node_length_m,
            MIN_NODE_LENGTH..=MAX_NODE_LENGTH,
        )?;
        within("reflection.horizon_s", reflection.horizon_s, 1.0..=8.0)?;
        within("reflection.threshold", reflection.threshold, 0.0..=1.0)?;
        within(
            "reflection.lane_change_threshold",
            reflection.lane_change_threshold,
            0.0..=1.0,
        )?;
        within(
            "reflection.max_exec",
            reflection.max_exec as f64,
            1.0..=100.0,
        )?;
        within(
            "reasoning.rethink_temperature",
            reasoning.rethink_temperature,
            0.0..=10.0,
        )?;
        if self.reasoning.rounds.last() != Some(&Round::Code)
            || !self.reasoning.rounds.is_sorted_by(|a, b| a < b)
        {
            let rule =
                "must be some of understanding, instruction, code, in this order, ending with code";
            return Err(format!("reasoning.rounds {rule}"));
        }
        Ok(())
    }
}

/// The keys of section `learned`, in the order of the registry.
fn known_learned() -> String {
    let keys: Vec<String> = all_planners()
        .learned()
        .map(|planner| LearnedSettings::key(planner.as_str()))
        .collect();
    if keys.is_empty() {
        return "none, as this program was built without learned planners".to_owned();
    }
    keys.join(", ")
}

/// Refuses a duration that is no whole number of iterations: a planning call is made at one.
fn check_whole_iterations(key: &str, value_s: f64) -> Result<(), String> {
    /// Iterations that a decimal fraction may be off as a binary number.
    const ROUNDING: f64 = 1e-6;
    let iterations = value_s / STEP_S;
    if (iterations - iterations.round()).abs() < ROUNDING {
        return Ok(());
    }
    let [below, above] = [iterations.floor(), iterations.ceil()].map(|n| n * STEP_S);
    Err(format!(
        "{key} is {value_s} s; it must be a multiple of {STEP_S} s, the time between two iterations, \
         for example {below:.1} or {above:.1}"
    ))
}

/// Refuses settings by names that they no longer have; `line_of` knows the line of a key.
fn check_names(
    settings: &toml::Table,
    line_of: impl Fn(&RenamedSetting) -> Option<usize>,
) -> Result<(), String> {
    let faults: Vec<String> = RenamedSetting::all_in(settings)
        .iter()
        .map(|setting| match line_of(setting) {
            Some(line) => format!("line {line}: {setting}"),
            None => setting.to_string(),
        })
        .collect();
    if faults.is_empty() {
        Ok(())
    } else {
        Err(faults.join("; "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use planagent_agent::reflection::steps_of;

    #[test]
    fn settings_are_laid_over_and_checked() {
        let base = Config {
            seed: 7,
            ..Config::default()
        };
        let overlaid = |settings: &str| base.overlaid(&settings.parse().unwrap());
        assert_eq!(overlaid("").unwrap(), base);
        let other = overlaid("environment.bev = false\nreflection = { max_exec = 1 }").unwrap();
        assert!(!other.environment.bev && other.environment.lane_graph);
        assert_eq!((other.seed, other.reflection.max_exec), (7, 1));
        for wrong in [
            "environment.bov = false",
            "agent.interval_s = 'often'",
            "agent.interval_s = 0",
            "agent.interval_s = nan",
            "agent.blocked_interval_s = 100.1",
        ] {
            assert!(overlaid(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_checkpoint_belongs_to_a_planner_of_the_registry() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("own.toml");
        let load = |text: &str| {
            std::fs::write(&file, text).unwrap();
            Config::load(Some(&file))
        };
        let text = "seed = 1\n\n[learned]\nplantf = 'a.ckpt'\nplan_tf = 'b.ckpt'\n";
        let error = load(text).unwrap_err().to_string();
        let place = format!(
            "{}, line 5: learned.plan_tf is the key of no",
            file.display()
        );
        assert!(error.contains(&place), "{error}");
        assert!(
            error.contains("known keys are pdm_open, pdm_hybrid, plantf"),
            "{error}"
        );
        let overlay = "learned.pdm-open = 'a.ckpt'".parse().unwrap();
        let error = Config::default()
            .overlaid(&overlay)
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("learned.pdm-open is the key of no"),
            "{error}"
        );
        for planner in all_planners().learned() {
            let key = LearnedSettings::key(planner.as_str());
            let config = load(&format!("[learned]\n{key} = 'a.ckpt'")).unwrap();
            assert_eq!(config.learned.checkpoint(planner.as_str()), Some("a.ckpt"));
        }
    }

    #[test]
    fn intervals_are_whole_numbers_of_iterations() {
        let set = |value: &str| {
            let settings = format!("agent.interval_s = {value}");
            Config::default().overlaid(&settings.parse().unwrap())
        };
        for iterations in 1..=1000 {
            let value = format!("{}.{}", iterations / 10, iterations % 10);
            let config = set(&value).unwrap();
            assert_eq!(steps_of(config.agent.interval_s), iterations, "{value}");
        }
        assert_eq!(steps_of(set("3").unwrap().agent.interval_s), 30);
        let refused = |value: &str| set(value).unwrap_err().to_string();
        let text = refused("0.55");
        assert!(
            text.contains("agent.interval_s is 0.55 s")
                && text.contains("multiple of 0.1 s")
                && text.contains("0.5 or 0.6"),
            "{text}"
        );
        for value in ["0.05", "2.001", "0.1001"] {
            refused(value);
        }
    }

    #[test]
    fn an_old_name_is_refused_with_the_new_one_its_value_and_its_line() {
        let text = "seed = 1\n[reasoning]\n# Two seconds.\ninterval = 20\nblocked_interval = 5\n";
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("planagent.toml");
        std::fs::write(&file, text).unwrap();
        let of_file = Config::load(Some(&file)).unwrap_err().to_string();
        for part in [
            "planagent.toml: line 4: reasoning.interval is agent.interval_s now",
            "write agent.interval_s = 2.0;",
            "line 5: reasoning.blocked_interval",
            "write agent.blocked_interval_s = 0.5",
        ] {
            assert!(of_file.contains(part), "{part} in: {of_file}");
        }
        let overlaid = Config::default().overlaid(&text.parse().unwrap());
        let overlaid = overlaid.unwrap_err().to_string();
        assert!(
            overlaid.contains("write agent.interval_s = 2.0"),
            "{overlaid}"
        );
    }

    #[test]
    fn changes_make_the_configuration_again() {
        assert_eq!(Config::default().changes().unwrap(), []);
        let settings = "seed = 3\n[environment]\nbev = false\n[mllm]\nquantize = 'q8_0'\n[learned]\nplantf = 'a.ckpt'";
        let changed = Config::default()
            .overlaid(&settings.parse().unwrap())
            .unwrap();
        let changes = changed.changes().unwrap();
        let keys: Vec<&str> = changes.iter().map(|(key, _)| key.as_str()).collect();
        assert_eq!(
            keys,
            ["environment.bev", "learned.plantf", "mllm.quantize", "seed"]
        );
        let lines: Vec<String> = changes
            .iter()
            .map(|(key, value)| format!("{key} = {value}"))
            .collect();
        assert_eq!(
            Config::default()
                .overlaid(&lines.join("\n").parse().unwrap())
                .unwrap(),
            changed
        );
    }
}
