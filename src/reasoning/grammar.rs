//! Grammars (llguidance's Lark) under which answers are decoded, so that an answer always parses.

use super::code::{FUNCTION, Names};
use super::instruction::{Lateral, LateralReason, Longitudinal, LongitudinalReason};
use super::prompt_set::{InstructionForm, UnderstandingForm};
use crate::environment::facts::Question;
use crate::mllm::Constraint;

/// Desired speeds that a model may write, m/s: whole numbers up to the speed limit, or up to this where it is unknown.
const FASTEST: u32 = 30;
/// Accelerations that a model may write, m/s².
pub const ACCELERATIONS: [f64; 4] = [0.5, 1.0, 1.5, 2.0];
/// Decelerations that a model may write, m/s².
pub const DECELERATIONS: [f64; 4] = [2.0, 3.0, 4.0, 6.0];

/// Joins alternatives as quoted literals.
fn any_of<S: AsRef<str>>(words: impl IntoIterator<Item = S>) -> String {
    let quoted: Vec<String> = words.into_iter().map(|word| format!("{:?}", word.as_ref())).collect();
    format!("({})", quoted.join(" | "))
}

/// What answers of round 1 look like.
pub(super) fn understanding(form: UnderstandingForm) -> Constraint {
    match form {
        UnderstandingForm::Free => Constraint::Free,
        UnderstandingForm::Choices => {
            let parts: Vec<String> = Question::ALL
                .iter()
                .enumerate()
                .map(|(i, question)| {
                    let space = if i == 0 { "" } else { " " };
                    format!("{:?} {}", format!("{space}{}=", question.as_str()), any_of(question.choices()))
                })
                .collect();
            Constraint::Lark(format!("start: {}", parts.join(" ")))
        }
    }
}

/// What answers of round 2 look like.
pub(super) fn instruction(form: InstructionForm) -> Constraint {
    let longitudinal = any_of(Longitudinal::TEXTS);
    let lateral = any_of(Lateral::TEXTS);
    Constraint::Lark(match form {
        InstructionForm::Choices => {
            let why_lateral = any_of(LateralReason::TEXTS);
            let why_longitudinal = any_of(LongitudinalReason::TEXTS);
            format!(
                "start: \"why=\" {why_lateral} \" lat=\" {lateral} \" why=\" {why_longitudinal} \" lon=\" {longitudinal}"
            )
        }
        InstructionForm::Reasoned => format!(
            "start: \"Longitudinal: \" {longitudinal} \", because \" REASON \"\\nLateral: \" {lateral} \", because \" REASON\nREASON: /[A-Za-z][^\\n]{{2,160}}/"
        ),
    })
}

/// What answers of round 3 look like: one call with the names of this scene.
pub(super) fn code(names: &Names) -> Constraint {
    let centerline = any_of(&names.centerlines);
    let leader = any_of(names.leaders.iter().map(String::as_str).chain(["None"]));
    let speed = any_of((0..=names.speed_limit.unwrap_or(FASTEST)).map(|v| v.to_string()));
    let accel = any_of(ACCELERATIONS.iter().map(ToString::to_string));
    let decel = any_of(DECELERATIONS.iter().map(ToString::to_string));
    Constraint::Lark(format!(
        "start: \"{FUNCTION}(c=\" {centerline} \", la=\" {leader} \", v0=\" {speed} \", acc=\" {accel} \", dec=\" {decel} \")\""
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_code_grammar_offers_the_names_of_the_scene() {
        let names =
            Names { centerlines: vec!["ego_lane".into()], leaders: vec!["vehicle1".into()], speed_limit: Some(2) };
        let Constraint::Lark(grammar) = code(&names) else { panic!("not a grammar") };
        assert!(grammar.contains("(\"0\" | \"1\" | \"2\")"), "{grammar}");
        assert!(grammar.contains("(\"ego_lane\")") && grammar.contains("(\"vehicle1\" | \"None\")"), "{grammar}");
    }
}
