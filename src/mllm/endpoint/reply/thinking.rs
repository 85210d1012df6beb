//! Reasoning inside the content, between marks: what a server sends that does not take it out. And
//! the marks of a chat template before the answer.

/// Marks around reasoning at the beginning of a content: Qwen, `DeepSeek` and others; variants;
/// Mistral; Kimi; Seed-OSS; Gemini and EXAONE; tuned models; Command A; `OpenThoughts`; Apertus;
/// `MedGemma`; Gemma 4; others; Open `WebUI`.
const MARKS: [(&str, &str); 15] = [
    ("<think>", "</think>"),
    ("<thinking>", "</thinking>"),
    ("[THINK]", "[/THINK]"),
    ("◁think▷", "◁/think▷"),
    ("<seed:think>", "</seed:think>"),
    ("<thought>", "</thought>"),
    ("<reasoning>", "</reasoning>"),
    ("[REASONING]", "[/REASONING]"),
    ("<|START_THINKING|>", "<|END_THINKING|>"),
    ("<|begin_of_thought|>", "<|end_of_thought|>"),
    ("<|inner_prefix|>", "<|inner_suffix|>"),
    ("<unused94>", "<unused95>"),
    ("<|channel>thought", "<channel|>"),
    ("<|think|>", "<|/think|>"),
    ("<details type=\"reasoning\"", "</details>"),
];
/// The channels of gpt-oss: two of reasoning, and the head of the answer.
const CHANNELS: [(&str, &str); 3] = [
    ("<|channel|>analysis", "<|end|>"),
    ("<|channel|>commentary", "<|end|>"),
    ("<|channel|>final", "<|message|>"),
];
/// Marks before an answer, which belong to the prompt: `ChatML`, Gemma, Llama 3, gpt-oss, Phi and
/// GLM, `DeepSeek`, Seed-OSS, Command A, the beginnings of texts, and marks around an answer.
const HEADS: [&str; 20] = [
    "<|im_start|>assistant",
    "<start_of_turn>model",
    "<|turn>model",
    "<|start_header_id|>assistant<|end_header_id|>",
    "<|start|>assistant",
    "<|assistant|>",
    "<｜Assistant｜>",
    "<seed:bos>assistant",
    "<|START_OF_TURN_TOKEN|>",
    "<|CHATBOT_TOKEN|>",
    "<|START_RESPONSE|>",
    "<|START_TEXT|>",
    "<|begin_of_text|>",
    "<｜begin▁of▁sentence｜>",
    "<s>",
    "<bos>",
    "<answer>",
    "<response>",
    "<|begin_of_box|>",
    "<|begin_of_solution|>",
];
/// Words around reasoning, which an answer may have too, so both have to be there: gpt-oss behind a
/// server that leaves its marks out; Granite.
const WORDS: [(&str, &str); 2] = [
    ("analysis", "assistantfinal"),
    ("Here is my thought process:", "Here is my response:"),
];

/// The answer in a content.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Found<'a> {
    /// Nothing is known yet: the rest is the beginning of a mark, or blank. It is the answer if
    /// nothing follows.
    Undecided(&'a str),
    /// The content has a mark and not its end.
    Thinking,
    Answer(&'a str),
}

/// The answer in a content so far.
pub(super) fn answer(content: &str) -> Found<'_> {
    let mut text = content;
    let pairs = || MARKS.iter().chain(&CHANNELS);
    loop {
        let begun = text.trim_start();
        if let Some(rest) = HEADS.iter().find_map(|head| begun.strip_prefix(head)) {
            text = rest.trim_start();
        } else if let Some((rest, end)) =
            pairs().find_map(|(begin, end)| Some((begun.strip_prefix(begin)?, end)))
        {
            match rest.split_once(end) {
                None => return Found::Thinking,
                Some((_, rest)) => text = rest.trim_start(),
            }
        } else {
            break;
        }
    }
    let begun = text.trim_start();
    let mut marks = pairs().map(|(begin, _)| begin).chain(&HEADS);
    let is_blank_after_marks = text.is_empty() && !content.is_empty();
    if !is_blank_after_marks && marks.any(|mark| mark.starts_with(begun)) {
        Found::Undecided(text)
    } else {
        Found::Answer(text)
    }
}

