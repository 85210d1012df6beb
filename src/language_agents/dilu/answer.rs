//! The answer of DiLu: reasoning, then a delimiter and the number of an action.

use super::item::DELIMITER;
use crate::agent::{Reply, beginning};
use crate::chat::Chat;
use crate::waypoints::any_of;
use planagent_agent::planner::Unreadable;
use planagent_agent::reasoning::{DrivingAction, ParseError};
use planagent_mllm::Constraint;
use std::ops::Range;

/// The reasoning: some sentences without the delimiter.
const REASONING: &str = "[A-Za-z][^#]{2,600}";

/// Reasoning and one of the offered actions. One expression, because a part of its own would take the
/// line break, and the delimiter behind it could never follow.
pub(super) fn grammar(offered: &[DrivingAction]) -> Constraint {
    let numbers: Vec<String> = offered
        .iter()
        .map(|action| action.id().to_string())
        .collect();
    let end = format!("\n{DELIMITER} ({})", numbers.join("|"));
    Constraint::Regex(format!("{REASONING}{end}"))
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
    // The last delimiter, because a model often repeats the instructions before it answers.
    if let Some((_, number)) = answer.rsplit_once(DELIMITER) {
        return read_number(answer, number, offered, chat);
    }
    let message = format!("no {DELIMITER} with an action");
    let error = error(answer.len()..answer.len(), message, offered);
    Reply::wrong(error, chat.without_line())
}

/// The action of an answer that is to be a number alone.
pub(super) fn read_extraction(
    answer: &str,
    offered: &[DrivingAction],
    chat: &Chat<'_>,
) -> Reply<DrivingAction> {
    if answer.contains(DELIMITER) {
        read_action(answer, offered, chat)
    } else {
        read_number(answer, answer, offered, chat)
    }
}

/// The action whose number is the end of an answer.
fn read_number(
    answer: &str,
    number: &str,
    offered: &[DrivingAction],
    chat: &Chat<'_>,
) -> Reply<DrivingAction> {
    let from = answer.len() - number.len();
    let number = number.trim();
    let wrong = |message| error(from..answer.len(), message, offered);
    match number.parse().ok().and_then(DrivingAction::from_id) {
        Some(action) if offered.contains(&action) => Reply::plan(action),
        Some(action) => {
            let message = format!(
                "action {} ({action}) is not offered here",
                beginning(number)
            );
            Reply {
                answer: Some(action),
                errors: vec![wrong(message)],
                unreadable: Some(Unreadable::WrongLine),
            }
        }
        None => {
            let message = format!("'{}' is no number of an action", beginning(number));
            Reply::wrong(wrong(message), chat.with_wrong_line())
        }
    }
}

fn error(span: Range<usize>, message: String, offered: &[DrivingAction]) -> ParseError {
    let numbers = offered.iter().map(|action| action.id().to_string());
    ParseError {
        span,
        message,
        hint: format!(
            "end with {DELIMITER} and one of the numbers {}",
            numbers.collect::<Vec<_>>().join(", ")
        ),
    }
}
