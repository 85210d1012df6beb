//! Reads a call of a known function from a model's answer. Reading never fails: it gives the
//! arguments that were read and a list of errors with their place.

use super::code::Range as NumberRange;
use super::code_lexer::{Spanned, Token, tokens};
use std::fmt;
use std::ops::Range;

/// An error in an answer.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize, schemars::JsonSchema)]
pub struct ParseError {
    /// The wrong bytes of the answer; an empty range at the end when something is missing.
    pub span: Range<usize>,
    /// What is wrong.
    pub message: String,
    /// How to correct it.
    pub hint: String,
}

/// Begins the message about an answer without a call.
const NO_CALL: &str = "no call of";

impl ParseError {
    /// Whether the answer has no call of the function at all.
    pub(crate) fn is_of_no_call(&self) -> bool {
        self.message.starts_with(NO_CALL)
    }
}

impl fmt::Display for ParseError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} (characters {} to {}); {}",
            self.message, self.span.start, self.span.end, self.hint
        )
    }
}

/// A function that a model may call.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Signature<'a> {
    pub(super) function: &'a str,
    pub(super) parameters: &'a [&'a str],
}

impl fmt::Display for Signature<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}({})", self.function, self.parameters.join(", "))
    }
}

/// A value given for one parameter.
#[derive(Debug, Clone)]
pub(super) struct Argument {
    pub(super) value: Token,
    pub(super) span: Range<usize>,
}

/// A call whose arguments are taken one by one.
pub(super) struct Call<'a> {
    signature: Signature<'a>,
    /// By parameter.
    arguments: Vec<Option<Argument>>,
    /// Length of the whole text.
    end: usize,
    errors: Vec<ParseError>,
}

impl<'a> Call<'a> {
    /// Finds the last call of the function in `text`: a model that reasons aloud may write drafts
    /// first.
    pub(super) fn find(text: &str, signature: Signature<'a>) -> Result<Self, ParseError> {
        let tokens = tokens(text);
        let is_name = |s: &Spanned| matches!(&s.token, Token::Word(w) if w.eq_ignore_ascii_case(signature.function));
        let end = text.len();
        let Some(place) = tokens.iter().rposition(is_name) else {
            let message = format!("{NO_CALL} {}", signature.function);
            return Err(ParseError {
                span: end..end,
                message,
                hint: format!("write one line {signature}"),
            });
        };
        let mut call = Self {
            signature,
            arguments: vec![None; signature.parameters.len()],
            end,
            errors: Vec::new(),
        };
        call.read(&tokens[place + 1..]);
        Ok(call)
    }

    /// The arguments, positional or by name.
    fn read(&mut self, tokens: &[Spanned]) {
        let Self { signature, end, .. } = *self;
        let Some(Spanned {
            token: Token::Open, ..
        }) = tokens.first()
        else {
            let span = tokens.first().map_or(end..end, |s| s.span.clone());
            self.fail(
                span,
                "expected '(' after the function name".to_owned(),
                format!("write {signature}"),
            );
            return;
        };
        let inside = &tokens[1..];
        let close = inside.iter().position(|s| s.token == Token::Close);
        if close.is_none() {
            self.fail(
                end..end,
                "the call is not closed".to_owned(),
                "end it with ')'".to_owned(),
            );
        }
        let inside = &inside[..close.unwrap_or(inside.len())];
        for (place, part) in inside.split(|s| s.token == Token::Comma).enumerate() {
            let Some(first) = part.first() else { continue };
            let span = first.span.start..part[part.len() - 1].span.end;
            let (slot, value) = match part {
                [
                    Spanned {
                        token: Token::Word(name),
                        ..
                    },
                    Spanned {
                        token: Token::Equals,
                        ..
                    },
                    value @ ..,
                ] => (
                    signature
                        .parameters
                        .iter()
                        .position(|p| p.eq_ignore_ascii_case(name)),
                    value,
                ),
                value => ((place < signature.parameters.len()).then_some(place), value),
            };
            // A wrong argument does not end the reading: the model should hear of all faults at
            // once.
            match (slot, value) {
                (Some(slot), [Spanned { token, span }]) if self.arguments[slot].is_none() => {
                    self.arguments[slot] = Some(Argument {
                        value: token.clone(),
                        span: span.clone(),
                    });
                }
                (Some(slot), [_]) => {
                    let message = format!("{} is given twice", signature.parameters[slot]);
                    self.fail(span, message, "give each parameter once".to_owned());
                }
                (Some(slot), _) => {
                    let message =
                        format!("{} is not one name or number", signature.parameters[slot]);
                    self.fail(
                        span,
                        message,
                        "give a plain name or number, no expression".to_owned(),
                    );
                }
                (None, _) => {
                    let hint = format!("the parameters are {}", signature.parameters.join(", "));
                    self.fail(
                        span,
                        "this is no parameter of the function".to_owned(),
                        hint,
                    );
                }
            }
        }
    }

