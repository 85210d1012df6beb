//! Reads planner code out of a model's answer. Reading never fails: it gives what was understood and a list of errors with
//! their place; the errors go into the rethink prompt and are counted.

use super::code::{ACCEL_MAX, DECEL_MAX, FUNCTION, Names, PlannerCode, Range as NumberRange, TARGET_SPEED};
use super::code_lexer::{Spanned, Token, tokens};
use std::fmt;
use std::ops::Range;

/// One thing wrong with an answer.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ParseError {
    /// Bytes of the answer that are meant; empty at the end of the text when something is missing.
    pub span: Range<usize>,
    /// What is wrong.
    pub message: String,
    /// What would be right.
    pub hint: String,
}

impl fmt::Display for ParseError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} (characters {} to {}); {}", self.message, self.span.start, self.span.end, self.hint)
    }
}

/// What was understood of an answer, and what not. A code is given only when all five arguments were understood.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Parsed {
    /// The planner, when the answer holds a whole one.
    pub code: Option<PlannerCode>,
    /// Everything that is wrong, in order of place.
    pub errors: Vec<ParseError>,
}

/// The parameters of the call, in order.
const PARAMETERS: [&str; 5] = ["c", "la", "v0", "acc", "dec"];

/// Reads the last call of the function in `text`; names are checked against those of the scene.
///
/// A model that reasons aloud may write drafts first, so the last call counts.
pub fn parse(text: &str, names: &Names) -> Parsed {
    let tokens = tokens(text);
    let Some(call) = last_call(&tokens) else {
        let span = text.len()..text.len();
        let hint = format!("write one line {FUNCTION}(c, la, v0, acc, dec)");
        return Parsed {
            code: None,
            errors: vec![ParseError { span, message: format!("no call of {FUNCTION}"), hint }],
        };
    };
    let mut errors = Vec::new();
    let arguments = arguments(&tokens[call..], text.len(), &mut errors);
    let code = understand(arguments, names, text.len(), &mut errors);
    errors.sort_by_key(|error| (error.span.start, error.span.end));
    Parsed { code, errors }
}

/// Place of the token after the last function name.
fn last_call(tokens: &[Spanned]) -> Option<usize> {
    let is_name = |s: &Spanned| matches!(&s.token, Token::Word(w) if w.eq_ignore_ascii_case(FUNCTION));
    tokens.iter().rposition(is_name).map(|place| place + 1)
}

/// A value given for one parameter.
#[derive(Debug, Clone)]
struct Argument {
    value: Token,
    span: Range<usize>,
}

/// The arguments by parameter, positional or by name.
fn arguments(tokens: &[Spanned], end: usize, errors: &mut Vec<ParseError>) -> [Option<Argument>; 5] {
    let mut given: [Option<Argument>; 5] = Default::default();
    let Some(Spanned { token: Token::Open, .. }) = tokens.first() else {
        let span = tokens.first().map_or(end..end, |s| s.span.clone());
        errors.push(ParseError {
            span,
            message: "expected '(' after the function name".to_owned(),
            hint: format!("write {FUNCTION}(c, la, v0, acc, dec)"),
        });
        return given;
    };
    let inside = &tokens[1..];
    let close = inside.iter().position(|s| s.token == Token::Close);
    if close.is_none() {
        errors.push(ParseError {
            span: end..end,
            message: "the call is not closed".to_owned(),
            hint: "end it with ')'".to_owned(),
        });
    }
    let inside = &inside[..close.unwrap_or(inside.len())];
    for (place, part) in inside.split(|s| s.token == Token::Comma).enumerate() {
        let Some(first) = part.first() else { continue };
        let span = first.span.start..part[part.len() - 1].span.end;
        let (slot, value) = match part {
            [Spanned { token: Token::Word(name), .. }, Spanned { token: Token::Equals, .. }, value @ ..] => {
                (parameter(name), value)
            }
            value => ((place < PARAMETERS.len()).then_some(place), value),
        };
        match (slot, value) {
            (Some(slot), [Spanned { token, span }]) if given[slot].is_none() => {
                given[slot] = Some(Argument { value: token.clone(), span: span.clone() });
            }
            (Some(slot), [_]) => errors.push(ParseError {
                span,
                message: format!("{} is given twice", PARAMETERS[slot]),
                hint: "give each parameter once".to_owned(),
            }),
            (Some(slot), _) => errors.push(ParseError {
                span,
                message: format!("{} is not one name or number", PARAMETERS[slot]),
                hint: "give a plain name or number, no expression".to_owned(),
            }),
            (None, _) => errors.push(ParseError {
                span,
                message: "this is no parameter of the function".to_owned(),
                hint: format!("the parameters are {}", PARAMETERS.join(", ")),
            }),
        }
    }
    given
}

fn parameter(name: &str) -> Option<usize> {
    PARAMETERS.iter().position(|p| p.eq_ignore_ascii_case(name))
}

fn understand(
    arguments: [Option<Argument>; 5],
    names: &Names,
    end: usize,
    errors: &mut Vec<ParseError>,
) -> Option<PlannerCode> {
    let [c, la, v0, acc, dec] = arguments;
    let centerline = known_name("c", c, &names.centerlines, end, errors);
    let leader = match la {
        Some(Argument { value: Token::Word(word), .. }) if word.eq_ignore_ascii_case("none") => Some(None),
        la => known_name("la", la, &names.leaders, end, errors).map(Some),
    };
    let target_speed = number("v0", v0, TARGET_SPEED, end, errors);
    let accel_max = number("acc", acc, ACCEL_MAX, end, errors);
    // Some write the deceleration as a negative acceleration; its magnitude is meant.
    let dec = dec.map(|argument| match argument.value {
        Token::Number(value) => Argument { value: Token::Number(value.abs()), ..argument },
        _ => argument,
    });
    let decel_max = number("dec", dec, DECEL_MAX, end, errors);
    Some(PlannerCode {
        centerline: centerline?,
        leader: leader?,
        target_speed: target_speed?,
        accel_max: accel_max?,
        decel_max: decel_max?,
    })
}

