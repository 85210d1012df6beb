//! Section `language_agents`: the other language agents of the paper's comparison.

use serde::{Deserialize, Serialize};

/// Settings of the agents by name.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LanguageAgentSettings {
    /// GPT-Driver.
    pub gpt_driver: GptDriverSettings,
    /// `DiLu`.
    pub dilu: DiluSettings,
    /// Agent-Driver.
    pub agent_driver: AgentDriverSettings,
}

/// What the settings of every agent have.
#[doc(hidden)]
#[derive(Debug, Clone, Copy)]
#[allow(missing_docs, reason = "those of the agents' settings")]
pub struct AskedAgent {
    pub name: &'static str,
    pub interval_s: f64,
    pub max_tokens: usize,
}

impl LanguageAgentSettings {
    /// What all agents have.
    #[doc(hidden)]
    pub fn agents(&self) -> impl Iterator<Item = AskedAgent> {
        let (gpt_driver, dilu, agent_driver) = (&self.gpt_driver, &self.dilu, &self.agent_driver);
        let agent = |name, interval_s, max_tokens| AskedAgent {
            name,
            interval_s,
            max_tokens,
        };
        [
            agent("gpt_driver", gpt_driver.interval_s, gpt_driver.max_tokens),
            agent("dilu", dilu.interval_s, dilu.max_tokens),
            agent(
                "agent_driver",
                agent_driver.interval_s,
                agent_driver.max_tokens,
            ),
        ]
        .into_iter()
    }

    /// The memories that are set: key, planner and file.
    #[doc(hidden)]
    pub fn memories(&self) -> impl Iterator<Item = (&'static str, &'static str, &str)> {
        [
            ("language_agents.dilu.memory", "dilu", &self.dilu.memory),
            (
                "language_agents.agent_driver.memory",
                "agent-driver",
                &self.agent_driver.memory,
            ),
        ]
        .into_iter()
        .filter_map(|(key, planner, file)| Some((key, planner, file.as_deref()?)))
    }

    /// The files of all memories.
    #[doc(hidden)]
    pub fn memories_mut(&mut self) -> impl Iterator<Item = &mut String> {
        [&mut self.dilu.memory, &mut self.agent_driver.memory]
            .into_iter()
            .flatten()
    }

    /// The same without memories.
    #[doc(hidden)]
    #[must_use]
    pub fn without_memories(mut self) -> Self {
        (self.dilu.memory, self.agent_driver.memory) = (None, None);
        self
    }

    /// Those of one planner alone, by the planner's name; of another planner, the defaults.
    #[doc(hidden)]
    #[must_use]
    pub fn only(self, planner: &str) -> Self {
        let agent = planner.strip_prefix("oracle-").unwrap_or(planner);
        let mut only = Self::default();
        match agent {
            "gpt-driver" => only.gpt_driver = self.gpt_driver,
            "dilu" => only.dilu = self.dilu,
            "agent-driver" => only.agent_driver = self.agent_driver,
            _ => {}
        }
        only
    }

    /// Whether every setting has its default.
    pub fn is_default(&self) -> bool {
        *self == Self::default()
    }
}

/// Table `language_agents.gpt_driver`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GptDriverSettings {
    /// Time between planning calls, seconds.
    pub interval_s: f64,
    /// Maximum tokens of an answer.
    pub max_tokens: usize,
}

impl Default for GptDriverSettings {
    fn default() -> Self {
        Self {
            interval_s: 1.0,
            max_tokens: 256,
        }
    }
}

/// Table `language_agents.dilu`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DiluSettings {
    /// Time between planning calls, seconds.
    pub interval_s: f64,
    /// Maximum tokens of an answer.
    pub max_tokens: usize,
    /// Remembered decisions in a prompt.
    pub examples: usize,
    /// The file of the memory; `None` for none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub memory: Option<String>,
}

impl Default for DiluSettings {
    fn default() -> Self {
        Self {
            interval_s: 1.0,
            max_tokens: 320,
            examples: 3,
            memory: None,
        }
    }
}

/// Table `language_agents.agent_driver`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AgentDriverSettings {
    /// Time between planning calls, seconds.
    pub interval_s: f64,
    /// Maximum tokens of reasons, and of waypoints.
    pub max_tokens: usize,
    /// The file of the memory; `None` for none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub memory: Option<String>,
}

impl Default for AgentDriverSettings {
    fn default() -> Self {
        Self {
            interval_s: 2.0,
            max_tokens: 256,
            memory: None,
        }
    }
}
