//! Constraints in the grammar languages of servers: llama.cpp's GBNF, and regular expressions with
//! plain groups and without anchors, which all of them know.

use crate::Constraint;
use regex_syntax::hir::{Class, ClassUnicode, Hir, HirKind};

/// Characters with a special meaning in a regular expression.
const META: &str = r"\^$.|?*+()[]{}";

/// A constraint as an unanchored regular expression that the whole answer must match.
pub(super) fn pattern(constraint: &Constraint) -> Result<String, String> {
    match constraint {
        Constraint::Choice(texts) if texts.is_empty() => Err("the choice is empty".into()),
        Constraint::Choice(texts) => match texts.as_slice() {
            [only] => Ok(literal_pattern(only)),
            several => Ok(format!(
                "({})",
                several
                    .iter()
                    .map(|t| literal_pattern(t))
                    .collect::<Vec<_>>()
                    .join("|")
            )),
        },
        Constraint::Regex(pattern) => Ok(format!("({pattern})")),
        Constraint::Sequence(parts) => parts.iter().map(pattern).collect(),
        Constraint::OneOf(parts) if parts.is_empty() => Err("the choice is empty".into()),
        Constraint::OneOf(parts) => Ok(format!(
            "({})",
            parts
                .iter()
                .map(pattern)
                .collect::<Result<Vec<_>, _>>()?
                .join("|")
        )),
        Constraint::Free | Constraint::Lark(_) => Err(NOT_REGULAR.into()),
    }
}

/// A constraint as a GBNF grammar.
///
/// # Errors
/// As [`pattern`], or when a regular expression has anchors, look-around or bytes that are not
/// UTF-8.
pub(super) fn gbnf(constraint: &Constraint) -> Result<String, String> {
    Ok(format!("root ::= {}", expression(constraint)?))
}

const NOT_REGULAR: &str =
    "a server accepts only choices, regular expressions and sequences of these";

fn literal_pattern(text: &str) -> String {
    let mut pattern = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '\n' => pattern.push_str("\\n"),
            '\r' => pattern.push_str("\\r"),
            '\t' => pattern.push_str("\\t"),
            character => {
                if META.contains(character) {
                    pattern.push('\\');
                }
                pattern.push(character);
            }
        }
    }
    pattern
}

fn expression(constraint: &Constraint) -> Result<String, String> {
    match constraint {
        Constraint::Choice(texts) if texts.is_empty() => Err("the choice is empty".into()),
        Constraint::Choice(texts) => Ok(alternatives(texts.iter().map(|text| quoted(text)))),
        Constraint::Regex(pattern) => {
            let parsed =
                regex_syntax::parse(pattern).map_err(|error| last_line(&error.to_string()))?;
            regular(&parsed)
        }
        Constraint::Sequence(parts) => Ok(parts
            .iter()
            .map(expression)
            .collect::<Result<Vec<_>, _>>()?
            .join(" ")),
        Constraint::OneOf(parts) if parts.is_empty() => Err("the choice is empty".into()),
        Constraint::OneOf(parts) => Ok(alternatives(
            parts
                .iter()
                .map(expression)
                .collect::<Result<Vec<_>, _>>()?,
        )),
        Constraint::Free | Constraint::Lark(_) => Err(NOT_REGULAR.into()),
    }
}

/// A parsed regular expression in GBNF.
fn regular(hir: &Hir) -> Result<String, String> {
    // One match over all kinds, so that the compiler shows what a new version of the parser adds.
    match hir.kind() {
        HirKind::Empty => Ok("\"\"".into()),
        HirKind::Literal(literal) => {
            let text = std::str::from_utf8(&literal.0)
                .map_err(|_| "GBNF has no bytes that are not UTF-8")?;
            Ok(quoted(text))
        }
        HirKind::Class(Class::Unicode(class)) => Ok(class_expression(class)),
        HirKind::Class(Class::Bytes(_)) => Err("GBNF has no byte classes".into()),
        HirKind::Look(_) => Err("GBNF has no anchors or word boundaries".into()),
        HirKind::Repetition(repetition) => {
            let count = match (repetition.min, repetition.max) {
                (min, Some(max)) if min == max => format!("{{{min}}}"),
                (min, max) => format!(
                    "{{{min},{}}}",
                    max.map(|max| max.to_string()).unwrap_or_default()
                ),
            };
            Ok(format!("({}){count}", regular(&repetition.sub)?))
        }
        HirKind::Capture(capture) => regular(&capture.sub),
        HirKind::Concat(parts) => Ok(parts
            .iter()
            .map(regular)
            .collect::<Result<Vec<_>, _>>()?
            .join(" ")),
        HirKind::Alternation(parts) => Ok(alternatives(
            parts.iter().map(regular).collect::<Result<Vec<_>, _>>()?,
        )),
    }
}

