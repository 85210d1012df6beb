//! `manifest.toml`: what a run is made of, written before its first drive.

use crate::scenario::MissingTokens;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Name of the file.
pub const MANIFEST: &str = "manifest.toml";

/// What a run is made of. Two runs with the same manifest, start apart, leave the same results.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// Version of the program.
    pub planagent: String,
    /// When the run was started: `YYYY.MM.DD.hh.mm.ss`, UTC, nuPlan's form.
    pub started: String,
    /// Planners in their order, by name.
    pub planners: Vec<String>,
    /// Challenges in their order, by nuPlan's names.
    pub challenges: Vec<String>,
    /// What is driven.
    pub scenarios: ScenarioList,
    /// The model, when one is needed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model: Option<toml::Table>,
    /// The resolved configuration, its seed included.
    pub config: toml::Table,
}

/// The scenarios of a run.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScenarioList {
    /// Words of the command line that name scenarios; paths are absolute.
    pub words: Vec<String>,
    /// Files of splits, absolute, or their names where no file holds them.
    pub splits: Vec<String>,
    /// Where nuPlan's logs lie; absolute.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub data_root: Option<PathBuf>,
    /// Where nuPlan's maps lie; absolute.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub maps_root: Option<PathBuf>,
    /// Only the first so many.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub limit: Option<usize>,
    /// How many there are.
    pub count: usize,
    /// BLAKE3 of their names in their order, a line each.
    pub blake3: String,
    /// Scenarios that the splits name and that are not there.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub missing: Vec<MissingTokens>,
}

impl ScenarioList {
    /// BLAKE3 of names, as [`ScenarioList::blake3`] has it.
    pub fn digest(names: impl IntoIterator<Item = impl AsRef<str>>) -> String {
        let mut hasher = blake3::Hasher::new();
        for name in names {
            hasher.update(name.as_ref().as_bytes()).update(b"\n");
        }
        hasher.finalize().to_hex().to_string()
    }
}

impl Manifest {
    /// How many drives the run has.
    pub fn simulations(&self) -> usize {
        self.scenarios.count * self.planners.len() * self.challenges.len()
    }

    /// What differs from `now`, a line each, by dotted keys; the time of the start, and the words and folders that the
    /// scenarios were found by, may differ.
    pub fn differences(&self, now: &Self) -> Vec<String> {
        let (then, now) = (self.flat(), now.flat());
        let text = |value: Option<&String>| value.map_or("none", String::as_str).to_owned();
        let mut keys: Vec<&String> = then.iter().map(|(key, _)| key).collect();
        keys.extend(now.iter().map(|(key, _)| key).filter(|key| !then.iter().any(|(k, _)| k == *key)));
        let value = |all: &[(String, String)], key: &str| text(all.iter().find(|(k, _)| k == key).map(|(_, v)| v));
        keys.into_iter()
            .map(|key| (key, value(&then, key), value(&now, key)))
            .filter(|(_, before, after)| before != after)
            .map(|(key, before, after)| format!("{key}: was {before}, is {after}"))
            .collect()
    }

    /// BLAKE3 of everything that must be the same for two runs to leave the same results.
    pub fn digest(&self) -> String {
        ScenarioList::digest(self.flat().into_iter().map(|(key, value)| format!("{key}={value}")))
    }

    /// Every value that must stay as it is, by its dotted key.
    fn flat(&self) -> Vec<(String, String)> {
        let mut all = vec![
            ("planagent".to_owned(), self.planagent.clone()),
            ("planners".to_owned(), self.planners.join(",")),
            ("challenges".to_owned(), self.challenges.join(",")),
            ("scenarios.count".to_owned(), self.scenarios.count.to_string()),
            ("scenarios.blake3".to_owned(), self.scenarios.blake3.clone()),
        ];
        for (section, table) in [("model", self.model.as_ref()), ("config", Some(&self.config))] {
            flatten(section, table.into_iter().flatten(), &mut all);
        }
        all
    }
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
    use super::*;

    fn manifest() -> Manifest {
        Manifest {
            planagent: "0.1.0".to_owned(),
            started: "2026.11.20.08.00.00".to_owned(),
            planners: vec!["idm".to_owned()],
            challenges: vec!["closed_loop_nonreactive_agents".to_owned()],
            scenarios: ScenarioList { count: 2, blake3: ScenarioList::digest(["a", "b"]), ..ScenarioList::default() },
            model: None,
            config: "seed = 0\n[reflection]\nthreshold = 0.75\n".parse().unwrap(),
        }
    }

    #[test]
    fn differences_name_their_keys() {
        let then = manifest();
        let mut now = manifest();
        now.started.clear();
        now.scenarios.words.push("b".to_owned());
        assert!(then.differences(&now).is_empty());
        now.config = "seed = 1\n[reflection]\nthreshold = 0.5\n".parse().unwrap();
        now.planners.push("log-replay".to_owned());
        now.model = Some("name = \"nano\"".parse().unwrap());
        let lines = then.differences(&now);
        assert_ne!(then.digest(), now.digest());
        assert_eq!(then.digest(), Manifest { started: "later".to_owned(), ..manifest() }.digest());
        assert_eq!(
            lines,
            [
                "planners: was idm, is idm,log-replay",
                "config.reflection.threshold: was 0.75, is 0.5",
                "config.seed: was 0, is 1",
                "model.name: was none, is \"nano\"",
            ]
        );
    }

    #[test]
    fn it_is_read_as_it_was_written() {
        let written = toml::to_string_pretty(&manifest()).unwrap();
        assert_eq!(toml::from_str::<Manifest>(&written).unwrap(), manifest());
        assert_ne!(ScenarioList::digest(["ab"]), ScenarioList::digest(["a", "b"]));
    }
}
