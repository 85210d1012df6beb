//! What a model answered at a state, as it is kept.

use serde::{Deserialize, Serialize};

/// The answers at one state.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct StateRecord {
    /// The scene, which has one state.
    pub(super) scene: String,
    /// Time after the start of the scene, seconds.
    pub(super) time_s: f64,
    pub(super) challenge: String,
    /// The best code of the search, and its value.
    pub(super) best: String,
    pub(super) best_value: f64,
    pub(super) own: Answered,
    /// The code, where the model's own answers before it were given: what the changes are compared
    /// with, if the model is repeatable.
    pub(super) again: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) other_picture: Option<Answered>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) no_picture: Option<Answered>,
    pub(super) changes: Vec<ChangedAnswer>,
}

/// A model's answers, round by round.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct Answered {
    pub(super) answers: Vec<String>,
    /// The code; none if it cannot be read.
    pub(super) code: Option<String>,
    /// Natural logarithm of the probability of the code among those that the grammar allows, behind
    /// the answers before it.
    pub(super) log_probability: Option<f64>,
    /// The search's value of the code; none if it gives no plan.
    pub(super) value: Option<f64>,
}

/// The code after one answer was changed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct ChangedAnswer {
    /// Name of the change.
    pub(super) change: String,
    pub(super) code: Option<String>,
    pub(super) agrees: bool,
}

impl StateRecord {
    /// What the best known code gains over an answer's, in the search's value; none without a plan.
    /// A code may be better than all that the search tried.
    pub(super) fn regret(&self, answered: &Answered) -> Option<f64> {
        answered
            .value
            .map(|value| (self.best_value - value).max(0.0))
    }

    /// The record as it is read from its file: a number may lose its last digit there, and a card
    /// must not depend on what was read.
    pub(super) fn as_read(&self) -> serde_json::Result<Self> {
        serde_json::from_str(&serde_json::to_string(self)?)
    }
}
