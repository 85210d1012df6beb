//! Marks of chat templates behind an answer, which a server should take out and some leave in.

/// Marks that end an answer: Qwen and others of the form of `ChatML`, Llama 3, Llama 2 and Mistral,
/// Gemma, GPT-2, Phi, Idefics and SmolVLM, GLM, `DeepSeek`, gpt-oss, Command A, Seed-OSS, and the
/// ends of marks around an answer.
const ENDS: [&str; 25] = [
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
    "</answer>",
    "</response>",
    "<|end_of_box|>",
    "<|end_of_solution|>",
];

/// An answer without the marks behind it. One without marks stays as it is.
pub(super) fn bare(answer: &str) -> &str {
    let mut text = answer;
    while let Some(rest) = ENDS
        .iter()
        .find_map(|end| text.trim_end().strip_suffix(end))
    {
        text = rest;
    }
    text
}

/// What no mark can take away from an answer so far, whatever follows.
pub(super) fn settled(answer: &str) -> &str {
    let open = answer.rfind('<').and_then(|at| answer.split_at_checked(at));
    match open {
        Some((before, mark)) if ENDS.iter().any(|end| end.starts_with(mark)) => bare(before),
        _ => bare(answer),
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
        ] {
            assert_eq!(settled(answer), expected, "{answer:?}");
        }
    }
}
