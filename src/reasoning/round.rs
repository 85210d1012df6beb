//! The three rounds of an attempt.

use std::fmt;

/// One of the paper's three rounds.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize, schemars::JsonSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum Round {
    /// Scene understanding: global and local questions.
    Understanding,
    /// Motion instruction: longitudinal and lateral, with reasons.
    Instruction,
    /// Planner code.
    Code,
}

impl Round {
    pub const ALL: [Self; 3] = [Self::Understanding, Self::Instruction, Self::Code];

    /// The name in records and of the prompt template.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Understanding => "understanding",
            Self::Instruction => "instruction",
            Self::Code => "code",
        }
    }
}

impl fmt::Display for Round {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}
