//! What is remembered: decisions.

use crate::memory::Remembered;
use planagent_agent::reasoning::DrivingAction;
use serde::{Deserialize, Serialize};

/// Stands before the number of an action.
pub(crate) const DELIMITER: &str = "####";

/// Whether an answer ends with an action, as remembered answers must: they show the form.
pub(crate) fn ends_with(answer: &str, action: DrivingAction) -> bool {
    let number = answer.rsplit_once(DELIMITER);
    number.is_some_and(|(_, number)| number.trim().parse() == Ok(action.id()))
}

/// A remembered decision of DiLu.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct DiluItem {
    /// The scene in words.
    pub(crate) description: String,
    /// Reasoning and action, as the model is to write them.
    pub(crate) answer: String,
    /// The action.
    pub(crate) action: DrivingAction,
    /// Where it comes from, and whether it corrects a mistake.
    pub(crate) comment: String,
}

impl Remembered for DiluItem {
    fn texts(&self) -> [(&'static str, &str); 3] {
        [
            ("description", &self.description),
            ("answer", &self.answer),
            ("comment", &self.comment),
        ]
    }

    const READ: usize = 2;

    fn fault(&self) -> Option<String> {
        (!ends_with(&self.answer, self.action))
            .then(|| format!("answer does not end with the action {}", self.action))
    }
}