    fn fail(&mut self, span: Range<usize>, message: String, hint: String) {
        self.errors.push(ParseError {
            span,
            message,
            hint,
        });
    }

    /// Takes the argument of a parameter; a missing one is an error.
    pub(super) fn take(&mut self, parameter: &str) -> Option<Argument> {
        let given = self.given(parameter);
        if given.is_none() {
            let hint = format!(
                "the call needs all of {}",
                self.signature.parameters.join(", ")
            );
            self.fail(self.end..self.end, format!("{parameter} is missing"), hint);
        }
        given
    }

    fn given(&mut self, parameter: &str) -> Option<Argument> {
        let slot = self
            .signature
            .parameters
            .iter()
            .position(|p| *p == parameter)?;
        self.arguments[slot].take()
    }

    /// Whether a parameter was given as this word.
    pub(super) fn is(&self, parameter: &str, word: &str) -> bool {
        let mut given = self
            .signature
            .parameters
            .iter()
            .zip(&self.arguments)
            .filter(|(name, _)| **name == parameter);
        given.any(|(_, argument)| {
            matches!(argument, Some(Argument { value: Token::Word(given), .. }) if given.eq_ignore_ascii_case(word))
        })
    }

    /// Takes one of the `known` names. The hint of an error names `other` too.
    pub(super) fn name<T: Copy + fmt::Display>(
        &mut self,
        parameter: &str,
        known: &[T],
        other: Option<&str>,
    ) -> Option<T> {
        let Argument { value, span } = self.take(parameter)?;
        let message = match value {
            Token::Word(word) => match known
                .iter()
                .find(|name| name.to_string().eq_ignore_ascii_case(&word))
            {
                Some(name) => return Some(*name),
                None => format!("{parameter} names '{word}', which is not in the scene"),
            },
            _ => format!("{parameter} is not a name"),
        };
        let allowed: Vec<String> = known
            .iter()
            .map(T::to_string)
            .chain(other.map(str::to_owned))
            .collect();
        self.fail(
            span,
            message,
            format!("the scene has {}", allowed.join(", ")),
        );
        None
    }

    /// Takes one of these words; gives its index.
    pub(super) fn word(&mut self, parameter: &str, words: &[&str]) -> Option<usize> {
        let Argument { value, span } = self.take(parameter)?;
        let place = match &value {
            Token::Word(word) => words
                .iter()
                .position(|known| known.eq_ignore_ascii_case(word)),
            _ => None,
        };
        if place.is_none() {
            self.fail(
                span,
                format!("{parameter} is none of its words"),
                format!("it is one of {}", words.join(", ")),
            );
        }
        place
    }

    /// Takes a number in a range.
    pub(super) fn number(&mut self, parameter: &str, range: NumberRange) -> Option<f64> {
        self.number_of(parameter, range, |value| value)
    }

    /// Takes the magnitude of a number: models write decelerations with either sign.
    pub(super) fn magnitude(&mut self, parameter: &str, range: NumberRange) -> Option<f64> {
        self.number_of(parameter, range, f64::abs)
    }

    fn number_of(
        &mut self,
        parameter: &str,
        range: NumberRange,
        meant: fn(f64) -> f64,
    ) -> Option<f64> {
        let Argument { value, span } = self.take(parameter)?;
        let message = match value {
            Token::Number(value) if range.contains(meant(value)) => return Some(meant(value)),
            Token::Number(value) => format!("{parameter} = {} is out of range", meant(value)),
            _ => format!("{parameter} is not a number"),
        };
        self.fail(span, message, format!("{parameter} must lie in {range}"));
        None
    }

    /// All errors, in order of place.
    pub(super) fn into_errors(mut self) -> Vec<ParseError> {
        self.errors
            .sort_by_key(|error| (error.span.start, error.span.end));
        self.errors
    }
}
