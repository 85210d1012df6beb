//! A call as a model writes it: `name(argument, name=argument)`.

use super::{Parameter, REACH, Tool};
use crate::agent::beginning;
use crate::waypoints::{any_of, text};
use planagent_mllm::Constraint;

/// Objects that a call may name under the grammar: the nearest.
const NAMED_OBJECTS: usize = 8;
/// Places that a call may name under the grammar.
const NAMED_PLACES: usize = 2;

/// Objects or places that a call may name at all: an answer of a server can be long.
const MAX_NAMED: usize = 64;

/// A call.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Call {
    pub(super) function: String,
    /// The arguments as they were written.
    pub(super) text: String,
    pub(super) arguments: Vec<Argument>,
}

/// An argument, with its name where one was written.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Argument {
    pub(super) name: Option<String>,
    pub(super) text: String,
}

/// Reads the one call of an answer.
pub(super) fn read(answer: &str) -> Result<Call, String> {
    let answer = answer.trim();
    let (function, rest) = answer
        .split_once('(')
        .ok_or_else(|| format!("'{}' is no call; write name(arguments)", beginning(answer)))?;
    let function = function.trim();
    if function.is_empty()
        || !function
            .chars()
            .all(|c| c.is_ascii_alphanumeric() || c == '_')
    {
        return Err(format!("'{}' is no name of a tool", beginning(function)));
    }
    let close = closing(rest).ok_or("the call is not closed")?;
    let (inside, behind) = rest.split_at(close);
    // Each question gets one result, so a second call would be lost without a word.
    if behind[1..].contains('(') {
        return Err("call one tool, not several".to_owned());
    }
    let arguments = split(inside)
        .ok_or("an argument is empty")?
        .into_iter()
        .map(|part| match part.split_once('=') {
            Some((name, value)) => Argument {
                name: Some(name.trim().to_owned()),
                text: value.trim().to_owned(),
            },
            None => Argument {
                name: None,
                text: part.trim().to_owned(),
            },
        })
        .collect();
    Ok(Call {
        function: function.to_owned(),
        text: inside.trim().to_owned(),
        arguments,
    })
}

/// Where the bracket that is open before a text closes.
fn closing(text: &str) -> Option<usize> {
    let mut depth = 0_usize;
    for (at, c) in text.char_indices() {
        match c {
            '(' | '[' => depth += 1,
            ')' if depth == 0 => return Some(at),
            ')' | ']' => depth = depth.saturating_sub(1),
            _ => {}
        }
    }
    None
}

/// The parts between commas that no bracket holds; none of a blank text. `None` where a part among
/// others is blank.
fn split(text: &str) -> Option<Vec<&str>> {
    if text.trim().is_empty() {
        return Some(Vec::new());
    }
    let (mut parts, mut depth, mut start) = (Vec::new(), 0_usize, 0);
    for (at, c) in text.char_indices() {
        match c {
            '(' | '[' => depth += 1,
            ')' | ']' => depth = depth.saturating_sub(1),
            ',' if depth == 0 => {
                parts.push(&text[start..at]);
                start = at + 1;
            }
            _ => {}
        }
    }
    parts.push(&text[start..]);
    let is_whole = parts.iter().all(|part| !part.trim().is_empty());
    is_whole.then_some(parts)
}

/// The next argument, which must be that of a parameter.
pub(super) fn take(
    given: &mut impl Iterator<Item = Argument>,
    parameter: &str,
) -> Result<Argument, String> {
    let argument = given
        .next()
        .ok_or_else(|| format!("{parameter} is missing"))?;
    match &argument.name {
        Some(name) if name != parameter => Err(format!(
            "'{}' stands where {parameter} is expected",
            beginning(name)
        )),
        _ => Ok(argument),
    }
}

pub(super) fn number(argument: &Argument, parameter: &str) -> Result<f64, String> {
    finite(&argument.text)
        .ok_or_else(|| format!("{parameter} = '{}' is no number", beginning(&argument.text)))
}

