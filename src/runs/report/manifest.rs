//! `manifest.toml`: what a run consists of, written before its first simulation.

use super::file_names::name_parts;
use super::inputs::{AcceptedChanges, Inputs};
use super::recorded;
use super::renamed;
use super::stamp::Stamp;
use planagent_files::serde_path;
use planagent_scenario::MissingTokens;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// The format of run folders that this program reads and writes.
pub(crate) const FORMAT_VERSION: u32 = 2;

/// Key of the planners in [`Manifest::flat`], and the start of the keys of the model.
const PLANNERS: &str = "planners";
const MODEL_KEYS: &str = "model.";

/// What a run consists of. Runs with the same digest have equal results.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// Format of the run folder.
    pub format_version: u32,
    /// Version of what simulations compute.
    pub result_version: u32,
    /// Version of the program.
    pub planagent: String,
    /// Commit that the program was built from.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub commit: Option<String>,
    /// Start time in nuPlan's format: `YYYY.MM.DD.hh.mm.ss`, UTC.
    #[schemars(with = "String")]
    pub started: Stamp,
    /// Names of the planners, in order.
    #[serde(deserialize_with = "name_parts")]
    pub planners: Vec<String>,
    /// The commands of those planners that are commands, by name.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub commands: BTreeMap<String, String>,
    /// The command that controls the other agents, by the name of its policy.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub agents: BTreeMap<String, String>,
    /// Names of the challenges, in order: nuPlan's, or `closed_loop_own_agents_` and the name of a
    /// policy.
    pub challenges: Vec<String>,
    /// The scenarios.
    pub scenarios: ScenarioList,
    /// The model; none if no planner needs one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(with = "Option<Map<String, Value>>")]
    pub model: Option<toml::Table>,
    /// The prompts that the model is asked with; none if no planner needs one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub prompts: Option<PromptList>,
    /// The resolved configuration with its seed; settings have the names of now.
    #[serde(deserialize_with = "renamed::deserialize")]
    #[schemars(with = "Map<String, Value>")]
    pub config: toml::Table,
    /// Digests of what the run reads; none in runs of earlier versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub inputs: Option<Inputs>,
    /// Changes of the inputs that a user accepted.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub accepted: Vec<AcceptedChanges>,
}

/// The prompts of a run.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PromptList {
    /// Name of the set, or the folder that it was opened by.
    pub set: String,
    /// What names the set: `reasoning.prompt_set`, the model's description, planagent.json of the
    /// model, or default.
    pub named_by: String,
    /// Where the templates are: `built in`, or a folder.
    pub place: String,
    /// Whether all templates are those of the program.
    pub built_in: bool,
    /// BLAKE3 of the templates.
    pub blake3: String,
}

/// The scenarios of a run.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ScenarioList {
    /// The values of `--scenario`, with absolute paths.
    pub words: Vec<String>,
    /// Absolute paths of split files, or the names of built-in splits.
    pub splits: Vec<String>,
    /// Absolute path of nuPlan's logs.
    #[serde(default, skip_serializing_if = "Option::is_none", with = "serde_path")]
    #[schemars(with = "Option<PathBuf>")]
    pub data_root: Option<PathBuf>,
    /// Absolute path of nuPlan's maps.
    #[serde(default, skip_serializing_if = "Option::is_none", with = "serde_path")]
    #[schemars(with = "Option<PathBuf>")]
    pub maps_root: Option<PathBuf>,
    /// The values of `--type`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub types: Vec<String>,
    /// The value of `--shuffle`.
    #[serde(default, skip_serializing_if = "is_false")]
    pub shuffle: bool,
    /// The value of `--limit`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub limit: Option<usize>,
    /// The part of them that this run simulates; none for all.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shard: Option<ShardList>,
    /// Number of scenarios, those of other shards included.
    #[serde(deserialize_with = "recorded::count")]
    pub count: usize,
    /// BLAKE3 of their names, one a line, in order.
    pub blake3: String,
    /// Scenarios that a split names but no log holds.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub missing: Vec<MissingTokens>,
}

