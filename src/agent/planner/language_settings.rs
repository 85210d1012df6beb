//! Section `language_agents`: the other language agents of the paper's comparison. Which agents there
//! are, the registry knows; an agent declares its settings beside its code.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The section, as the prefix of its keys.
const SECTION: &str = "language_agents";

/// The settings that an agent has, with their defaults.
#[doc(hidden)]
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AgentKeys {
    /// Its name as a planner; its key has `_` for `-`.
    pub planner: &'static str,
    /// Time between planning calls, seconds.
    pub interval_s: f64,
    /// Maximum tokens of an answer.
    pub max_tokens: usize,
    /// Remembered items in a prompt, for an agent that lets users choose.
    pub examples: Option<usize>,
    /// Whether it reads a memory.
    pub has_memory: bool,
}

/// The settings of one agent that are set; the others have the agent's defaults.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AgentSettings {
    /// Time between planning calls, seconds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub interval_s: Option<f64>,
    /// Maximum tokens of an answer.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_tokens: Option<usize>,
    /// Remembered items in a prompt.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub examples: Option<usize>,
    /// Whether Reflection scores the plans, and the model is asked again for what it refuses. The
    /// originals have no such step.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reflection: Option<bool>,
    /// The file of the memory.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub memory: Option<String>,
}

impl AgentSettings {
    /// A setting that the agent does not have.
    #[doc(hidden)]
    pub fn foreign(&self, keys: &AgentKeys) -> Option<&'static str> {
        if self.examples.is_some() && keys.examples.is_none() {
            Some("examples")
        } else if self.memory.is_some() && !keys.has_memory {
            Some("memory")
        } else {
            None
        }
    }

    /// The same with every setting that has a default.
    #[doc(hidden)]
    #[must_use]
    pub fn whole(&self, keys: &AgentKeys) -> Self {
        Self {
            interval_s: self.interval_s.or(Some(keys.interval_s)),
            max_tokens: self.max_tokens.or(Some(keys.max_tokens)),
            examples: self.examples.or(keys.examples),
            reflection: Some(self.reflects()),
            memory: self.memory.clone(),
        }
    }

    /// The same without what is set to its default.
    #[doc(hidden)]
    #[must_use]
    pub fn changes(self, keys: &AgentKeys) -> Self {
        Self {
            interval_s: self
                .interval_s
                .filter(|set| set.total_cmp(&keys.interval_s).is_ne()),
            max_tokens: self.max_tokens.filter(|set| *set != keys.max_tokens),
            examples: self.examples.filter(|set| Some(*set) != keys.examples),
            reflection: self.reflection.filter(|set| *set),
            memory: self.memory,
        }
    }

    /// Time between planning calls, seconds.
    #[doc(hidden)]
    pub fn interval_s(&self, keys: &AgentKeys) -> f64 {
        self.interval_s.unwrap_or(keys.interval_s)
    }

    /// Maximum tokens of an answer.
    #[doc(hidden)]
    pub fn max_tokens(&self, keys: &AgentKeys) -> usize {
        self.max_tokens.unwrap_or(keys.max_tokens)
    }

    /// Remembered items in a prompt; 0 where users do not choose their number.
    #[doc(hidden)]
    pub fn examples(&self, keys: &AgentKeys) -> usize {
        self.examples.or(keys.examples).unwrap_or(0)
    }

    /// Whether Reflection scores the plans.
    #[doc(hidden)]
    pub fn reflects(&self) -> bool {
        self.reflection.unwrap_or(false)
    }
}

/// Settings of the agents by their keys.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct LanguageAgentSettings(BTreeMap<String, AgentSettings>);

impl LanguageAgentSettings {
    /// The key of an agent, by its name as a planner.
    pub fn key(planner: &str) -> String {
        planner.replace('-', "_")
    }

    /// What is set for an agent, by its name as a planner.
    pub fn agent(&self, planner: &str) -> AgentSettings {
        self.0.get(&Self::key(planner)).cloned().unwrap_or_default()
    }

