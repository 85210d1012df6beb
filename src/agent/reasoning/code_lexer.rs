//! Splits an answer into the tokens of planner code. Any text can be split.

use std::ops::Range;

/// A piece of the answer.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Token {
    /// A name, keyword or quoted string (without its quotes).
    Word(String),
    /// A number with its optional sign.
    Number(f64),
    /// `(`
    Open,
    /// `)`
    Close,
    /// `,`
    Comma,
    /// `=`
    Equals,
    /// Anything else, one character.
    Other(char),
}

/// A token and the bytes of the text it covers.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Spanned {
    pub(super) token: Token,
    pub(super) span: Range<usize>,
}

/// All tokens of a text, in order.
pub(super) fn tokens(text: &str) -> Vec<Spanned> {
    let mut found = Vec::new();
    let mut rest = text;
    while let Some(first) = rest.chars().next() {
        let start = text.len() - rest.len();
        let (token, length) = match first {
            c if c.is_whitespace() => {
                rest = &rest[c.len_utf8()..];
                continue;
            }
            '(' => (Token::Open, 1),
            ')' => (Token::Close, 1),
            ',' => (Token::Comma, 1),
            '=' => (Token::Equals, 1),
            '"' | '\'' => quoted(rest, first),
            c if c.is_alphabetic() || c == '_' => word(rest),
            c if c.is_ascii_digit() || "+-.".contains(c) => number(rest, c),
            c => (Token::Other(c), c.len_utf8()),
        };
        found.push(Spanned {
            token,
            span: start..start + length,
        });
        rest = &rest[length..];
    }
    found
}

fn word(rest: &str) -> (Token, usize) {
    let end = rest
        .find(|c: char| !(c.is_alphanumeric() || c == '_'))
        .unwrap_or(rest.len());
    (Token::Word(rest[..end].to_owned()), end)
}

/// A quoted string; an unclosed quote is a stray character.
fn quoted(rest: &str, quote: char) -> (Token, usize) {
    match rest[1..].find([quote, '\n']) {
        Some(end) if rest[1 + end..].starts_with(quote) => {
            (Token::Word(rest[1..=end].to_owned()), end + 2)
        }
        _ => (Token::Other(quote), 1),
    }
}

/// The longest prefix that reads as a number; a lone sign or point is a stray character.
fn number(rest: &str, first: char) -> (Token, usize) {
    let signed = usize::from("+-".contains(first));
    let mut end = signed;
    let mut point = false;
    for c in rest[signed..].chars() {
        match c {
            '0'..='9' => end += 1,
            '.' if !point => {
                point = true;
                end += 1;
            }
            _ => break,
        }
    }
    match rest[..end].parse::<f64>() {
        Ok(value) => (Token::Number(value), end),
        Err(_) => (Token::Other(first), first.len_utf8()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn splits_a_call() {
        let words: Vec<Token> = tokens("f(c='a b', x=-1.5)")
            .into_iter()
            .map(|s| s.token)
            .collect();
        let expected = [
            Token::Word("f".into()),
            Token::Open,
            Token::Word("c".into()),
            Token::Equals,
            Token::Word("a b".into()),
            Token::Comma,
            Token::Word("x".into()),
            Token::Equals,
            Token::Number(-1.5),
            Token::Close,
        ];
        assert_eq!(words, expected);
    }

    proptest! {
        #[test]
        fn any_text_splits_into_its_own_pieces(text in "\\PC*") {
            let mut end = 0;
            for Spanned { span, .. } in tokens(&text) {
                prop_assert!(span.start >= end && span.end > span.start);
                prop_assert!(text.is_char_boundary(span.start) && text.is_char_boundary(span.end));
                end = span.end;
            }
            prop_assert!(end <= text.len());
        }
    }
}
