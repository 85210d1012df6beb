//! Why the answers of a planning call gave no plan.

use super::record::Attempt;
use crate::reasoning::ParseError;
use planagent_mllm::FinishReason;
use std::fmt;

/// What is wrong with the last answer of a planning call that gave no plan.
#[derive(
    Debug,
    Clone,
    Copy,
    PartialEq,
    Eq,
    PartialOrd,
    Ord,
    Hash,
    serde::Serialize,
    serde::Deserialize,
    schemars::JsonSchema,
)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Unreadable {
    /// The answer has no text.
    Empty,
    /// The answer ended at a limit of tokens before its line was complete.
    CutOff,
    /// The answer has no line of the form that was asked for.
    NoLine,
    /// The line names what is not in the scene, or has wrong arguments.
    WrongLine,
    /// The line can be read, but stands for no plan in this scene.
    NoPlan,
    /// Nothing was answered.
    NoAttempt,
    /// The waypoints ask for more than a vehicle can do.
    Jump,
}

impl Unreadable {
    /// Its name in records.
    pub fn name(self) -> &'static str {
        match self {
            Self::Empty => "empty",
            Self::CutOff => "cut_off",
            Self::NoLine => "no_line",
            Self::WrongLine => "wrong_line",
            Self::NoPlan => "no_plan",
            Self::NoAttempt => "no_attempt",
            Self::Jump => "jump",
        }
    }

    /// What is wrong with an attempt that has no plan.
    pub(super) fn in_attempt(attempt: &Attempt) -> Self {
        if attempt.answer.is_some() {
            return Self::NoPlan;
        }
        match attempt.rounds.last() {
            Some(last) if last.answer.trim().is_empty() => Self::Empty,
            Some(last)
                if matches!(
                    last.finish,
                    FinishReason::Length | FinishReason::ContextFull
                ) =>
            {
                Self::CutOff
            }
            _ if attempt.errors.iter().any(ParseError::is_of_no_call) => Self::NoLine,
            _ => Self::WrongLine,
        }
    }
}

impl fmt::Display for Unreadable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Empty => "the answer is empty",
            Self::CutOff => "the answer is cut off at the limit of tokens",
            Self::NoLine => "the answer has no line of the form that was asked for",
            Self::WrongLine => "the line of the answer is wrong",
            Self::NoPlan => "the line of the answer stands for no plan in this scene",
            Self::NoAttempt => "nothing was answered",
            Self::Jump => "the waypoints jump",
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::environment::CenterlineName;
    use crate::reasoning::{Names, Round, RoundRecord, parse};
    use planagent_mllm::{ConstraintUse, RoundTime, TokenCounts};

    fn attempt(answer: &str, finish: FinishReason) -> Attempt {
        let round = RoundRecord {
            round: Round::Code.into(),
            prompt: String::new(),
            prompt_hash: String::new(),
            answer: answer.to_owned(),
            finish,
            constraint: ConstraintUse::NotSent,
            log_probability: None,
            tokens: TokenCounts::default(),
            tool: None,
            time: RoundTime::default(),
        };
        let names = Names {
            centerlines: vec![CenterlineName::EgoLane],
            lead_agents: Vec::new(),
            speed_limit: None,
        };
        let parsed = parse(answer, &names);
        let mut attempt = Attempt::of_rounds(vec![round]);
        (attempt.answer, attempt.errors) = (parsed.answer.map(Into::into), parsed.errors);
        attempt
    }

    #[test]
    fn each_kind_of_answer_without_a_plan_has_its_cause() {
        use FinishReason::{EndOfSequence, Length};
        for (answer, finish, cause) in [
            ("", EndOfSequence, Unreadable::Empty),
            (" \n", Length, Unreadable::Empty),
            ("I see a road with", Length, Unreadable::CutOff),
            ("Generate_IDM_Planner(c=ego_", Length, Unreadable::CutOff),
            (
                "I cannot help with that.",
                EndOfSequence,
                Unreadable::NoLine,
            ),
            (
                "Generate_IDM_Planner(c=up, la=None, v0=1, acc=1, dec=1)",
                EndOfSequence,
                Unreadable::WrongLine,
            ),
            (
                "Generate_IDM_Planner(c=ego_lane, la=None, v0=1, acc=1, dec=1)",
                EndOfSequence,
                Unreadable::NoPlan,
            ),
        ] {
            let found = Unreadable::in_attempt(&attempt(answer, finish));
            assert_eq!(found, cause, "{answer}");
            let name = serde_json::to_value(found).unwrap();
            assert_eq!(name, found.name());
        }
    }
}