/// A list of numbers.
pub(super) fn numbers(argument: &Argument) -> Result<Vec<f64>, String> {
    let wrong = || format!("'{}' is no list of numbers", beginning(&argument.text));
    listed(argument, &wrong)?
        .into_iter()
        .map(|part| finite(part).ok_or_else(wrong))
        .collect()
}

/// A list of places.
pub(super) fn places(argument: &Argument) -> Result<Vec<(f64, f64)>, String> {
    let wrong = || format!("'{}' is no list of places", beginning(&argument.text));
    listed(argument, &wrong)?
        .into_iter()
        .map(|part| {
            let pair = part.trim();
            let inside = match pair.strip_prefix('(') {
                Some(open) => open.strip_suffix(')'),
                None => inside(pair),
            };
            let (x, y) = inside
                .and_then(|pair| pair.split_once(','))
                .ok_or_else(wrong)?;
            finite(x).zip(finite(y)).ok_or_else(wrong)
        })
        .collect()
}

/// The parts of a list.
fn listed<'a>(argument: &'a Argument, wrong: &dyn Fn() -> String) -> Result<Vec<&'a str>, String> {
    let parts = inside(&argument.text).and_then(split).ok_or_else(wrong)?;
    match parts.len() {
        0 => Err("the list is empty".to_owned()),
        count if count > MAX_NAMED => Err(format!(
            "the list has {count} parts, and {MAX_NAMED} are the limit"
        )),
        _ => Ok(parts),
    }
}

fn finite(text: &str) -> Option<f64> {
    let value: Option<f64> = text.trim().parse().ok();
    value.filter(|value| value.is_finite())
}

/// What a list holds.
fn inside(text: &str) -> Option<&str> {
    text.trim().strip_prefix('[')?.strip_suffix(']')
}

/// One of these calls, with arguments that can be right.
pub(super) fn grammar(tools: impl Iterator<Item = &'static Tool>, objects: usize) -> Constraint {
    let possible =
        tools.filter(|tool| objects > 0 || !tool.parameters.contains(&Parameter::ObjectIds));
    Constraint::OneOf(possible.map(|tool| call(tool, objects)).collect())
}

fn call(tool: &Tool, objects: usize) -> Constraint {
    let mut parts = vec![text(format!("{}(", tool.name))];
    for (i, parameter) in tool.parameters.iter().enumerate() {
        if i > 0 {
            parts.push(text(", "));
        }
        parts.extend(argument(*parameter, objects));
    }
    parts.push(text(")"));
    Constraint::Sequence(parts)
}

fn argument(parameter: Parameter, objects: usize) -> Vec<Constraint> {
    let reach = REACH as i64;
    let meters = |range: std::ops::RangeInclusive<i64>| any_of(range.map(|m| m.to_string()));
    // One match, the counterpart of `Tools::arguments`: an arm allows what that function reads.
    match parameter {
        Parameter::Area => vec![
            text("x_start="),
            meters(-reach..=0),
            text(", x_end="),
            meters(0..=reach),
            text(", y_start="),
            meters(-reach..=0),
            text(", y_end="),
            meters(0..=reach),
        ],
        Parameter::ObjectIds => {
            let id = || any_of((0..objects.clamp(1, NAMED_OBJECTS)).map(|id| id.to_string()));
            let two = Constraint::Sequence(vec![id(), text(", "), id()]);
            vec![
                text("object_ids=["),
                Constraint::OneOf(vec![id(), two]),
                text("]"),
            ]
        }
        Parameter::Timestep(first, last) => vec![text("timestep="), meters(first..=last)],
        Parameter::Locations => {
            let place = || {
                Constraint::Sequence(vec![
                    text("("),
                    meters(-reach..=reach),
                    text(","),
                    meters(-reach..=reach),
                    text(")"),
                ])
            };
            let several = (1..=NAMED_PLACES).map(|count| {
                let mut parts = vec![place()];
                parts.extend((1..count).flat_map(|_| [text(", "), place()]));
                Constraint::Sequence(parts)
            });
            vec![
                text("locations=["),
                Constraint::OneOf(several.collect()),
                text("]"),
            ]
        }
    }
}
