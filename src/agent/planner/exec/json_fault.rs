//! The first fault in a text that should be one value of JSON, with the path to it. A parser names
//! a column alone, and a fault such as NaN is one of the planner, at `states[10].x`.

use std::fmt::Write;

/// Most values inside each other; the messages need five.
const MAX_DEPTH: usize = 64;

/// What is wrong, and the byte at which it begins.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct JsonFault {
    pub what: String,
    pub at: usize,
}

/// The first fault of a text; `None` for JSON.
pub(super) fn first_fault(text: &str) -> Option<JsonFault> {
    let mut scanner = Scanner {
        text,
        at: 0,
        path: Vec::new(),
    };
    scanner.document().err()
}

enum Part {
    Key(String),
    Index(usize),
}

struct Scanner<'a> {
    text: &'a str,
    at: usize,
    /// The way from the whole to the value at `at`.
    path: Vec<Part>,
}

impl<'a> Scanner<'a> {
    fn document(&mut self) -> Result<(), JsonFault> {
        self.value()?;
        self.skip_space();
        match self.peek() {
            None => Ok(()),
            Some(b'{') => self.fail("two messages in one line; write a line break behind each"),
            Some(_) => self.fail("there is text behind the message"),
        }
    }

    fn value(&mut self) -> Result<(), JsonFault> {
        if self.path.len() > MAX_DEPTH {
            return self.fail("the values are nested too deeply");
        }
        self.skip_space();
        match self.peek() {
            None => self.ends(),
            Some(b'{') => self.object(),
            Some(b'[') => self.array(),
            Some(b'"') => self.string().map(drop),
            Some(b'\'') => self.single_quotes(),
            Some(byte) if byte.is_ascii_digit() || b"+-.".contains(&byte) => self.number(),
            Some(byte) if byte.is_ascii_alphabetic() || byte == b'_' => self.word(),
            Some(b',' | b']' | b'}') => {
                let place = self.place();
                self.fail(format!(
                    "{place} has no value; there is a comma or a colon too many"
                ))
            }
            Some(_) => self.fail(format!("{} begins with no value of JSON", self.place())),
        }
    }

    fn object(&mut self) -> Result<(), JsonFault> {
        self.at += 1;
        let mut first = true;
        loop {
            self.skip_space();
            // Faults that programs often make get their own words: trailing commas, single quotes,
            // bare keys.
            match self.peek() {
                Some(b'}') if first => break,
                Some(b'}') => return self.fail("a comma stands before }"),
                Some(b'"') => {}
                Some(b'\'') => return self.single_quotes(),
                None => return self.ends(),
                Some(byte) if byte.is_ascii_alphabetic() || byte == b'_' => {
                    return self.fail("a key without quotes");
                }
                Some(_) => return self.fail("expected a key in quotes"),
            }
            let key = self.string()?;
            self.path.push(Part::Key(key));
            self.skip_space();
            match self.peek() {
                Some(b':') => self.at += 1,
                None => return self.ends(),
                Some(_) => return self.fail("expected a colon behind the key"),
            }
            self.value()?;
            self.path.pop();
            self.skip_space();
            first = false;
            match self.peek() {
                Some(b',') => self.at += 1,
                Some(b'}') => break,
                None => return self.ends(),
                Some(_) => return self.fail("expected a comma or }"),
            }
        }
        self.at += 1;
        Ok(())
    }

    fn array(&mut self) -> Result<(), JsonFault> {
        self.at += 1;
        let mut index = 0;
        loop {
            self.skip_space();
            match self.peek() {
                Some(b']') if index == 0 => break,
                Some(b']') => return self.fail("a comma stands before ]"),
                None => return self.ends(),
                Some(_) => {}
            }
            self.path.push(Part::Index(index));
            self.value()?;
            self.path.pop();
            self.skip_space();
            index += 1;
            match self.peek() {
                Some(b',') => self.at += 1,
                Some(b']') => break,
                None => return self.ends(),
                Some(_) => return self.fail("expected a comma or ]"),
            }
        }
        self.at += 1;
        Ok(())
    }

