//! Words with their places, and a reader over them that collects errors.

use super::environment::text::MAX_NUMBER;
use std::str::FromStr;

/// A fault in a scene text.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("line {line}, column {column}: {what}")]
pub(crate) struct TextError {
    /// Line, from 1.
    pub(crate) line: usize,
    /// Column in characters, from 1.
    pub(crate) column: usize,
    what: String,
}

/// A word or a mark of a text.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Word<'a> {
    text: &'a str,
    line: usize,
    column: usize,
}

/// Marks that are tokens of their own; a slash belongs to its word (`m/s`).
const MARKS: [char; 7] = [',', ';', ':', '.', '(', ')', '~'];

fn words(text: &str) -> Vec<Word<'_>> {
    let mut words = vec![];
    for (line, content) in text.lines().enumerate() {
        let mut start: Option<(usize, usize)> = None;
        let ends = std::iter::once((content.len(), ' '));
        for (column, (at, c)) in content.char_indices().chain(ends).enumerate() {
            let mark = MARKS.contains(&c);
            if !mark && !c.is_whitespace() {
                start.get_or_insert((at, column));
                continue;
            }
            if let Some((from, column)) = start.take() {
                words.push(Word {
                    text: &content[from..at],
                    line: line + 1,
                    column: column + 1,
                });
            }
            if mark {
                words.push(Word {
                    text: &content[at..at + c.len_utf8()],
                    line: line + 1,
                    column: column + 1,
                });
            }
        }
    }
    words
}

/// Reads words from the first to the last. What goes wrong is an `Err(Failed)` with the error kept,
/// so that reading can go on at the next safe place.
pub(super) struct Reader<'a> {
    words: Vec<Word<'a>>,
    next: usize,
    end: (usize, usize),
    errors: Vec<TextError>,
}

/// An error was noted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Failed;

impl<'a> Reader<'a> {
    pub(super) fn new(text: &'a str) -> Self {
        let last_line = text.lines().last().unwrap_or_default();
        let end = (text.lines().count().max(1), last_line.chars().count() + 1);
        Self {
            words: words(text),
            next: 0,
            end,
            errors: vec![],
        }
    }

    fn place(&self) -> (usize, usize) {
        self.words
            .get(self.next)
            .map_or(self.end, |word| (word.line, word.column))
    }

    /// Notes an error at the next word.
    pub(super) fn fail<T>(&mut self, what: impl Into<String>) -> Result<T, Failed> {
        let (line, column) = self.place();
        self.errors.push(TextError {
            line,
            column,
            what: what.into(),
        });
        Err(Failed)
    }

    pub(super) fn peek(&self) -> Option<&'a str> {
        self.words.get(self.next).map(|word| word.text)
    }

    /// Takes the next word if it is this one.
    pub(super) fn accept(&mut self, word: &str) -> bool {
        let found = self.peek() == Some(word);
        if found {
            self.next += 1;
        }
        found
    }

    /// Takes these words in turn.
    pub(super) fn expect(&mut self, words: &[&str]) -> Result<(), Failed> {
        for word in words {
            if !self.accept(word) {
                let got = self.got();
                return self.fail(format!("expected `{word}`, got {got}"));
            }
        }
        Ok(())
    }

    /// Takes a word that means something of type `T`.
    pub(super) fn take<T>(&mut self, what: &str) -> Result<T, Failed>
    where
        T: FromStr,
        T::Err: std::fmt::Display,
    {
        let Some(word) = self.peek() else {
            return self.fail(format!("expected {what}, got the end of the text"));
        };
        match word.parse() {
            Ok(value) => {
                self.next += 1;
                Ok(value)
            }
            Err(error) => self.fail(format!("expected {what}: {error}")),
        }
    }

    /// Takes a whole number from 0 to [`MAX_NUMBER`], without leading zeros.
    pub(super) fn number(&mut self, what: &str) -> Result<u8, Failed> {
        let word = self.peek().unwrap_or_default();
        let number = word
            .parse::<u8>()
            .ok()
            .filter(|n| *n <= MAX_NUMBER && n.to_string() == word);
        if let Some(number) = number {
            self.next += 1;
            return Ok(number);
        }
        let got = self.got();
        self.fail(format!(
            "expected {what}, a whole number from 0 to {MAX_NUMBER}, got {got}"
        ))
    }

    /// Goes to the line of this number, if it lies ahead.
    pub(super) fn seek_line(&mut self, line: usize) {
        while self
            .words
            .get(self.next)
            .is_some_and(|word| word.line < line)
        {
            self.next += 1;
        }
    }

    fn got(&self) -> String {
        self.peek().map_or_else(
            || "the end of the text".to_owned(),
            |word| format!("`{word}`"),
        )
    }

    /// The result, or all errors; words left over are one.
    pub(super) fn finish<T>(mut self, result: Option<T>) -> Result<T, Vec<TextError>> {
        if self.errors.is_empty() && self.peek().is_some() {
            let got = self.got();
            let _: Result<(), Failed> =
                self.fail(format!("expected the end of the text, got {got}"));
        }
        match result {
            Some(value) if self.errors.is_empty() => Ok(value),
            _ => {
                if self.errors.is_empty() {
                    let _: Result<(), Failed> = self.fail("the text is incomplete");
                }
                Err(self.errors)
            }
        }
    }
}
