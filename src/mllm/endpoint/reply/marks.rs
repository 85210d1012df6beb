//! Marks of chat templates behind an answer, which a server should take out and some leave in.

/// Marks that end an answer: Qwen and others of the form of `ChatML`, Llama 3, Llama 2 and Mistral,
/// Gemma, GPT-2, Phi, Idefics and SmolVLM, GLM, `DeepSeek`, gpt-oss, Command A, Seed-OSS, EXAONE,
/// `LongCat`, Kimi K3, models with channels, and the ends of marks around an answer.
const ENDS: [&str; 33] = [
    "<|im_end|>",
    "<|eot_id|>",
    "<|eom_id|>",
    "</s>",
    "<end_of_turn>",
    "<turn|>",
    "<eos>",
    "<|endoftext|>",
    "<|end_of_text|>",
    "<|end|>",
    "<|end_of_turn|>",
    "<|EOT|>",
    "<end_of_utterance>",
    "<|user|>",
    "<｜end▁of▁sentence｜>",
    "<｜User｜>",
    "<|return|>",
    "<|END_OF_TURN_TOKEN|>",
    "<|END_RESPONSE|>",
    "<|END_TEXT|>",
    "<seed:eos>",
    "[|endofturn|]",
    "<longcat_s>",
    "<|close|>response<|sep|>",
    "<|close|>message<|sep|>",
    "<|eom|>",
    "<|eot|>",
    "</answer>",
    "</response>",
    "</output>",
    "</conclusion>",
    "<|end_of_box|>",
    "<|end_of_solution|>",
];

/// Length of the longest of them, bytes.
const MAX_END: usize = 25;

/// An answer without the marks behind it. One without marks stays as it is.
pub(super) fn bare(answer: &str) -> &str {
    let mut text = answer;
    while let Some(rest) = ENDS.iter().find_map(|end| without(text.trim_end(), end)) {
        text = rest;
    }
    text
}

/// A text without this mark at its end, in letters of any case.
fn without<'a>(text: &'a str, end: &str) -> Option<&'a str> {
    let (rest, last) = text.split_at_checked(text.len().checked_sub(end.len())?)?;
    last.eq_ignore_ascii_case(end).then_some(rest)
}

/// What no mark can take away from an answer so far, whatever follows.
pub(super) fn settled(answer: &str) -> &str {
    let near = answer.floor_char_boundary(answer.len().saturating_sub(MAX_END));
    let (before, last) = answer.split_at_checked(near).unwrap_or(("", answer));
    let is_begin = |text: &str| {
        ENDS.iter().any(|end| {
            end.get(..text.len())
                .is_some_and(|begin| begin.eq_ignore_ascii_case(text))
        })
    };
    let mut places = last.match_indices(['<', '[']).map(|(at, _)| at);
    let open = places.find(|at| last.get(*at..).is_some_and(is_begin));
    match open.and_then(|at| answer.get(..before.len() + at)) {
        Some(before) => bare(before),
        None => bare(answer),
    }
}

#[cfg(test)]
mod tests {
    use super::{bare, settled};

    #[test]
    fn marks_of_templates_are_no_part_of_an_answer() {
        for (answer, expected) in [
            ("keep", "keep"),
            (" keep \n", " keep \n"),
            ("keep<|im_end|>", "keep"),
            ("keep<|im_end|>\n", "keep"),
            ("keep</s></s>", "keep"),
            ("keep<end_of_turn>\n<|endoftext|>", "keep"),
            ("keep<|end_of_box|>", "keep"),
            ("keep<|end_of_box|><|user|>", "keep"),
            ("keep</answer>\n<eos>", "keep"),
            ("keep</Output>", "keep"),
            ("keep[|endofturn|]", "keep"),
            ("keep<|close|>response<|sep|><|eot|>", "keep"),
            ("keep [left]", "keep [left]"),
            ("läuft weiter über é", "läuft weiter über é"),
            ("a</s> inside", "a</s> inside"),
            ("<|im_end|>", ""),
            ("", ""),
        ] {
            assert_eq!(bare(answer), expected, "{answer:?}");
        }
    }

    #[test]
    fn the_beginning_of_a_mark_waits() {
        for (answer, expected) in [
            ("keep", "keep"),
            ("keep <", "keep "),
            ("keep<|im_e", "keep"),
            ("keep<|im_end|>", "keep"),
            ("keep</s>\n<|im_", "keep"),
            ("keep < 3", "keep < 3"),
            ("keep<|im_port", "keep<|im_port"),
            ("keep<|close|>resp", "keep"),
            ("keep<|close|>response<|s", "keep"),
            ("keep [|end", "keep "),
            ("ééééééééééééééééééé<|im", "ééééééééééééééééééé"),
        ] {
            assert_eq!(settled(answer), expected, "{answer:?}");
        }
    }
}
