//! Reasoning between words, which an answer may have too, so both the words before and those behind
//! it have to be there.

use super::marks::{Inside, Seen};

/// What stands between the reasoning and the answer of gpt-oss, behind a server that leaves its
/// marks out.
const FINAL: &str = "assistantfinal";
/// The name of the channel of its reasoning, where the text begins.
const ANALYSIS: &str = "analysis";
/// Words that its reasoning begins with. Behind [`ANALYSIS`], without a blank, no answer has them.
const FIRST_WORDS: [&str; 10] = [
    "We", "The", "User", "Need", "I", "Let", "Just", "They", "This", "Looks",
];
/// The format of an answer, which may stand before it.
const FORMAT: &str = "json";

/// Words around reasoning.
#[derive(Debug, PartialEq)]
pub(super) struct Words {
    begin: &'static str,
    ends: &'static [&'static str],
    /// Whether the last of the words is part of the answer.
    keeps_end: bool,
}

/// gpt-oss; Granite; Ollama's program; LLaVA-CoT.
static WORDS: [Words; 5] = [
    Words {
        begin: ANALYSIS,
        ends: &[FINAL],
        keeps_end: false,
    },
    Words {
        begin: "Here is my thought process:",
        ends: &["Here is my response:", "Here's my response:"],
        keeps_end: false,
    },
    Words {
        begin: "Here's my thought process:",
        ends: &["Here is my response:", "Here's my response:"],
        keeps_end: false,
    },
    Words {
        begin: "Thinking...\n",
        ends: &["...done thinking."],
        keeps_end: false,
    },
    Words {
        begin: "<SUMMARY>",
        ends: &["<CONCLUSION>"],
        keeps_end: true,
    },
];
/// Longest words behind reasoning, bytes.
pub(super) const MAX_END: usize = 20;

impl Words {
    /// Where the words behind reasoning stand in a text, and how many bytes they take.
    pub(super) fn end(&self, text: &str) -> Option<(usize, usize)> {
        let found = self
            .ends
            .iter()
            .filter_map(|end| Some((text.find(end)?, end.len())));
        let (at, length) = found.min()?;
        Some((at, if self.keeps_end { 0 } else { length }))
    }
}

/// Whether a text that begins with such words is reasoning though nothing ends it.
pub(super) fn are_clear(text: &str) -> bool {
    let Some(rest) = text.strip_prefix(ANALYSIS) else {
        return false;
    };
    let word = rest.split(|c: char| !c.is_alphanumeric()).next();
    word.is_some_and(|word| FIRST_WORDS.contains(&word))
}

/// The words that a text begins with.
pub(super) fn begun(text: &str) -> Option<&'static Words> {
    WORDS.iter().find(|words| {
        text.strip_prefix(words.begin)
            .is_some_and(|rest| words.begin != ANALYSIS || rest.starts_with(follows_analysis))
    })
}

/// Whether a text may be the beginning of such words.
pub(super) fn may_begin(text: &str) -> bool {
    WORDS.iter().any(|words| words.begin.starts_with(text))
}

/// Whether this character follows the name of a channel and no word of a sentence.
fn follows_analysis(c: char) -> bool {
    c.is_alphanumeric() || matches!(c, '\n' | '"' | '(')
}

/// Where the end of gpt-oss's reasoning stands in an answer; `partly` where its beginning counts.
/// `last` is the character before the text. A sentence about the word has a blank before it.
pub(super) fn end_alone(
    text: &str,
    last: Option<char>,
    partly: bool,
) -> Option<(usize, Seen<Inside>)> {
    let is_glued = |at: usize| {
        let before = text.get(..at).and_then(|text| text.chars().next_back());
        before
            .or(last)
            .is_none_or(|before| before == '\n' || !before.is_whitespace())
    };
    let whole = text
        .match_indices(FINAL)
        .map(|(at, _)| at)
        .find(|at| is_glued(*at));
    if let Some(at) = whole {
        return Some((at, Seen::Yes(Inside::EndAlone, FINAL.len())));
    }
    let begun = (1..FINAL.len()).rev().filter(|_| partly);
    let mut places = begun.filter_map(|length| {
        let beginning = FINAL.get(..length)?;
        Some(text.len() - text.strip_suffix(beginning).map(|_| length)?)
    });
    let at = places.find(|at| is_glued(*at))?;
    Some((at, Seen::Maybe))
}

/// Whether a text begins with the name of a format and an answer in it.
pub(super) fn format(text: &str) -> Seen<()> {
    if FORMAT.starts_with(text) {
        return Seen::Maybe;
    }
    match text.strip_prefix(FORMAT).map(str::trim_start) {
        Some("") => Seen::Maybe,
        Some(rest) if rest.starts_with('{') => Seen::Yes((), text.len() - rest.len()),
        _ => Seen::No,
    }
}
