//! The answers: their parts, text, parser and grammar.

use super::AssistVariant;
use crate::reasoning::call_parser::{Call, Signature};
use crate::reasoning::code::{ACCEL_MAX, DECEL_MAX, Range};
use crate::reasoning::code_parser::Parsed;
use crate::reasoning::grammar::{ACCELERATIONS, DECELERATIONS, FASTEST, any_of, text};
use planagent_mllm::Constraint;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Length of a plan, seconds; one waypoint per second.
pub const WAYPOINT_SECONDS: usize = 4;
/// The function of an answer with waypoints.
const WAYPOINTS: Signature<'_> = Signature {
    function: "Follow_Waypoints",
    parameters: &["x1", "y1", "x2", "y2", "x3", "y3", "x4", "y4"],
};
/// The function of an answer with parameters.
const PARAMETERS: Signature<'_> = Signature {
    function: "Tune_PDM",
    parameters: &["v0", "gap", "headway", "acc", "dec", "brake"],
};
/// Words of the parameter `brake`.
const SWITCH: [&str; 2] = ["on", "off"];

/// `x`: a little backwards, forwards as far as four seconds at any speed.
const AHEAD: Range = Range {
    min: -20.0,
    max: 160.0,
    unit: "m",
};
/// `y`: as far as a turn of four seconds.
const LEFT: Range = Range {
    min: -60.0,
    max: 60.0,
    unit: "m",
};
/// `v0`: above standstill, which the IDM of the proposals does not allow.
const SPEED_CAP: Range = Range {
    min: 1.0,
    max: 40.0,
    unit: "m/s",
};
const MIN_GAP: Range = Range {
    min: 0.1,
    max: 10.0,
    unit: "m",
};
const HEADWAY: Range = Range {
    min: 0.1,
    max: 5.0,
    unit: "s",
};

/// Bound of `y` in the grammar, meters.
const GRAMMAR_LEFT: i32 = 8;
/// Step of `y` in the grammar, meters.
const GRAMMAR_LEFT_STEP: f64 = 0.5;
/// Values of `gap` and `headway` in the grammar; PDM-Closed's own are among them, as for `acc` and
/// `dec`.
const GRAMMAR_GAPS: [f64; 4] = [0.5, 1.0, 2.0, 4.0];
const GRAMMAR_HEADWAYS: [f64; 4] = [0.8, 1.2, 1.5, 2.5];

/// A position of the ego's center, in its frame at the time of the call, meters.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
pub struct Waypoint {
    pub ahead: f64,
    pub left: f64,
}

/// A plan: one waypoint per second, the first after one second.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
pub struct Waypoints(pub [Waypoint; WAYPOINT_SECONDS]);

/// Parameters of PDM-Closed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
pub struct AssistParameters {
    /// Speed of the fastest proposal on a free road, m/s.
    pub speed_cap: f64,
    /// Gap at standstill, meters.
    pub min_gap: f64,
    /// Headway, seconds.
    pub headway: f64,
    /// Maximum acceleration, m/s².
    pub accel_max: f64,
    /// Maximum deceleration as a positive magnitude, m/s².
    pub decel_max: f64,
    /// Whether the emergency brake may overrule the best proposal.
    pub emergency_brake: bool,
}

/// An answer.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Assistance {
    /// The answer of the unconstrained variant.
    Waypoints(Waypoints),
    /// The answer of the other variant.
    Parameters(AssistParameters),
}

impl fmt::Display for Assistance {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Waypoints(Waypoints(waypoints)) => {
                let numbers = waypoints
                    .iter()
                    .flat_map(|waypoint| [waypoint.ahead, waypoint.left]);
                let named = WAYPOINTS
                    .parameters
                    .iter()
                    .zip(numbers)
                    .map(|(name, number)| format!("{name}={number}"));
                write!(
                    f,
                    "{}({})",
                    WAYPOINTS.function,
                    named.collect::<Vec<_>>().join(", ")
                )
            }
            Self::Parameters(AssistParameters {
                speed_cap,
                min_gap,
                headway,
                accel_max,
                decel_max,
                emergency_brake,
            }) => {
                // `SWITCH` has the word for on first.
                let brake = SWITCH[usize::from(!emergency_brake)];
                write!(
                    f,
                    "{}(v0={speed_cap}, gap={min_gap}, headway={headway}, acc={accel_max}, dec={decel_max}, brake={brake})",
                    PARAMETERS.function
                )
            }
        }
    }
}

/// The function that an answer calls, with its parameters, for the prompt.
pub(super) fn signature(variant: AssistVariant) -> Signature<'static> {
    match variant {
        AssistVariant::Unconstrained => WAYPOINTS,
        AssistVariant::Parameters => PARAMETERS,
    }
}

/// Reads the last call in an answer.
pub fn parse_assistance(answer: &str, variant: AssistVariant) -> Parsed<Assistance> {
    let mut call = match Call::find(answer, signature(variant)) {
        Ok(call) => call,
        Err(error) => {
            return Parsed {
                answer: None,
                errors: vec![error],
            };
        }
    };
    let answer = match variant {
        AssistVariant::Unconstrained => waypoints(&mut call).map(Assistance::Waypoints),
        AssistVariant::Parameters => parameters(&mut call).map(Assistance::Parameters),
    };
    Parsed {
        answer,
        errors: call.into_errors(),
    }
}

