//! Bounds of templates. They come with downloaded models and with prompt sets of others, and they
//! are programs: they may nest, loop and repeat texts.

use std::io::{self, Write};
use std::thread;

/// Longest template, bytes. Published ones have up to 30 KB. A template nests at most once a byte.
pub(super) const MAX_SOURCE_BYTES: usize = 64 << 10;
/// Longest code of a tag without its strings, bytes. Published templates have up to a few hundred.
/// The engine folds constants in a time that grows with the square of an expression.
pub(super) const MAX_TAG_BYTES: usize = 4 << 10;
/// Instructions of one rendering. A chat of ten messages takes a few thousand.
pub(super) const MAX_STEPS: u64 = 500_000;
/// Calls of macros inside each other.
pub(super) const MAX_CALLS: usize = 50;
/// Bytes that a template may add to the texts of its context.
const MAX_ADDED_BYTES: usize = 256 << 10;
/// How often a template may write the texts of its context.
const MAX_COPIES: usize = 4;
/// Stack of the thread that compiles and renders, bytes: nesting takes up to 4 KB of stack a level,
/// and a level at least a byte of the template, or two instructions.
const STACK_BYTES: usize = MAX_SOURCE_BYTES * (4 << 10);

/// Runs work on a thread with a stack that no template within the bounds overflows.
///
/// # Errors
/// When the thread cannot be started, or the work panics.
pub(super) fn on_deep_stack<T: Send>(work: impl FnOnce() -> T + Send) -> io::Result<T> {
    thread::scope(|scope| {
        let builder = thread::Builder::new()
            .name("template".to_owned())
            .stack_size(STACK_BYTES);
        builder
            .spawn_scoped(scope, work)?
            .join()
            .map_err(|_| io::Error::other("the template engine panicked"))
    })
}

/// A tag of a template.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Tag {
    /// Whether it is a statement; else it writes a value.
    pub(super) is_statement: bool,
    /// Its code without strings and the braces of maps.
    pub(super) code: String,
}

/// Bytes of code in the longest tag of a template, without its strings.
pub(super) fn longest_tag(source: &str) -> usize {
    tags(source)
        .iter()
        .map(|tag| tag.code.len())
        .max()
        .unwrap_or(0)
}

/// The tags of a template.
pub(super) fn tags(source: &str) -> Vec<Tag> {
    let mut found = Vec::new();
    let mut rest = source;
    while let Some(at) = rest.find('{') {
        rest = &rest[at + 1..];
        if let Some(comment) = rest.strip_prefix('#') {
            rest = comment.split_once("#}").map_or("", |(_, after)| after);
        } else if let Some(tag) = rest.strip_prefix(['{', '%']) {
            let is_statement = rest.starts_with('%');
            let (code, after) = code_of(tag);
            found.push(Tag { is_statement, code });
            rest = after;
        }
    }
    found
}

/// The code up to the end of a tag, without its strings, and what follows. Braces inside a tag are
/// those of a map.
fn code_of(tag: &str) -> (String, &str) {
    let (mut code, mut braces) = (String::new(), 0_usize);
    let mut quote = None;
    let mut escaped = false;
    for (at, c) in tag.char_indices() {
        match (quote, c) {
            (Some(_), _) if escaped => escaped = false,
            (Some(_), '\\') => escaped = true,
            (Some(open), _) if open == c => quote = None,
            (Some(_), _) => {}
            (None, '"' | '\'') => quote = Some(c),
            (None, '{') => braces += 1,
            (None, '}') if braces > 0 => braces -= 1,
            (None, '}') => return (code, &tag[at + 1..]),
            (None, _) => code.push(c),
        }
    }
    (code, "")
}

/// A text of limited length.
#[derive(Debug)]
pub(super) struct BoundedText {
    bytes: Vec<u8>,
    most: usize,
    is_exceeded: bool,
}

impl BoundedText {
    /// For a template whose texts have `bytes` bytes.
    pub(super) fn of_texts(bytes: usize) -> Self {
        let most = bytes
            .saturating_mul(MAX_COPIES)
            .saturating_add(MAX_ADDED_BYTES);
        Self {
            bytes: Vec::new(),
            most,
            is_exceeded: false,
        }
    }

    /// The text, or what is wrong with it.
    pub(super) fn into_text(self) -> Result<String, String> {
        if self.is_exceeded {
            return Err(format!(
                "the rendered text has more than {} bytes",
                self.most
            ));
        }
        // The template engine writes whole characters.
        Ok(String::from_utf8_lossy(&self.bytes).into_owned())
    }
}

impl Write for BoundedText {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.bytes.len().saturating_add(bytes.len()) > self.most {
            self.is_exceeded = true;
            return Err(io::Error::other("the rendered text is too long"));
        }
        self.bytes.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_longest_tag_has_the_most_code() {
        for (source, length) in [
            ("no tag, {one brace}", 0),
            ("{{ a }}{% if abc %}{# a long comment #}", 9),
            ("{{ 'a string }} with \\' an end' }}{{ b }}", 3),
            ("{{ {'a': {}} + bb }}", 9),
            ("{{ never ends", 11),
        ] {
            assert_eq!(longest_tag(source), length, "{source}");
        }
    }
}
