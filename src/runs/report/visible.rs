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

/// A text within Markdown, as it is: neither HTML, nor a link, nor an image from elsewhere.
pub(crate) fn in_markdown(text: &str) -> String {
    // The backslash comes first: it would take the effect of the one before a bracket.
    visible(text)
        .replace('\\', "\\\\")
        .replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('[', "\\[")
}

/// The same in one line: a heading, a list item.
pub fn markdown_line(text: &str) -> String {
    in_markdown(&visible_line(text))
}

/// The same in a cell of a table.
pub(crate) fn markdown_cell(text: &str) -> String {
    markdown_line(text).replace('|', "\\|")
}

/// A block of Markdown that shows a text as it is; its fence is longer than any run of backticks
/// inside. `kind` is the language.
pub fn markdown_block(kind: &str, text: &str) -> String {
    let longest = text
        .split(|c| c != '`')
        .map(str::len)
        .max()
        .expect("a split gives one part at least");
    let fence = "`".repeat(longest.max(2) + 1);
    format!("{fence}{kind}\n{}\n{fence}", visible(text))
}

/// Whether a terminal or a browser obeys a character instead of showing it: controls, changes of
/// the writing direction, line separators, invisible operators and tags. The page has the same list
/// (`assets/dom.js`).
fn is_hidden(c: char) -> bool {
    c.is_control()
        || matches!(
            c,
            '\u{61c}'
                | '\u{180e}'
                | '\u{200e}'
                | '\u{200f}'
                | '\u{2028}'..='\u{202e}'
                | '\u{2060}'..='\u{206f}'
                | '\u{feff}'
                | '\u{fff9}'..='\u{fffb}'
                | '\u{e0000}'..='\u{e007f}'
        )
}

/// The escapes are those of JSON, so that a JSON text stays one.
fn escaped(text: &str, hidden: impl Fn(char) -> bool) -> Cow<'_, str> {
    if !text.contains(&hidden) {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        if hidden(c) {
            for unit in c.encode_utf16(&mut [0; 2]) {
                // Writing to a string cannot fail.
                let _ = write!(out, "\\u{unit:04x}");
            }
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
        assert_eq!(visible("\u{61c}\u{2066}\u{2069}"), "\\u061c\\u2066\\u2069");
        let hostile = "\u{9b}2J\u{202e}\u{e0041}";
        let json = serde_json::to_string(hostile).unwrap();
        let shown = visible(&json);
        assert!(shown.is_ascii(), "{shown}");
        assert_eq!(serde_json::from_str::<String>(&shown).unwrap(), hostile);
    }

    #[test]
    fn markdown_gets_no_html_no_links_and_no_cells() {
        assert_eq!(
            in_markdown("<script>&amp;</script> ![x](http://a)"),
            "&lt;script>&amp;amp;&lt;/script> !\\[x](http://a)"
        );
        // A backslash of the text does not free the bracket or the bar behind it.
        assert_eq!(in_markdown("\\[x](http://a)"), "\\\\\\[x](http://a)");
        assert_eq!(markdown_cell("a|b\\|c\nd"), "a\\|b\\\\\\|c\\\\u000ad");
        assert_eq!(markdown_block("text", "a```b"), "````text\na```b\n````");
    }
}