/// Writes a class as ranges. A class with the character 0 is written negated, because llama.cpp
/// ends a text there.
fn class_expression(class: &ClassUnicode) -> String {
    let negated = class
        .ranges()
        .first()
        .is_some_and(|range| range.start() == '\0');
    let mut shown = class.clone();
    if negated {
        shown.negate();
        if shown.ranges().is_empty() {
            return "[^\\x00]".into();
        }
    }
    let ranges = shown.ranges().iter().map(|range| {
        let (first, last) = (class_character(range.start()), class_character(range.end()));
        if range.start() == range.end() {
            first
        } else {
            format!("{first}-{last}")
        }
    });
    format!(
        "[{}{}]",
        if negated { "^" } else { "" },
        ranges.collect::<String>()
    )
}

fn class_character(character: char) -> String {
    if character.is_ascii_alphanumeric() {
        character.to_string()
    } else {
        format!("\\U{:08X}", character as u32)
    }
}

fn quoted(text: &str) -> String {
    let mut quoted = String::from('"');
    for character in text.chars() {
        match character {
            '"' => quoted.push_str("\\\""),
            '\\' => quoted.push_str("\\\\"),
            '\n' => quoted.push_str("\\n"),
            '\r' => quoted.push_str("\\r"),
            '\t' => quoted.push_str("\\t"),
            character if character.is_control() => quoted.push_str(&class_character(character)),
            character => quoted.push(character),
        }
    }
    quoted.push('"');
    quoted
}

fn alternatives(parts: impl IntoIterator<Item = String>) -> String {
    format!("({})", parts.into_iter().collect::<Vec<_>>().join(" | "))
}

fn last_line(text: &str) -> String {
    text.lines().last().unwrap_or_default().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn choice(texts: &[&str]) -> Constraint {
        Constraint::Choice(texts.iter().map(ToString::to_string).collect())
    }

    fn code() -> Constraint {
        Constraint::Sequence(vec![
            choice(&["Plan(c="]),
            choice(&["ego_lane", "left [1]"]),
            choice(&[")\n"]),
            Constraint::Regex("[A-Za-z][^\\n]{2,16}".into()),
        ])
    }

    #[test]
    fn a_pattern_matches_what_the_constraint_means() {
        let pattern = pattern(&code()).unwrap();
        assert_eq!(
            pattern,
            r"Plan\(c=(ego_lane|left \[1\])\)\n([A-Za-z][^\n]{2,16})"
        );
        let whole = regex::Regex::new(&format!("^(?:{pattern})$")).unwrap();
        assert!(whole.is_match("Plan(c=left [1])\nbecause"));
        assert!(
            !whole.is_match("Plan(c=right)\nbecause") && !whole.is_match("Plan(c=ego_lane)\nbe")
        );
    }

    #[test]
    fn gbnf_is_written_as_llama_cpp_reads_it() {
        let expected = r#"root ::= ("Plan(c=") ("ego_lane" | "left [1]") (")\n") [A-Za-z] ([^\U0000000A]){2,16}"#;
        assert_eq!(gbnf(&code()).unwrap(), expected);
        let of = |pattern: &str| gbnf(&Constraint::Regex(pattern.into()));
        assert_eq!(
            of(r#"(yes|no)+ "x"?"#).unwrap(),
            r#"root ::= (("yes" | "no")){1,} " \"x" ("\""){0,1}"#
        );
        assert_eq!(of("a{3}(?s:.)").unwrap(), r#"root ::= ("a"){3} [^\x00]"#);
        assert_eq!(
            gbnf(&choice(&["a \"b\" \\ \u{1} ü"])).unwrap(),
            r#"root ::= ("a \"b\" \\ \U00000001 ü")"#
        );
    }

    #[test]
    fn what_cannot_be_written_is_an_error() {
        for constraint in [
            Constraint::Free,
            Constraint::Lark("start: \"a\"".into()),
            choice(&[]),
        ] {
            assert!(
                pattern(&constraint).is_err() && gbnf(&constraint).is_err(),
                "{constraint:?}"
            );
        }
        for regex in ["^a", r"\bword", "(unclosed", r"(?-u)\xFF"] {
            assert!(gbnf(&Constraint::Regex(regex.into())).is_err(), "{regex}");
        }
    }
}
