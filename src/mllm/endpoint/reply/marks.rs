//! Marks of chat templates around an answer, which a server should take out and some leave in.

/// Marks that end an answer: Qwen and others of the form of ChatML, Llama 3, Llama 2 and Mistral,
/// Gemma, GPT-2, Phi, Idefics and SmolVLM, GLM, `DeepSeek`.
const ENDS: [&str; 11] = [
    "<|im_end|>",
    "<|eot_id|>",
    "<|eom_id|>",
    "</s>",
    "<end_of_turn>",
    "<|endoftext|>",
    "<|end|>",
    "<end_of_utterance>",
    "<|user|>",
    "<｜end▁of▁sentence｜>",
    "<|return|>",
];
/// Marks around the answer: GLM with vision.
const BOXES: [(&str, &str); 1] = [("<|begin_of_box|>", "<|end_of_box|>")];

/// An answer without the marks around it. One without marks stays as it is.
pub(super) fn bare(answer: &str) -> &str {
    let mut text = answer;
    while let Some(rest) = ENDS
        .iter()
        .find_map(|end| text.trim_end().strip_suffix(end))
    {
        text = rest;
    }
    BOXES
        .iter()
        .find_map(|(begin, end)| text.trim().strip_prefix(begin)?.strip_suffix(end))
        .unwrap_or(text)
}

#[cfg(test)]
mod tests {
    use super::bare;

    #[test]
    fn marks_of_templates_are_no_part_of_an_answer() {
        for (answer, expected) in [
            ("keep", "keep"),
            (" keep \n", " keep \n"),
            ("keep<|im_end|>", "keep"),
            ("keep<|im_end|>\n", "keep"),
            ("keep</s></s>", "keep"),
            ("keep<end_of_turn>\n<|endoftext|>", "keep"),
            ("<|begin_of_box|>keep<|end_of_box|>", "keep"),
            ("<|begin_of_box|>keep<|end_of_box|><|user|>", "keep"),
            ("a</s> inside", "a</s> inside"),
            ("<|begin_of_box|>half", "<|begin_of_box|>half"),
            ("<|im_end|>", ""),
            ("", ""),
        ] {
            assert_eq!(bare(answer), expected, "{answer:?}");
        }
    }
}