/// The scenarios of a shard.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ShardList {
    /// Which shard, from 1.
    #[serde(deserialize_with = "recorded::count")]
    pub index: usize,
    /// Number of shards.
    #[serde(deserialize_with = "recorded::count")]
    pub of: usize,
    /// Number of its scenarios.
    #[serde(deserialize_with = "recorded::count")]
    pub count: usize,
}

/// Lets serde omit a flag that most runs do not have.
#[allow(
    clippy::trivially_copy_pass_by_ref,
    reason = "serde passes a reference"
)]
fn is_false(flag: &bool) -> bool {
    !flag
}

impl ScenarioList {
    /// Number of scenarios that this run simulates.
    pub fn simulated(&self) -> usize {
        self.shard.map_or(self.count, |shard| shard.count)
    }

    /// The value of [`ScenarioList::blake3`] for these names.
    pub fn digest(names: impl IntoIterator<Item = impl AsRef<str>>) -> String {
        let mut hasher = blake3::Hasher::new();
        for name in names {
            hasher.update(name.as_ref().as_bytes()).update(b"\n");
        }
        hasher.finalize().to_hex().to_string()
    }
}

impl Manifest {
    /// Number of simulations of the run.
    pub fn simulations(&self) -> usize {
        self.scenarios
            .simulated()
            .saturating_mul(self.planners.len())
            .saturating_mul(self.challenges.len())
    }

    /// The differences from `now`, one a line, by dotted keys. Several keys that only one of both
    /// has share a line: another version wrote the run. The version and commit of the program, the
    /// start time, and the words and folders of the scenarios may differ.
    pub fn differences(&self, now: &Self) -> Vec<String> {
        let other_planners = self.planners != now.planners;
        let only_one_has_model = self.model.is_some() != now.model.is_some();
        let (then, now) = (self.flat(&self.config), now.flat(&now.config));
        let mut keys: Vec<&String> = then.iter().map(|(key, _)| key).collect();
        keys.extend(
            now.iter()
                .map(|(key, _)| key)
                .filter(|key| !then.iter().any(|(k, _)| k == *key)),
        );
        let different = keys
            .into_iter()
            // Other planners need another model or none: the line about the planners says it.
            .filter(|key| !(other_planners && only_one_has_model && key.starts_with(MODEL_KEYS)))
            .map(|key| (key, value_of(&then, key), value_of(&now, key)))
            .filter(|(_, before, after)| before != after);
        let (mut lines, mut new, mut gone) = (Vec::new(), Vec::new(), Vec::new());
        for (key, before, after) in different {
            let (then, now) = (before.unwrap_or("none"), after.unwrap_or("none"));
            let line = match key.as_str() {
                PLANNERS => format!("other planners: was {then}, is {now}"),
                key => format!("{key}: was {then}, is {now}"),
            };
            match (before, after) {
                (None, _) => new.push((key.as_str(), line)),
                (_, None) => gone.push((key.as_str(), line)),
                _ => lines.push(line),
            }
        }
        lines.extend(one_sided("the run does not have", new));
        lines.extend(one_sided("only the run has", gone));
        lines
    }

    /// The inputs that changed until `now`, one a line; none where they were not recorded.
    pub fn changed_inputs(&self, now: &Self) -> Vec<String> {
        self.inputs
            .as_ref()
            .zip(now.inputs.as_ref())
            .map_or_else(Vec::new, |(then, now)| then.changes(now))
    }

    /// The inputs in which another run differs that may have other recordings, one a line.
    pub(crate) fn conflicting_inputs(&self, other: &Self) -> Vec<String> {
        self.inputs
            .as_ref()
            .zip(other.inputs.as_ref())
            .map_or_else(Vec::new, |(own, other)| own.conflicts(other))
    }

    /// BLAKE3 of all settings. The inputs are compared file by file.
    pub fn digest(&self) -> String {
        ScenarioList::digest(
            self.flat(&renamed::with_names_of_before(&self.config))
                .into_iter()
                .map(|(key, value)| format!("{key}={value}")),
        )
    }

