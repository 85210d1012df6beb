//! Section `language_agents` in files. A file may leave out keys; a manifest has every key of every
//! agent where one differs from its default.

use planagent_agent::planner::{AgentKeys, AgentSettings, LanguageAgentSettings};
use planagent_planners::all_planners;
use serde::de::Error;
use serde::ser::SerializeMap;
use serde::{Deserialize, Deserializer, Serializer};
use std::collections::BTreeMap;

/// The agents in the order of the registry.
pub fn language_agents() -> Vec<AgentKeys> {
    all_planners().language_agents().collect()
}

/// Whether every setting has its default.
pub(super) fn is_default(settings: &LanguageAgentSettings) -> bool {
    settings.set().is_empty()
        || language_agents()
            .iter()
            .all(|keys| settings.agent(keys.planner).changes(keys) == AgentSettings::default())
}

/// Writes every key that has a value.
pub(super) fn serialize<S: Serializer>(
    settings: &LanguageAgentSettings,
    serializer: S,
) -> Result<S::Ok, S::Error> {
    let agents = language_agents();
    let mut tables = serializer.serialize_map(Some(agents.len()))?;
    for keys in &agents {
        let whole = settings.agent(keys.planner).whole(keys);
        tables.serialize_entry(&LanguageAgentSettings::key(keys.planner), &whole)?;
    }
    tables.end()
}

/// Reads what differs from the defaults; refuses agents and settings that there are not.
pub(super) fn deserialize<'de, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<LanguageAgentSettings, D::Error> {
    let tables = BTreeMap::<String, AgentSettings>::deserialize(deserializer)?;
    let agents = language_agents();
    // serde cannot derive this: the agents are those of a registry.
    let of_agent = |(key, set): (String, AgentSettings)| {
        let is_own = |keys: &&AgentKeys| LanguageAgentSettings::key(keys.planner) == key;
        let Some(keys) = agents.iter().find(is_own) else {
            let known = agents
                .iter()
                .map(|keys| format!("`{}`", LanguageAgentSettings::key(keys.planner)));
            let known = known.collect::<Vec<_>>().join(", ");
            return Err(D::Error::custom(format!(
                "unknown field `{key}`, expected one of {known}"
            )));
        };
        if let Some(foreign) = set.foreign(keys) {
            return Err(D::Error::custom(format!(
                "unknown field `{foreign}` in `language_agents.{key}`"
            )));
        }
        Ok((key, set.changes(keys)))
    };
    let read = tables.into_iter().map(of_agent);
    let changed = |(_, set): &(String, AgentSettings)| *set != AgentSettings::default();
    Ok(read
        .collect::<Result<Vec<_>, _>>()?
        .into_iter()
        .filter(changed)
        .collect())
}

/// The text of the section's tables, every key with a value, in the order of the registry.
///
/// # Errors
/// When a value cannot be written as TOML.
pub fn agent_tables(settings: &LanguageAgentSettings) -> Result<String, toml::ser::Error> {
    language_agents()
        .iter()
        .map(|keys| {
            let whole = settings.agent(keys.planner).whole(keys);
            let key = LanguageAgentSettings::key(keys.planner);
            Ok(format!(
                "[language_agents.{key}]\n{}",
                toml::to_string(&whole)?
            ))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use crate::runner::Config;

    fn read(text: &str) -> Result<Config, toml::de::Error> {
        toml::from_str(text)
    }

    #[test]
    fn a_changed_agent_is_written_with_every_key_of_every_agent() {
        let config = read("[language_agents.dilu]\nexamples = 1\ninterval_s = 1.0\n").unwrap();
        let text = toml::to_string(&config).unwrap();
        for line in [
            "[language_agents.gpt_driver]\ninterval_s = 1.0\nmax_tokens = 256\nreflection = false\n",
            "[language_agents.dilu]\ninterval_s = 1.0\nmax_tokens = 320\nexamples = 1\nreflection = false\n",
            "[language_agents.agent_driver]\ninterval_s = 2.0\nmax_tokens = 256\n",
        ] {
            assert!(text.contains(line), "{text}");
        }
        assert_eq!(read(&text).unwrap(), config);
    }

    #[test]
    fn defaults_that_a_file_names_are_no_change() {
        let config = read("[language_agents.gpt_driver]\nmax_tokens = 256\n").unwrap();
        assert_eq!(config, Config::default());
        let text = toml::to_string(&config).unwrap();
        assert!(!text.contains("language_agents"), "{text}");
    }

    #[test]
    fn agents_and_settings_that_there_are_not_are_refused() {
        for (text, why) in [
            (
                "[language_agents.driver]\n",
                "unknown field `driver`, expected one of `gpt_driver`, `dilu`",
            ),
            (
                "[language_agents.gpt_driver]\nmemory = 'a'\n",
                "unknown field `memory` in `language_agents.gpt_driver`",
            ),
            (
                "[language_agents.agent_driver]\nexamples = 1\n",
                "unknown field `examples`",
            ),
            (
                "[language_agents.dilu]\nreflection = 'yes'\n",
                "invalid type",
            ),
            (
                "[language_agents.dilu]\nsteps = 1\n",
                "unknown field `steps`",
            ),
            ("[language_agents.dilu]\nexamples = -1\n", "invalid value"),
        ] {
            let error = read(text).unwrap_err().to_string();
            assert!(error.contains(why), "{text}: {error}");
        }
    }
}
