//! The answer of DiLu: reasoning, then a delimiter and the number of an action.

use crate::agent::Reply;
use crate::chat::Chat;
use crate::waypoints::{any_of, text};
use planagent_agent::planner::Unreadable;
use planagent_agent::reasoning::{DrivingAction, ParseError};
use planagent_mllm::Constraint;

/// Stands before the number.
pub(super) const DELIMITER: &str = "####";
/// The reasoning: some sentences without the delimiter.
const REASONING: &str = "[A-Za-z][^#]{2,600}";

/// Reasoning and one of the offered actions.
pub(super) fn grammar(offered: &[DrivingAction]) -> Constraint {
    Constraint::Sequence(vec![
        Constraint::Regex(REASONING.to_owned()),
        text(format!("\n{DELIMITER} ")),
        numbers(offered),
    ])
}

/// One of the offered actions alone.
pub(super) fn extraction(offered: &[DrivingAction]) -> Constraint {
    numbers(offered)
}

fn numbers(offered: &[DrivingAction]) -> Constraint {
    any_of(offered.iter().map(|action| action.id().to_string()))
}

/// The action whose number stands behind the last delimiter.
pub(super) fn read_action(
    answer: &str,
    offered: &[DrivingAction],
    chat: &Chat<'_>,
) -> Reply<DrivingAction> {
    let error = |from: usize, message: String| {
        let numbers: Vec<String> = offered
            .iter()
            .map(|action| action.id().to_string())
            .collect();
        ParseError {
            span: from..answer.len(),
            message,
            hint: format!(
                "end with {DELIMITER} and one of the numbers {}",
                numbers.join(", ")
            ),
        }
    };
    // The last delimiter, because a model often repeats the instructions before it answers.
    let Some((before, number)) = answer.rsplit_once(DELIMITER) else {
        let error = error(answer.len(), format!("no {DELIMITER} with an action"));
        return Reply::wrong(error, chat.without_line());
    };
    let from = before.len() + DELIMITER.len();
    let number = number.trim();
    let action = number.parse().ok().and_then(DrivingAction::from_id);
    match action {
        Some(action) if offered.contains(&action) => Reply::plan(action),
        Some(action) => Reply {
            answer: Some(action),
            errors: vec![error(
                from,
                format!("action {number} ({action}) is not offered here"),
            )],
            unreadable: Some(Unreadable::WrongLine),
        },
        None => {
            let shown: String = number.chars().take(20).collect();
            let error = error(from, format!("'{shown}' is no number of an action"));
            Reply::wrong(error, chat.with_wrong_line())
        }
    }
}
