//! Text from outside for terminals and Markdown: names of recordings, answers of models, errors of
//! servers. A terminal obeys control characters, and a browser obeys HTML.

use std::borrow::Cow;
use std::fmt::Write;

/// A text whose control characters are visible: `\u001b` for escape. Line feeds and tabs stay.
pub fn visible(text: &str) -> Cow<'_, str> {
    escaped(text, |c| is_hidden(c) && !matches!(c, '\n' | '\t'))
}

/// The same for a cell or a name, which has one line.
pub fn visible_line(text: &str) -> Cow<'_, str> {
    escaped(text, is_hidden)
}

/// A text within Markdown, as it is: neither HTML nor an image from elsewhere.
pub(super) fn in_markdown(text: &str) -> String {
    visible(text)
        .replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace("![", "!\\[")
}

/// Whether a terminal obeys a character instead of showing it: controls, changes of the writing
/// direction, line separators.
fn is_hidden(c: char) -> bool {
    c.is_control()
        || matches!(c, '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}' | '\u{feff}')
}

/// All these characters have four digits at most, so that this is an escape of JSON too.
fn escaped(text: &str, hidden: impl Fn(char) -> bool) -> Cow<'_, str> {
    if !text.contains(&hidden) {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        if hidden(c) {
            // Writing to a string cannot fail.
            let _ = write!(out, "\\u{:04x}", u32::from(c));
        } else {
            out.push(c);
        }
    }
    Cow::Owned(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_terminal_would_obey_is_shown() {
        assert_eq!(visible("a\tb\nü 汉"), "a\tb\nü 汉");
        assert_eq!(
            visible("\u{1b}[2J\r\u{9b}31m\u{7f}\u{202e}"),
            "\\u001b[2J\\u000d\\u009b31m\\u007f\\u202e"
        );
        assert_eq!(visible_line("a\nb\tc"), "a\\u000ab\\u0009c");
        let json = serde_json::to_string("\u{9b}2J\u{202e}").unwrap();
        assert_eq!(
            serde_json::from_str::<String>(&visible(&json)).unwrap(),
            "\u{9b}2J\u{202e}"
        );
    }

    #[test]
    fn markdown_gets_no_html() {
        assert_eq!(
            in_markdown("<script>&amp;</script> ![x](http://a)"),
            "&lt;script>&amp;amp;&lt;/script> !\\[x](http://a)"
        );
    }
}
