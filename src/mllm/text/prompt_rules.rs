//! The part of Jinja that prompt sets have. A prompt set comes without a trial in a child process,
//! so its values are bounded here: by what the source may hold, and by filters that look before they
//! write.

use super::template_bounds::tags;
use minijinja::value::Value;
use minijinja::{Environment, Error, ErrorKind, filters, functions, tests};
use std::fmt::{self, Write};

/// Instructions of one rendering. The built-in sets take a few hundred.
pub(super) const MAX_STEPS: u64 = 10_000;
/// Bytes that a filter gives.
const MAX_VALUE_BYTES: usize = 64 << 10;
/// Concatenations and commas of a template: with names for their results, they multiply a text.
const MAX_GROWTH: usize = 10;
/// Words that begin a statement.
const STATEMENTS: [&str; 10] = [
    "if", "elif", "else", "endif", "for", "endfor", "set", "with", "endwith", "continue",
];

/// Whether a source is within the rules; or what it holds beyond them.
pub(super) fn check(source: &str) -> Result<(), String> {
    let mut growth = 0;
    for tag in tags(source) {
        // Signs at the ends say what happens to white space.
        let code = tag.code.trim_start_matches(['-', '+']);
        let code = code.trim_end_matches('%').trim_end_matches(['-', '+']);
        let word: String = code
            .trim_start()
            .chars()
            .take_while(|c| c.is_ascii_alphanumeric() || *c == '_')
            .collect();
        if tag.is_statement {
            if !STATEMENTS.contains(&word.as_str()) {
                return Err(format!(
                    "a prompt set has no statement {word}; it has {}",
                    STATEMENTS.join(", ")
                ));
            }
            if word == "set" && !code.contains('=') {
                return Err("a prompt set has no set without =".to_owned());
            }
            let is_word = |c: char| c.is_ascii_alphanumeric() || c == '_';
            if word == "for" && code.split(|c| !is_word(c)).any(|part| part == "recursive") {
                return Err("a prompt set has no recursive loop".to_owned());
            }
        }
        if code.contains('*') {
            return Err("a prompt set does not multiply: there is a * in a tag".to_owned());
        }
        growth += code.matches(['~', '+', ',']).count();
    }
    if growth > MAX_GROWTH {
        return Err(format!(
            "it has {growth} of ~, + and commas in its tags; at most {MAX_GROWTH} are read"
        ));
    }
    Ok(())
}

/// The filters, tests and functions of prompt sets. None gives more than a few times what it gets,
/// or it has a bound.
pub(super) fn environment() -> Environment<'static> {
    // An explicit list: minijinja's defaults have filters that make much out of little.
    let mut environment = Environment::empty();
    environment.add_filter("abs", filters::abs);
    environment.add_filter("attr", filters::attr);
    environment.add_filter("bool", filters::bool);
    environment.add_filter("capitalize", filters::capitalize);
    environment.add_filter("count", filters::length);
    environment.add_filter("d", filters::default);
    environment.add_filter("default", filters::default);
    environment.add_filter("first", filters::first);
    environment.add_filter("float", filters::float);
    environment.add_filter("int", filters::int);
    environment.add_filter("items", filters::items);
    environment.add_filter("join", join);
    environment.add_filter("last", filters::last);
    environment.add_filter("length", filters::length);
    environment.add_filter("lines", filters::lines);
    environment.add_filter("list", filters::list);
    environment.add_filter("lower", filters::lower);
    environment.add_filter("map", filters::map);
    environment.add_filter("max", filters::max);
    environment.add_filter("min", filters::min);
    environment.add_filter("reject", filters::reject);
    environment.add_filter("replace", replace);
    environment.add_filter("reverse", filters::reverse);
    environment.add_filter("round", filters::round);
    environment.add_filter("select", filters::select);
    environment.add_filter("sort", filters::sort);
    environment.add_filter("split", filters::split);
    environment.add_filter("string", string);
    environment.add_filter("title", filters::title);
    environment.add_filter("trim", filters::trim);
    environment.add_filter("unique", filters::unique);
    environment.add_filter("upper", filters::upper);
    environment.add_test("defined", tests::is_defined);
    environment.add_test("endingwith", tests::is_endingwith);
    environment.add_test("eq", tests::is_eq);
    environment.add_test("even", tests::is_even);
    environment.add_test("false", tests::is_false);
    environment.add_test("ge", tests::is_ge);
    environment.add_test("gt", tests::is_gt);
    environment.add_test("in", tests::is_in);
    environment.add_test("le", tests::is_le);
    environment.add_test("lt", tests::is_lt);
    environment.add_test("ne", tests::is_ne);
    environment.add_test("none", tests::is_none);
    environment.add_test("number", tests::is_number);
    environment.add_test("odd", tests::is_odd);
    environment.add_test("startingwith", tests::is_startingwith);
    environment.add_test("string", tests::is_string);
    environment.add_test("true", tests::is_true);
    environment.add_test("undefined", tests::is_undefined);
    environment.add_function("range", functions::range);
    environment
}

/// A text that ends at a bound.
#[derive(Default)]
struct BoundedValue(String);

impl BoundedValue {
    /// Adds a value as it is printed.
    fn add(&mut self, value: &Value) -> Result<(), Error> {
        match value.as_str() {
            Some(text) => self.write_str(text),
            None => write!(self, "{value}"),
        }
        .map_err(|_| too_long())
    }
}

impl Write for BoundedValue {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        if self.0.len() + text.len() > MAX_VALUE_BYTES {
            return Err(fmt::Error);
        }
        self.0.push_str(text);
        Ok(())
    }
}

fn too_long() -> Error {
    Error::new(
        ErrorKind::InvalidOperation,
        format!("a value would have more than {MAX_VALUE_BYTES} bytes"),
    )
}

/// The elements of a list as one text.
fn join(value: &Value, joiner: Option<&str>) -> Result<String, Error> {
    let mut text = BoundedValue::default();
    for (i, item) in value.try_iter()?.enumerate() {
        if i > 0 {
            text.write_str(joiner.unwrap_or(""))
                .map_err(|_| too_long())?;
        }
        text.add(&item)?;
    }
    Ok(text.0)
}

/// A text with other parts.
fn replace(value: &str, from: &str, to: &str) -> Result<String, Error> {
    let count = value.matches(from).count();
    if count.saturating_mul(to.len()).saturating_add(value.len()) > MAX_VALUE_BYTES {
        return Err(too_long());
    }
    Ok(value.replace(from, to))
}

/// A value as it is printed.
fn string(value: &Value) -> Result<String, Error> {
    let mut text = BoundedValue::default();
    text.add(value)?;
    Ok(text.0)
}