    /// The same, to set more.
    pub fn agent_mut(&mut self, planner: &str) -> &mut AgentSettings {
        self.0.entry(Self::key(planner)).or_default()
    }

    /// The memories that are set: key, planner and file.
    #[doc(hidden)]
    pub fn memories(&self) -> impl Iterator<Item = (String, String, &str)> {
        self.0.iter().filter_map(|(agent, set)| {
            let file = set.memory.as_deref()?;
            let key = Self::memory_key(agent);
            Some((key, agent.replace('_', "-"), file))
        })
    }

    /// The key of an agent's memory, by the agent's name or key.
    #[doc(hidden)]
    pub fn memory_key(agent: &str) -> String {
        format!("{SECTION}.{}.memory", Self::key(agent))
    }

    /// The files of all memories.
    #[doc(hidden)]
    pub fn memories_mut(&mut self) -> impl Iterator<Item = &mut String> {
        self.0.values_mut().filter_map(|set| set.memory.as_mut())
    }

    /// The same without memories.
    #[doc(hidden)]
    #[must_use]
    pub fn without_memories(mut self) -> Self {
        self.0.values_mut().for_each(|set| set.memory = None);
        self
    }

    /// Those of one planner alone, by the planner's name; of another planner, the defaults.
    #[doc(hidden)]
    #[must_use]
    pub fn only(mut self, planner: &str) -> Self {
        let own = Self::key(planner.strip_prefix("oracle-").unwrap_or(planner));
        self.0.retain(|agent, _| *agent == own);
        self
    }

    /// What is set, by the agents' keys.
    #[doc(hidden)]
    pub fn set(&self) -> &BTreeMap<String, AgentSettings> {
        &self.0
    }
}

impl FromIterator<(String, AgentSettings)> for LanguageAgentSettings {
    fn from_iter<I: IntoIterator<Item = (String, AgentSettings)>>(agents: I) -> Self {
        Self(agents.into_iter().collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const KEYS: AgentKeys = AgentKeys {
        planner: "some-driver",
        interval_s: 1.0,
        max_tokens: 256,
        examples: None,
        has_memory: true,
    };

    #[test]
    fn what_is_set_to_its_default_is_no_change() {
        let set = AgentSettings {
            interval_s: Some(1.0),
            max_tokens: Some(8),
            reflection: Some(false),
            ..AgentSettings::default()
        };
        let changes = set.clone().changes(&KEYS);
        assert_eq!((changes.interval_s, changes.reflection), (None, None));
        assert_eq!(changes.whole(&KEYS), set.whole(&KEYS));
        assert_eq!((set.interval_s(&KEYS), set.max_tokens(&KEYS)), (1.0, 8));
    }

    #[test]
    fn a_setting_of_other_agents_is_foreign() {
        let set = AgentSettings {
            examples: Some(2),
            memory: Some("a".to_owned()),
            ..AgentSettings::default()
        };
        assert_eq!(set.foreign(&KEYS), Some("examples"));
        let keys = AgentKeys {
            examples: Some(3),
            has_memory: false,
            ..KEYS
        };
        assert_eq!(set.foreign(&keys), Some("memory"));
        assert_eq!((set.examples(&KEYS), set.examples(&keys)), (2, 2));
    }

    #[test]
    fn an_oracle_has_the_settings_of_its_agent_and_other_planners_none() {
        let mut settings = LanguageAgentSettings::default();
        settings.agent_mut("some-driver").memory = Some("m.json".to_owned());
        assert_eq!(settings.clone().only("oracle-some-driver"), settings);
        assert_eq!(settings.clone().only("idm").set().len(), 0);
        let memories: Vec<_> = settings.memories().collect();
        let key = "language_agents.some_driver.memory".to_owned();
        assert_eq!(memories, [(key, "some-driver".to_owned(), "m.json")]);
        assert_eq!(settings.without_memories().memories().count(), 0);
    }
}
