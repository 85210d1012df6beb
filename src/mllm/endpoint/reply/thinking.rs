//! Reasoning inside the content, between marks: what a server sends that does not take it out.

/// Marks around reasoning at the beginning of a content: Qwen, `DeepSeek` and others; variants;
/// Mistral; Kimi.
const MARKS: [(&str, &str); 4] = [
    ("<think>", "</think>"),
    ("<thinking>", "</thinking>"),
    ("[THINK]", "[/THINK]"),
    ("◁think▷", "◁/think▷"),
];

/// The answer in a content.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Found<'a> {
    /// Nothing is known yet: the content is the beginning of a mark, or blank.
    Undecided,
    /// The content has a mark and not its end.
    Thinking,
    Answer(&'a str),
}

/// The answer in a content so far.
pub(super) fn answer(content: &str) -> Found<'_> {
    let text = content.trim_start();
    for (begin, end) in MARKS {
        if let Some(rest) = text.strip_prefix(begin) {
            return rest.split_once(end).map_or(Found::Thinking, |(_, answer)| {
                Found::Answer(answer.trim_start())
            });
        }
    }
    if MARKS.iter().any(|(begin, _)| begin.starts_with(text)) {
        Found::Undecided
    } else {
        Found::Answer(content)
    }
}

/// The answer in a whole content, whose first mark the chat template may have written into the
/// prompt.
pub(super) fn after_end(content: &str) -> &str {
    let ends = MARKS.iter().filter_map(|(_, end)| content.split_once(end));
    ends.map(|(_, answer)| answer.trim_start())
        .find(|answer| !answer.is_empty())
        .unwrap_or(content)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reasoning_between_marks_is_left_out() {
        for (content, expected) in [
            ("keep", Found::Answer("keep")),
            (" keep", Found::Answer(" keep")),
            ("<think>\nHm.\n</think>\n\nkeep", Found::Answer("keep")),
            ("\n<think></think>keep", Found::Answer("keep")),
            ("[THINK]Hm.[/THINK]keep", Found::Answer("keep")),
            ("◁think▷Hm.◁/think▷keep", Found::Answer("keep")),
            ("<thinking>Hm.</thinking>keep", Found::Answer("keep")),
            ("<think>Hm. </thi", Found::Thinking),
            ("<think>Hm.</think>", Found::Answer("")),
            ("<thi", Found::Undecided),
            ("◁", Found::Undecided),
            (" \n", Found::Undecided),
            ("", Found::Undecided),
            ("<thin line", Found::Answer("<thin line")),
            ("keep <think> left", Found::Answer("keep <think> left")),
        ] {
            assert_eq!(answer(content), expected, "{content}");
        }
    }

    #[test]
    fn the_first_mark_may_be_in_the_prompt() {
        for (content, expected) in [
            ("Hm.\n</think>\n\nkeep", "keep"),
            ("Hm.[/THINK]keep", "keep"),
            ("keep", "keep"),
            ("keep</think>", "keep</think>"),
        ] {
            assert_eq!(after_end(content), expected, "{content}");
        }
    }
}
