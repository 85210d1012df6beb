//! The grammars of the rounds, under which an answer always parses.

use super::code::{FUNCTION, NO_LEAD_AGENT, Names};
use super::instruction::{Lateral, LateralReason, Longitudinal, LongitudinalReason};
use super::prompt_set::{InstructionForm, UnderstandingForm};
use crate::environment::facts::{Light, Question, SideLane};
use crate::mllm::Constraint;
use std::ops::RangeInclusive;

/// Maximum target speed where the speed limit is unknown, m/s. Speeds are whole numbers.
pub(super) const FASTEST: u32 = 30;
/// Accelerations that a model may write, m/s².
pub const ACCELERATIONS: [f64; 4] = [0.5, 1.0, 1.5, 2.0];
/// Decelerations that a model may write, m/s².
pub const DECELERATIONS: [f64; 4] = [2.0, 3.0, 4.0, 6.0];
/// A reason in free text: one line that begins with a letter.
const REASON: &str = r"[A-Za-z][^\n]{2,160}";
/// The same in a few words, about twelve tokens.
const SHORT_REASON: &str = r"[A-Za-z][^\n]{2,48}";
/// What may be ahead in the ego's lane: the classes of agents in the scene text, or nothing.
const AHEAD: [&str; 5] = ["nothing", "vehicle", "bicycle", "pedestrian", "obstacle"];

/// One of these words.
pub(super) fn any_of<S: AsRef<str>>(words: impl IntoIterator<Item = S>) -> Constraint {
    Constraint::Choice(words.into_iter().map(|word| word.as_ref().to_owned()).collect())
}

pub(super) fn text(text: impl AsRef<str>) -> Constraint {
    any_of([text])
}

/// The grammar of round 1.
pub(super) fn understanding(form: UnderstandingForm) -> Constraint {
    match form {
        UnderstandingForm::Free => Constraint::Free,
        UnderstandingForm::Choices => {
            let answers = Question::ALL.iter().enumerate().flat_map(|(i, question)| {
                let space = if i == 0 { "" } else { " " };
                [text(format!("{space}{}=", question.as_str())), any_of(question.choices())]
            });
            Constraint::Sequence(answers.collect())
        }
        UnderstandingForm::Short => Constraint::Sequence(vec![
            text("Ahead: "),
            any_of(AHEAD),
            text("\nLight: "),
            any_of(Light::TEXTS),
            text("\nLeft lane: "),
            any_of(SideLane::TEXTS),
            text("\nRight lane: "),
            any_of(SideLane::TEXTS),
            text("\nNote: "),
            Constraint::Regex(SHORT_REASON.to_owned()),
        ]),
    }
}

/// The grammar of round 2.
pub(super) fn instruction(form: InstructionForm) -> Constraint {
    let (longitudinal, lateral) = (any_of(Longitudinal::TEXTS), any_of(Lateral::TEXTS));
    Constraint::Sequence(match form {
        InstructionForm::Choices => vec![
            text("why="),
            any_of(LateralReason::TEXTS),
            text(" lat="),
            lateral,
            text(" why="),
            any_of(LongitudinalReason::TEXTS),
            text(" lon="),
            longitudinal,
        ],
        // The reason comes last, so that a bound on the answer's tokens cuts nothing else.
        InstructionForm::Short => vec![
            text("Speed: "),
            longitudinal,
            text("\nLane: "),
            lateral,
            text("\nReason: "),
            Constraint::Regex(SHORT_REASON.to_owned()),
        ],
        InstructionForm::Reasoned => {
            let reason = || Constraint::Regex(REASON.to_owned());
            vec![
                text("Longitudinal: "),
                longitudinal,
                text(", because "),
                reason(),
                text("\nLateral: "),
                lateral,
                text(", because "),
                reason(),
            ]
        }
    })
}

/// The target speeds of codes in a scene, m/s.
pub fn target_speeds(names: &Names) -> RangeInclusive<u32> {
    0..=names.speed_limit.unwrap_or(FASTEST)
}

/// The grammar of round 3: one call with the names of this scene.
pub(super) fn code(names: &Names) -> Constraint {
    Constraint::Sequence(vec![
        text(format!("{FUNCTION}(c=")),
        any_of(names.centerlines.iter().map(ToString::to_string)),
        text(", la="),
        any_of(names.lead_agents.iter().map(ToString::to_string).chain([NO_LEAD_AGENT.to_owned()])),
        text(", v0="),
        any_of(target_speeds(names).map(|v| v.to_string())),
        text(", acc="),
        any_of(ACCELERATIONS.iter().map(ToString::to_string)),
        text(", dec="),
        any_of(DECELERATIONS.iter().map(ToString::to_string)),
        text(")"),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::environment::CenterlineName;

    #[test]
    fn the_code_grammar_offers_the_names_of_the_scene() {
        let names = Names {
            centerlines: vec![CenterlineName::EgoLane],
            lead_agents: vec!["vehicle1".parse().unwrap()],
            speed_limit: Some(2),
        };
        let Constraint::Sequence(parts) = code(&names) else { panic!("not a sequence") };
        for offered in [&["0", "1", "2"][..], &["ego_lane"], &["vehicle1", "None"]] {
            assert!(parts.contains(&any_of(offered)), "{offered:?}: {parts:?}");
        }
    }
}