    /// Every value that determines the results, by its dotted key, with this configuration.
    fn flat(&self, config: &toml::Table) -> Vec<(String, String)> {
        let mut all = vec![
            ("result_version".to_owned(), self.result_version.to_string()),
            (PLANNERS.to_owned(), self.planners.join(",")),
            ("challenges".to_owned(), self.challenges.join(",")),
            (
                "scenarios.count".to_owned(),
                self.scenarios.count.to_string(),
            ),
            ("scenarios.blake3".to_owned(), self.scenarios.blake3.clone()),
        ];
        all.extend(
            self.commands
                .iter()
                .map(|(name, command)| (format!("commands.{name}"), command.clone())),
        );
        all.extend(
            self.agents
                .iter()
                .map(|(name, command)| (format!("agents.{name}"), command.clone())),
        );
        // The program's own prompts belong to its result version.
        let own_prompts = self.prompts.as_ref().filter(|prompts| !prompts.built_in);
        all.extend(
            own_prompts.map(|prompts| ("prompts.blake3".to_owned(), prompts.blake3.clone())),
        );
        let shard = self
            .scenarios
            .shard
            .map(|shard| format!("{}/{}", shard.index, shard.of));
        all.extend(shard.map(|shard| ("scenarios.shard".to_owned(), shard)));
        for (section, table) in [("model", self.model.as_ref()), ("config", Some(config))] {
            flatten(section, table.into_iter().flatten(), &mut all);
        }
        all
    }
}

/// The lines of keys that one side has; one line if they are many.
fn one_sided(who: &str, keys: Vec<(&str, String)>) -> Vec<String> {
    /// Maximum number of keys with a line each, and of those that the one line names.
    const NAMED: usize = 3;
    if keys.len() <= NAMED {
        return keys.into_iter().map(|(_, line)| line).collect();
    }
    let named: Vec<&str> = keys.iter().take(NAMED).map(|(key, _)| *key).collect();
    vec![format!(
        "{} settings that {who}: {} and {} more",
        keys.len(),
        named.join(", "),
        keys.len() - NAMED
    )]
}

/// The value of a key.
fn value_of<'a>(all: &'a [(String, String)], key: &str) -> Option<&'a str> {
    all.iter()
        .find(|(known, _)| known == key)
        .map(|(_, value)| value.as_str())
}