    /// A text in double quotes.
    fn string(&mut self) -> Result<String, JsonFault> {
        let begin = self.at;
        self.at += 1;
        loop {
            match self.peek() {
                None => return self.ends(),
                Some(b'"') => break,
                Some(b'\\') => self.at += 2,
                Some(byte) if byte < b' ' => {
                    return self
                        .fail("a control character inside a text; write it as \\t or \\u0000");
                }
                Some(_) => self.at += 1,
            }
        }
        self.at += 1;
        let token = self.text.get(begin..self.at).unwrap_or("");
        if let Ok(text) = serde_json::from_str(token) {
            return Ok(text);
        }
        self.at = begin;
        self.fail("a text with an escape that JSON does not have")
    }

    fn number(&mut self) -> Result<(), JsonFault> {
        let rest = self.text.get(self.at + 1..).unwrap_or("");
        // Infinity with a sign.
        let is_signed = matches!(self.peek(), Some(b'+' | b'-'));
        if is_signed && rest.starts_with(|character: char| character.is_ascii_alphabetic()) {
            return self.word();
        }
        let token = self
            .token(|character| character.is_ascii_alphanumeric() || "+-.#_".contains(character));
        match serde_json::from_str::<f64>(token) {
            Ok(_) => {
                self.at += token.len();
                Ok(())
            }
            Err(error) if error.to_string().contains("out of range") => {
                self.fail(format!("{} is too large: {token}", self.place()))
            }
            Err(_) => self.fail(format!("{} is no number of JSON: {token}", self.place())),
        }
    }

    fn word(&mut self) -> Result<(), JsonFault> {
        let token =
            self.token(|character| character.is_ascii_alphanumeric() || "+-._".contains(character));
        let place = self.place();
        let low = token.trim_start_matches(['+', '-']).to_ascii_lowercase();
        match token {
            "true" | "false" | "null" => {
                self.at += token.len();
                Ok(())
            }
            "True" | "False" | "None" => self.fail(format!(
                "{place} is {token}, a word of Python; json.dumps writes JSON"
            )),
            _ if ["nan", "inf", "infinity"].contains(&low.as_str()) => self.fail(format!(
                "{place} is {token}; a plan needs finite numbers, and JSON has no others"
            )),
            _ => self.fail(format!("{place} is the word {token} without quotes")),
        }
    }

    fn token(&self, belongs: impl Fn(char) -> bool) -> &'a str {
        let rest = self.text.get(self.at..).unwrap_or("");
        let end = rest
            .find(|character| !belongs(character))
            .unwrap_or(rest.len());
        rest.get(..end).unwrap_or("")
    }

    fn single_quotes<T>(&self) -> Result<T, JsonFault> {
        self.fail("single quotes, as Python prints a dict; json.dumps writes JSON")
    }

    fn ends<T>(&self) -> Result<T, JsonFault> {
        self.fail(format!(
            "the line ends inside {}; a message is one whole line, without line breaks inside",
            self.place()
        ))
    }

    /// The path in words: `states[10].x`.
    fn place(&self) -> String {
        let mut place = String::new();
        for part in &self.path {
            match part {
                Part::Key(key) if place.is_empty() => place.push_str(key),
                // Writing to a string cannot fail.
                Part::Key(key) => drop(write!(place, ".{key}")),
                Part::Index(index) => drop(write!(place, "[{index}]")),
            }
        }
        if place.is_empty() {
            "the message".to_owned()
        } else {
            place
        }
    }

    fn fail<T>(&self, what: impl Into<String>) -> Result<T, JsonFault> {
        Err(JsonFault {
            what: what.into(),
            at: self.at.min(self.text.len()),
        })
    }

    fn peek(&self) -> Option<u8> {
        self.text.as_bytes().get(self.at).copied()
    }

    fn skip_space(&mut self) {
        while self.peek().is_some_and(|byte| b" \t\r\n".contains(&byte)) {
            self.at += 1;
        }
    }
}
