//! How a model's answers are sampled, and how long they may be.

use crate::{ProbeQuestion, Sampling};
use serde::{Deserialize, Serialize};

/// How a model is asked, as its description says.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GenerationSettings {
    /// Longest answer of each round, tokens.
    pub max_new_tokens: RoundTokens,
    pub sampling: Sampling,
    /// Most tokens of a model's thinking before each answer; none for answers without thinking. The
    /// model's chat template must know thinking.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub thinking: Option<usize>,
}

impl GenerationSettings {
    /// A question to try a server with, like those of the first round.
    pub fn probe(&self, picture: bool, constrained: bool) -> ProbeQuestion {
        ProbeQuestion {
            picture,
            constrained,
            max_new_tokens: self.max_new_tokens.understanding,
            sampling: self.sampling,
        }
    }
}

/// A number of tokens for each round.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RoundTokens {
    /// Scene understanding.
    pub understanding: usize,
    /// Motion instruction.
    pub instruction: usize,
    /// Planner code.
    pub code: usize,
}

impl Default for GenerationSettings {
    fn default() -> Self {
        Self {
            max_new_tokens: RoundTokens::default(),
            sampling: Sampling::Greedy,
            thinking: None,
        }
    }
}

impl Default for RoundTokens {
    fn default() -> Self {
        Self {
            understanding: 1024,
            instruction: 512,
            code: 128,
        }
    }
}