fn missing(parameter: &str, end: usize, errors: &mut Vec<ParseError>) {
    errors.push(ParseError {
        span: end..end,
        message: format!("{parameter} is missing"),
        hint: format!("the call needs all of {}", PARAMETERS.join(", ")),
    });
}

fn known_name(
    parameter: &str,
    argument: Option<Argument>,
    known: &[String],
    end: usize,
    errors: &mut Vec<ParseError>,
) -> Option<String> {
    let Some(Argument { value, span }) = argument else {
        missing(parameter, end, errors);
        return None;
    };
    let message = match value {
        Token::Word(word) => match known.iter().find(|name| name.eq_ignore_ascii_case(&word)) {
            Some(name) => return Some(name.clone()),
            None => format!("{parameter} names '{word}', which is not in the scene"),
        },
        _ => format!("{parameter} is not a name"),
    };
    let allowed = if parameter == "la" { [known, &["None".to_owned()]].concat() } else { known.to_vec() };
    errors.push(ParseError { span, message, hint: format!("the scene has {}", allowed.join(", ")) });
    None
}

fn number(
    parameter: &str,
    argument: Option<Argument>,
    range: NumberRange,
    end: usize,
    errors: &mut Vec<ParseError>,
) -> Option<f64> {
    let Some(Argument { value, span }) = argument else {
        missing(parameter, end, errors);
        return None;
    };
    let message = match value {
        Token::Number(value) if range.contains(value) => return Some(value),
        Token::Number(value) => format!("{parameter} = {value} is out of range"),
        _ => format!("{parameter} is not a number"),
    };
    errors.push(ParseError { span, message, hint: format!("{parameter} must lie in {range}") });
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn names() -> Names {
        Names {
            centerlines: ["ego_lane", "left_lane"].map(String::from).to_vec(),
            leaders: ["vehicle1", "pedestrian2"].map(String::from).to_vec(),
            speed_limit: None,
        }
    }

    fn messages(text: &str) -> Vec<String> {
        parse(text, &names()).errors.into_iter().map(|error| error.message).collect()
    }

    #[test]
    fn reads_positional_named_and_quoted_arguments() {
        let expected = PlannerCode {
            centerline: "left_lane".to_owned(),
            leader: Some("vehicle1".to_owned()),
            target_speed: 8.0,
            accel_max: 1.5,
            decel_max: 3.0,
        };
        for text in [
            "Generate_IDM_Planner(left_lane, vehicle1, 8, 1.5, 3)",
            "planner = Generate_IDM_Planner(c=left_lane, la='vehicle1', v0=8.0, acc=1.5, dec=-3.0)  # slow",
            "First Generate_IDM_Planner(ego_lane, None, 1, 1, 1)\nno: generate_idm_planner(dec=3, acc=1.5, v0=8, la=vehicle1, c=left_lane).",
        ] {
            let parsed = parse(text, &names());
            assert_eq!(parsed.code.as_ref(), Some(&expected), "{text}: {:?}", parsed.errors);
            assert!(parsed.errors.is_empty(), "{:?}", parsed.errors);
        }
    }

    #[test]
    fn says_what_is_wrong_and_where() {
        assert_eq!(messages("drive on"), ["no call of Generate_IDM_Planner"]);
        assert_eq!(
            messages("Generate_IDM_Planner(up_lane, vehicle1, 8, 1, 3)"),
            ["c names 'up_lane', which is not in the scene"]
        );
        assert_eq!(messages("Generate_IDM_Planner(ego_lane, None, 800, 1, 3)"), ["v0 = 800 is out of range"]);
        assert_eq!(messages("Generate_IDM_Planner(ego_lane, None, 8, 1"), ["the call is not closed", "dec is missing"]);
        assert_eq!(messages("Generate_IDM_Planner(ego_lane, None, v0=8, v0=9, acc=1, dec=2)"), ["v0 is given twice"]);
        let error = &parse("x Generate_IDM_Planner(ego_lane, 7, 8, 1, 3)", &names()).errors[0];
        assert_eq!((error.span.clone(), error.message.as_str()), (33..34, "la is not a name"));
    }

    proptest! {
        #[test]
        fn any_text_is_read_without_failing(text in "\\PC*") {
            let parsed = parse(&text, &names());
            prop_assert!(parsed.code.is_some() || !parsed.errors.is_empty());
        }

        #[test]
        fn almost_code_is_read_without_failing(text in "Generate_IDM_Planner[(),=a-z0-9. \"'-]{0,40}") {
            let parsed = parse(&text, &names());
            prop_assert!(parsed.code.is_some() || !parsed.errors.is_empty());
            for error in &parsed.errors {
                prop_assert!(error.span.end <= text.len() && error.span.start <= error.span.end);
            }
        }

        #[test]
        fn printing_and_reading_are_inverse(
            c in 0usize..2, la in 0usize..3,
            target_speed in 0.0..40.0f64, accel_max in 0.1..5.0f64, decel_max in 0.1..9.0f64,
        ) {
            let names = names();
            let code = PlannerCode {
                centerline: names.centerlines[c].clone(),
                leader: names.leaders.get(la).cloned(),
                target_speed, accel_max, decel_max,
            };
            let parsed = parse(&code.to_string(), &names);
            prop_assert_eq!(parsed.errors, vec![]);
            prop_assert_eq!(parsed.code, Some(code));
        }
    }
}
