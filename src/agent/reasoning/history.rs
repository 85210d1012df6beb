//! The last answers of a simulation, from which the next are drafted.

use super::round::Round;
use serde::{Deserialize, Serialize};

/// Where drafts of answers come from. A draft changes no answer: the model computes several tokens
/// in one pass, and keeps those that it chooses itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Speculation {
    /// Nowhere: each token has a pass of its own.
    None,
    /// From the last answer to the same round, and from the words of the chat.
    #[default]
    History,
}

/// The tokens of the last answer of each round.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct AnswerHistory {
    answers: [Vec<u32>; Round::ALL.len()],
}

impl AnswerHistory {
    /// The last answer of a round; empty before the first.
    pub(super) fn last(&self, round: Round) -> &[u32] {
        self.answers.get(round as usize).map_or(&[], Vec::as_slice)
    }

    pub(super) fn set(&mut self, round: Round, ids: Vec<u32>) {
        if let Some(answer) = self.answers.get_mut(round as usize) {
            *answer = ids;
        }
    }
}