fn waypoints(call: &mut Call<'_>) -> Option<Waypoints> {
    let mut read = [None; WAYPOINT_SECONDS];
    for (waypoint, names) in read.iter_mut().zip(WAYPOINTS.parameters.chunks(2)) {
        let [x, y] = names else { return None };
        let (ahead, left) = (call.number(x, AHEAD), call.number(y, LEFT));
        *waypoint = ahead
            .zip(left)
            .map(|(ahead, left)| Waypoint { ahead, left });
    }
    let [a, b, c, d] = read;
    Some(Waypoints([a?, b?, c?, d?]))
}

fn parameters(call: &mut Call<'_>) -> Option<AssistParameters> {
    let speed_cap = call.number("v0", SPEED_CAP);
    let min_gap = call.number("gap", MIN_GAP);
    let headway = call.number("headway", HEADWAY);
    let accel_max = call.number("acc", ACCEL_MAX);
    let decel_max = call.magnitude("dec", DECEL_MAX);
    let brake = call.word("brake", &SWITCH);
    Some(AssistParameters {
        speed_cap: speed_cap?,
        min_gap: min_gap?,
        headway: headway?,
        accel_max: accel_max?,
        decel_max: decel_max?,
        emergency_brake: brake? == 0,
    })
}

/// The grammar of answers for a speed limit in whole m/s.
pub(super) fn grammar(variant: AssistVariant, limit: Option<u32>) -> Constraint {
    let limit = limit.unwrap_or(FASTEST).max(1);
    let offered: Vec<Constraint> = match variant {
        AssistVariant::Unconstrained => {
            // The grammar offers round values only; the parser reads all that lie between them too.
            let steps = (f64::from(GRAMMAR_LEFT) / GRAMMAR_LEFT_STEP) as i32;
            let left = any_of(
                (-steps..=steps).map(|step| (f64::from(step) * GRAMMAR_LEFT_STEP).to_string()),
            );
            let ahead = |second: u32| any_of((0..=second * limit).map(|meters| meters.to_string()));
            (1..=WAYPOINT_SECONDS as u32)
                .flat_map(|second| [ahead(second), left.clone()])
                .collect()
        }
        AssistVariant::Parameters => {
            let numbers = |values: [f64; 4]| any_of(values.iter().map(ToString::to_string));
            vec![
                any_of((1..=limit).map(|speed| speed.to_string())),
                numbers(GRAMMAR_GAPS),
                numbers(GRAMMAR_HEADWAYS),
                numbers(ACCELERATIONS),
                numbers(DECELERATIONS),
                any_of(SWITCH),
            ]
        }
    };
    let Signature {
        function,
        parameters,
    } = signature(variant);
    let named = parameters
        .iter()
        .zip(offered)
        .enumerate()
        .flat_map(|(i, (name, values))| {
            let before = if i == 0 {
                format!("{function}({name}=")
            } else {
                format!(", {name}=")
            };
            [text(before), values]
        });
    Constraint::Sequence(named.chain([text(")")]).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const PLAN: &str = "Follow_Waypoints(x1=8, y1=0, x2=16, y2=0.5, x3=23, y3=-1, x4=30, y4=0)";
    const TUNED: &str = "Tune_PDM(v0=8, gap=2, headway=1.5, acc=1, dec=4, brake=off)";

    /// A text that a constraint of choices allows; `pick` selects each choice.
    fn allowed(constraint: &Constraint, pick: usize) -> String {
        match constraint {
            Constraint::Sequence(parts) => parts.iter().map(|part| allowed(part, pick)).collect(),
            Constraint::Choice(texts) => texts[pick % texts.len()].clone(),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn answers_are_read_and_printed() {
        for (answer, variant) in [
            (PLAN, AssistVariant::Unconstrained),
            (TUNED, AssistVariant::Parameters),
        ] {
            let Parsed {
                answer: read,
                errors,
            } = parse_assistance(&format!("Carefully:\n{answer}"), variant);
            assert_eq!(errors, []);
            assert_eq!(read.map(|read| read.to_string()).as_deref(), Some(answer));
        }
        let Parsed {
            answer: read,
            errors,
        } = parse_assistance(TUNED, AssistVariant::Unconstrained);
        assert_eq!(
            (read, errors[0].message.as_str()),
            (None, "no call of Follow_Waypoints")
        );
        let Parsed {
            answer: read,
            errors,
        } = parse_assistance(
            "Tune_PDM(0, 2, 1.5, 1, 4, maybe)",
            AssistVariant::Parameters,
        );
        let messages: Vec<&str> = errors.iter().map(|error| error.message.as_str()).collect();
        assert_eq!(
            (read, messages),
            (
                None,
                vec!["v0 = 0 is out of range", "brake is none of its words"]
            )
        );
    }

    proptest! {
        #[test]
        fn whatever_the_grammar_allows_is_read(pick in any::<usize>(), limit in prop::option::of(0..40u32)) {
            for &variant in AssistVariant::ALL {
                let answer = allowed(&grammar(variant, limit), pick);
                let Parsed { answer: read, errors } = parse_assistance(&answer, variant);
                prop_assert!(read.is_some() && errors.is_empty(), "{}: {:?}", answer, errors);
            }
        }

        #[test]
        fn any_text_is_read_without_failing(text in "(Follow_Waypoints|Tune_PDM)?\\PC{0,60}") {
            for &variant in AssistVariant::ALL {
                let Parsed { answer: read, errors } = parse_assistance(&text, variant);
                prop_assert!(read.is_some() || !errors.is_empty());
            }
        }
    }
}