/// The answer in a whole content, whose first mark the chat template may have written into the
/// prompt.
pub(super) fn after_end(content: &str) -> &str {
    let words = WORDS.iter().filter_map(|(begin, end)| {
        let rest = content.trim_start().strip_prefix(begin)?;
        rest.split_once(end)
    });
    let ends = MARKS.iter().filter_map(|(_, end)| content.split_once(end));
    let rest = words
        .chain(ends)
        .map(|(_, answer)| answer.trim_start())
        .find(|answer| !answer.is_empty());
    match rest.map(answer) {
        None => content,
        Some(Found::Answer(text) | Found::Undecided(text)) => text,
        Some(Found::Thinking) => "",
    }
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
            ("<seed:think>Hm.</seed:think>keep", Found::Answer("keep")),
            ("<thought>Hm.</thought>keep", Found::Answer("keep")),
            (
                "<unused94>thought\nHm.<unused95>keep",
                Found::Answer("keep"),
            ),
            (
                "<|channel>thought\nHm.<channel|>keep",
                Found::Answer("keep"),
            ),
            (
                "<|START_THINKING|>Hm.<|END_THINKING|><|START_RESPONSE|>keep",
                Found::Answer("keep"),
            ),
            (
                "<|channel|>analysis<|message|>Hm.<|end|><|start|>assistant<|channel|>final<|message|>keep",
                Found::Answer("keep"),
            ),
            (
                "<|channel|>final <|constrain|>json<|message|>keep",
                Found::Answer("keep"),
            ),
            ("<think>Hm.</think>\n<answer>keep", Found::Answer("keep")),
            ("<think>Hm. </thi", Found::Thinking),
            ("<|channel|>analysis<|message|>Hm", Found::Thinking),
            ("<think>Hm.</think>", Found::Answer("")),
            ("<think>Hm.</think><ans", Found::Undecided("<ans")),
            ("<thi", Found::Undecided("<thi")),
            ("◁", Found::Undecided("◁")),
            (" \n", Found::Undecided(" \n")),
            ("", Found::Undecided("")),
            ("<thin line", Found::Answer("<thin line")),
            ("keep <think> left", Found::Answer("keep <think> left")),
            (
                "analysis of the lane",
                Found::Answer("analysis of the lane"),
            ),
        ] {
            assert_eq!(answer(content), expected, "{content}");
        }
    }

    #[test]
    fn marks_of_the_prompt_are_no_part_of_an_answer() {
        for content in [
            "<|im_start|>assistant\nkeep",
            "<start_of_turn>model\nkeep",
            "<|start_header_id|>assistant<|end_header_id|>\n\nkeep",
            "<s>keep",
            "<bos><start_of_turn>model\nkeep",
            "<|START_OF_TURN_TOKEN|><|CHATBOT_TOKEN|>keep",
            "<|begin_of_box|>keep",
        ] {
            assert_eq!(answer(content), Found::Answer("keep"), "{content}");
        }
    }

    #[test]
    fn the_first_mark_may_be_in_the_prompt() {
        for (content, expected) in [
            ("Hm.\n</think>\n\nkeep", "keep"),
            ("Hm.[/THINK]keep", "keep"),
            ("Hm.</think><answer>keep", "keep"),
            ("analysisHm.assistantfinalkeep", "keep"),
            (
                "Here is my thought process: Hm.\nHere is my response: keep",
                "keep",
            ),
            ("keep", "keep"),
            ("keep</think>", "keep</think>"),
            ("keep<|end|><|end|>", "keep<|end|><|end|>"),
            ("analysis of the lane", "analysis of the lane"),
        ] {
            assert_eq!(after_end(content), expected, "{content}");
        }
    }
}
