//! The grammars of the rounds, under which an answer always parses.

use super::code::{FUNCTION, NO_LEAD_AGENT, Names, PlannerCode};
use super::instruction::{Lateral, LateralReason, Longitudinal, LongitudinalReason};
use super::prompt_set::{InstructionForm, UnderstandingForm};
use crate::environment::CenterlineName;
use crate::environment::facts::{Light, SideLane};
use planagent_mllm::Constraint;
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
    Constraint::Choice(
        words
            .into_iter()
            .map(|word| word.as_ref().to_owned())
            .collect(),
    )
}

pub(super) fn text(text: impl AsRef<str>) -> Constraint {
    any_of([text])
}

/// The grammar of round 1.
pub(super) fn understanding(form: UnderstandingForm) -> Constraint {
    // One match: an arm is a form of docs/prompts.md, and the parser reads what it allows.
    match form {
        UnderstandingForm::Free => Constraint::Free,
        UnderstandingForm::Choices | UnderstandingForm::Choices2 => {
            let answers = form
                .questions()
                .iter()
                .enumerate()
                .flat_map(|(i, question)| {
                    let space = if i == 0 { "" } else { " " };
                    [
                        text(format!("{space}{}=", question.as_str())),
                        any_of(question.choices()),
                    ]
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

/// The codes that were refused in a planning call.
#[derive(Debug, Clone, Default)]
pub(super) struct Refused {
    /// All of them.
    pub(super) codes: Vec<PlannerCode>,
    /// Those whose plans lacked nothing but progress.
    pub(super) slow: Vec<PlannerCode>,
}

impl Refused {
    /// Whether a plan along a centerline at this target speed is as slow as one that was refused
    /// for it.
    fn is_slow(&self, centerline: CenterlineName, target_speed: u32) -> bool {
        self.slow.iter().any(|code| {
            code.centerline == centerline && code.target_speed >= f64::from(target_speed)
        })
    }
}

/// The grammar of round 3: one call with the names of this scene, other than those that were
/// refused. After a plan that lacked nothing but progress, it names another centerline or a higher
/// speed.
pub(super) fn code(names: &Names, refused: &Refused) -> Constraint {
    let slots = |centerlines: &[CenterlineName], speeds: Vec<u32>| {
        [
            centerlines.iter().map(ToString::to_string).collect(),
            names
                .lead_agents
                .iter()
                .map(ToString::to_string)
                .chain([NO_LEAD_AGENT.to_owned()])
                .collect(),
            speeds.iter().map(ToString::to_string).collect(),
            ACCELERATIONS.iter().map(ToString::to_string).collect(),
            DECELERATIONS.iter().map(ToString::to_string).collect(),
        ]
    };
    let codes: Vec<[String; SLOTS]> = refused.codes.iter().map(filled).collect();
    let codes: Vec<&[String]> = codes.iter().map(<[String; SLOTS]>::as_slice).collect();
    let all = slots(&names.centerlines, target_speeds(names).collect());
    let other = || other_call(&all, 0, &codes).map(Constraint::Sequence);
    let faster = names.centerlines.iter().filter_map(|&centerline| {
        let speeds: Vec<u32> = target_speeds(names)
            .filter(|&speed| !refused.is_slow(centerline, speed))
            .collect();
        if speeds.is_empty() {
            return None;
        }
        let codes: Vec<&[String]> = codes
            .iter()
            .filter(|code| code.first() == Some(&centerline.to_string()))
            .copied()
            .collect();
        other_call(&slots(&[centerline], speeds), 0, &codes).map(Constraint::Sequence)
    });
    let faster: Vec<Constraint> = if refused.slow.is_empty() {
        Vec::new()
    } else {
        faster.collect()
    };
    if faster.is_empty() {
        // Where every code was refused, one has to be repeated.
        return other().unwrap_or_else(|| Constraint::Sequence(call(&all, 0).collect()));
    }
    Constraint::OneOf(faster)
}

/// Arguments of a code.
const SLOTS: usize = 5;
/// The text before each argument, and behind the last.
const AROUND: [&str; SLOTS + 1] = ["(c=", ", la=", ", v0=", ", acc=", ", dec=", ")"];

/// The arguments of a code as the grammar writes them.
fn filled(code: &PlannerCode) -> [String; SLOTS] {
    let PlannerCode {
        centerline,
        lead_agent,
        target_speed,
        accel_max,
        decel_max,
    } = code;
    let lead_agent = lead_agent.map_or_else(|| NO_LEAD_AGENT.to_owned(), |name| name.to_string());
    [
        centerline.to_string(),
        lead_agent,
        target_speed.to_string(),
        accel_max.to_string(),
        decel_max.to_string(),
    ]
}

/// The text before an argument, or behind the last.
fn around(slot: usize) -> Constraint {
    let function = if slot == 0 { FUNCTION } else { "" };
    text(format!(
        "{function}{}",
        AROUND
            .get(slot)
            .copied()
            .expect("texts stand around all arguments")
    ))
}

/// A call from an argument on.
fn call(slots: &[Vec<String>], slot: usize) -> impl Iterator<Item = Constraint> + '_ {
    let rest = slots.iter().enumerate().skip(slot);
    rest.flat_map(|(slot, values)| [around(slot), any_of(values)])
        .chain([around(slots.len())])
}

/// A call from an argument on that differs from each of these; `None` where there is none.
fn other_call(
    slots: &[Vec<String>],
    slot: usize,
    refused: &[&[String]],
) -> Option<Vec<Constraint>> {
    if refused.is_empty() {
        return Some(call(slots, slot).collect());
    }
    let values = slots.get(slot)?;
    let is_refused = |value: &&String| refused.iter().any(|code| code.first() == Some(value));
    let (same, other): (Vec<&String>, Vec<&String>) = values.iter().partition(is_refused);
    let mut alternatives = Vec::new();
    if !other.is_empty() {
        alternatives.push([vec![any_of(other)], call(slots, slot + 1).collect()].concat());
    }
    for value in same {
        let begun = refused
            .iter()
            .filter_map(|code| code.split_first().filter(|(first, _)| *first == value));
        let rests: Vec<&[String]> = begun.map(|(_, rest)| rest).collect();
        alternatives.extend(
            other_call(slots, slot + 1, &rests).map(|rest| [vec![text(value)], rest].concat()),
        );
    }
    // The text behind a value belongs to its alternative.
    (!alternatives.is_empty()).then(|| {
        vec![
            around(slot),
            Constraint::OneOf(alternatives.into_iter().map(Constraint::Sequence).collect()),
        ]
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn the_code_grammar_offers_the_names_of_the_scene() {
        let names = Names {
            centerlines: vec![CenterlineName::EgoLane],
            lead_agents: vec!["vehicle1".parse().unwrap()],
            speed_limit: Some(2),
        };
        let Constraint::Sequence(parts) = code(&names, &Refused::default()) else {
            panic!("not a sequence")
        };
        for offered in [&["0", "1", "2"][..], &["ego_lane"], &["vehicle1", "None"]] {
            assert!(parts.contains(&any_of(offered)), "{offered:?}: {parts:?}");
        }
    }

    /// All texts of a constraint without regular expressions.
    fn texts(constraint: &Constraint) -> BTreeSet<String> {
        match constraint {
            Constraint::Choice(texts) => texts.iter().cloned().collect(),
            Constraint::OneOf(alternatives) => alternatives.iter().flat_map(texts).collect(),
            Constraint::Sequence(parts) => {
                parts
                    .iter()
                    .fold(BTreeSet::from([String::new()]), |before, part| {
                        let ends = texts(part);
                        before
                            .iter()
                            .flat_map(|text| ends.iter().map(move |end| format!("{text}{end}")))
                            .collect()
                    })
            }
            other => panic!("{other:?} is not finite"),
        }
    }

    #[test]
    fn the_code_grammar_allows_every_code_but_the_refused_ones() {
        let names = Names {
            centerlines: vec![CenterlineName::EgoLane, CenterlineName::LeftLane],
            lead_agents: vec!["vehicle1".parse().unwrap()],
            speed_limit: Some(3),
        };
        let all = texts(&code(&names, &Refused::default()));
        assert_eq!(
            all.len(),
            2 * 2 * 4 * ACCELERATIONS.len() * DECELERATIONS.len()
        );
        let of = |line: &str| super::super::parse(line, &names).answer.unwrap();
        let mut refused = Vec::new();
        for line in all.iter().step_by(7).chain(all.iter().take(9)) {
            refused.push(of(line));
            let left = texts(&code(
                &names,
                &Refused {
                    codes: refused.clone(),
                    slow: Vec::new(),
                },
            ));
            let expected: BTreeSet<String> = all
                .iter()
                .filter(|line| !refused.contains(&of(line)))
                .cloned()
                .collect();
            assert_eq!(left, expected, "without {refused:?}");
        }
        let every = Refused {
            codes: all.iter().map(|line| of(line)).collect(),
            slow: Vec::new(),
        };
        assert_eq!(
            texts(&code(&names, &every)),
            all,
            "a refused code is repeated where there is no other"
        );
    }

    #[test]
    fn after_a_plan_that_lacked_only_progress_the_code_names_another_lane_or_a_higher_speed() {
        let names = |centerlines| Names {
            centerlines,
            lead_agents: Vec::new(),
            speed_limit: Some(3),
        };
        let both = names(vec![CenterlineName::EgoLane, CenterlineName::LeftLane]);
        let of = |line: &str| super::super::parse(line, &both).answer.unwrap();
        let all = texts(&code(&both, &Refused::default()));
        let refused = |v0: u32| {
            let slow = of(&format!(
                "Generate_IDM_Planner(c=ego_lane, la=None, v0={v0}, acc=1.5, dec=3)"
            ));
            Refused {
                codes: vec![slow],
                slow: vec![slow],
            }
        };
        for v0 in 0..=3 {
            let left = texts(&code(&both, &refused(v0)));
            let is_faster = |code: PlannerCode| {
                code.centerline == CenterlineName::LeftLane || code.target_speed > f64::from(v0)
            };
            let expected: BTreeSet<String> = all
                .iter()
                .filter(|line| is_faster(of(line)))
                .cloned()
                .collect();
            assert_eq!(left, expected, "after v0={v0}");
        }
        let only = names(vec![CenterlineName::EgoLane]);
        let (any, left) = (
            texts(&code(&only, &Refused::default())),
            texts(&code(&only, &refused(3))),
        );
        assert_eq!(
            left.len() + 1,
            any.len(),
            "no other lane is there: all but the refused code"
        );
    }
}