fn flatten<'a>(
    prefix: &str,
    entries: impl IntoIterator<Item = (&'a String, &'a toml::Value)>,
    all: &mut Vec<(String, String)>,
) {
    for (key, value) in entries {
        let key = format!("{prefix}.{key}");
        match value {
            toml::Value::Table(table) => flatten(&key, table, all),
            leaf => all.push((key, leaf.to_string())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::stamp::stamp;
    use super::*;

    fn manifest() -> Manifest {
        Manifest {
            format_version: FORMAT_VERSION,
            result_version: 1,
            commit: None,
            planagent: "0.1.0".to_owned(),
            started: stamp(std::time::UNIX_EPOCH),
            planners: vec!["idm".to_owned()],
            commands: BTreeMap::new(),
            agents: BTreeMap::new(),
            challenges: vec!["closed_loop_nonreactive_agents".to_owned()],
            scenarios: ScenarioList {
                count: 2,
                blake3: ScenarioList::digest(["a", "b"]),
                ..ScenarioList::default()
            },
            model: None,
            prompts: None,
            config: "seed = 0\n[reflection]\nthreshold = 0.75\n"
                .parse()
                .unwrap(),
            inputs: None,
            accepted: Vec::new(),
        }
    }

    #[test]
    fn a_wild_count_or_a_name_that_leads_elsewhere_is_refused() {
        let written = toml::to_string(&manifest()).unwrap();
        assert!(toml::from_str::<Manifest>(&written).is_ok());
        let count = format!("count = {}", manifest().scenarios.count);
        for (from, to, said) in [
            (count.as_str(), "count = 9223372036854775807", "count"),
            ("started = \"", "started = \"a/../", "start time"),
            ("planners = [\"", "planners = [\"../", "file name"),
        ] {
            let changed = written.replacen(from, to, 1);
            assert_ne!(changed, written, "{from}");
            let error = toml::from_str::<Manifest>(&changed)
                .unwrap_err()
                .to_string();
            assert!(error.contains(said), "{to}: {error}");
        }
        let wide = Manifest {
            planners: vec!["idm".to_owned(); 3],
            scenarios: ScenarioList {
                count: usize::MAX,
                ..ScenarioList::default()
            },
            ..manifest()
        };
        assert_eq!(wide.simulations(), usize::MAX);
    }

    #[test]
    fn differences_name_their_keys() {
        let then = manifest();
        let mut now = manifest();
        now.started = stamp(std::time::SystemTime::now());
        now.scenarios.words.push("b".to_owned());
        assert!(then.differences(&now).is_empty());
        now.config = "seed = 1\n[reflection]\nthreshold = 0.5\n".parse().unwrap();
        now.planners.push("log-replay".to_owned());
        now.model = Some("name = \"nano\"".parse().unwrap());
        let lines = then.differences(&now);
        assert_ne!(then.digest(), now.digest());
        assert_eq!(
            then.digest(),
            Manifest {
                started: stamp(std::time::SystemTime::now()),
                ..manifest()
            }
            .digest()
        );
        assert_eq!(
            lines,
            [
                "other planners: was idm, is idm,log-replay",
                "config.reflection.threshold: was 0.75, is 0.5",
                "config.seed: was 0, is 1",
            ]
        );
        now.planners.pop();
        assert_eq!(
            then.differences(&now).last().unwrap(),
            "model.name: was none, is \"nano\""
        );
        now.scenarios.shard = Some(ShardList {
            index: 1,
            of: 2,
            count: 1,
        });
        assert!(
            then.differences(&now)
                .contains(&"scenarios.shard: was none, is 1/2".to_owned())
        );
        assert_eq!((then.simulations(), now.simulations()), (2, 1));
        let prompts = |built_in| PromptList {
            set: "compact".to_owned(),
            named_by: "default".to_owned(),
            place: "prompts/compact".to_owned(),
            built_in,
            blake3: "ab".to_owned(),
        };
        let with = |built_in| Manifest {
            prompts: Some(prompts(built_in)),
            ..manifest()
        };
        assert_eq!(with(true).digest(), manifest().digest());
        assert_eq!(
            manifest().differences(&with(false)),
            ["prompts.blake3: was none, is ab"]
        );
        // A run of a version with fewer settings.
        let mut older = manifest();
        older.config = "seed = 0\n".parse().unwrap();
        let mut newer = manifest();
        newer.config = "seed = 1\n[reflection]\na = 1\nb = 2\nc = 3\nd = 4\n"
            .parse()
            .unwrap();
        let new = "4 settings that the run does not have: config.reflection.a, config.reflection.b, config.reflection.c and 1 more";
        assert_eq!(older.differences(&newer), ["config.seed: was 0, is 1", new]);
        assert!(
            newer.differences(&older)[1]
                .starts_with("4 settings that only the run has: config.reflection.a")
        );
    }

    #[test]
    fn a_run_with_settings_of_before_is_the_same_run() {
        let mut now = manifest();
        now.config = "agent = { interval_s = 3.0, blocked_interval_s = 0.5 }\n\
            reasoning = { grammar = true }"
            .parse()
            .unwrap();
        let mut written = toml::Table::try_from(&now).unwrap();
        let before =
            "agent = {}\nreasoning = { interval = 30, blocked_interval = 5, grammar = true }";
        let before: toml::Table = before.parse().unwrap();
        written.insert("config".to_owned(), before.into());
        let before: Manifest = written.try_into().unwrap();
        assert_eq!(before, now);
        assert!(before.differences(&now).is_empty());
        // Folders of study runs have this digest in their names.
        let lines = [
            "result_version=1",
            "planners=idm",
            "challenges=closed_loop_nonreactive_agents",
            "scenarios.count=2",
            &format!("scenarios.blake3={}", now.scenarios.blake3),
            "config.reasoning.blocked_interval=5",
            "config.reasoning.grammar=true",
            "config.reasoning.interval=30",
        ];
        assert_eq!(now.digest(), ScenarioList::digest(lines));
    }

    #[test]
    fn a_manifest_survives_a_round_trip() {
        let written = toml::to_string_pretty(&manifest()).unwrap();
        assert_eq!(toml::from_str::<Manifest>(&written).unwrap(), manifest());
        assert_ne!(
            ScenarioList::digest(["ab"]),
            ScenarioList::digest(["a", "b"])
        );
    }
}
