//! Contents of models and servers, whole and in pieces.

use super::*;

/// The answer in a content, which is the same in every piece that a stream may have.
fn found(content: &str) -> Found {
    let mut whole = Reader::default();
    whole.push(content);
    let whole = whole.finish();
    let characters: Vec<String> = content.chars().map(String::from).collect();
    for length in [1, 2, 3, 7] {
        let mut reader = Reader::default();
        let mut known = String::new();
        for piece in characters.chunks(length) {
            reader.push(&piece.concat());
            if let Some(text) = reader.known() {
                assert!(
                    text.starts_with(&known),
                    "{content}: {known} and then {text}"
                );
                text.clone_into(&mut known);
            }
        }
        let restarted = reader.restarted;
        let pieces = reader.finish();
        assert_eq!(pieces, whole, "{content} in pieces of {length}");
        assert!(
            restarted || pieces.text.starts_with(&known) || pieces.reasoned,
            "{content}: {known}"
        );
    }
    whole
}

/// The text of the answer.
fn text(content: &str) -> String {
    found(content).text
}

#[test]
fn every_mark_of_reasoning_is_known() {
    let tags = NAMES_OF_MODELS.map(|name| (format!("<{name}>"), format!("</{name}>")));
    let others = [
        ("[THINK]", "[/THINK]"),
        ("[REASONING]", "[/REASONING]"),
        ("◁think▷", "◁/think▷"),
        ("<|open|>think<|sep|>", "<|close|>think<|sep|><|open|>response<|sep|>"),
        ("<|START_THINKING|>", "<|END_THINKING|><|START_RESPONSE|>"),
        ("<|begin_of_thought|>", "<|end_of_thought|>\n<|begin_of_solution|>"),
        ("<|thought_start|>", "<|thought_end|>"),
        ("<|inner_prefix|>", "<|inner_suffix|>"),
        ("<unused94>thought\n", "<unused95>"),
        ("[unused16]", "[unused17]"),
        ("<|channel>thought\n", "<channel|>"),
        ("<|think:start|>", "<|think:end|>"),
        ("<|thinking|>", "<|/thinking|>"),
        ("<|reasoning|>", "<|/reasoning|>"),
        ("<|think|>", "<|/think|>"),
        ("<|think|>", "<|end|><|begin|>assistant<|content|>"),
        (
            "<|channel|>analysis<|message|>",
            "<|end|><|start|>assistant<|channel|>final<|message|>",
        ),
        (
            "<|start|>assistant<|channel|>analysis<|message|>",
            "<|start|>assistant<|channel|>final <|constrain|>json<|message|>",
        ),
        ("<|channel|>commentary<|message|>", "<|channel|>final<|message|>"),
        (
            "<|start|>assistant to=self<|message|>",
            "<|eom|><|start|>assistant to=user<|message|>",
        ),
        ("/think\n", "<|im_end|>\n<|im_start|>assistant\n"),
        (
            "<details type=\"reasoning\" done=\"true\" duration=\"3\">\n<summary>Thought</summary>\n",
            "</details>",
        ),
        ("analysis", "assistantfinal"),
        ("analysis\n", "\nassistantfinal\n"),
        ("analysis", "assistantcommentaryHm.assistantfinal"),
        ("Here is my thought process:\n", "Here is my response:\n"),
        ("Here's my thought process: ", "Here's my response: "),
        ("Thinking...\n", "\n...done thinking.\n\n"),
        ("<SUMMARY>The lane is free.</SUMMARY>", "<CONCLUSION>"),
    ]
    .map(|(begin, end)| (begin.to_owned(), end.to_owned()));
    for (begin, end) in tags.iter().chain(&others) {
        for gap in ["", "\n\n"] {
            let content = format!("{begin}Hm. The lane is free.{end}{gap}keep, i < 3");
            let expected = Found {
                text: "keep, i < 3".into(),
                reasoned: true,
            };
            assert_eq!(found(&content), expected, "{content}");
        }
    }
}

const NAMES_OF_MODELS: [&str; 14] = [
    "think",
    "thinking",
    "Thought",
    "reasoning",
    "reason",
    "analysis",
    "reflection",
    "antThinking",
    "SCRATCHPAD",
    "seed:think",
    "mm:think",
    "longcat_think",
    "ifm|think_fast",
    "think:opensource",
];

#[test]
fn tags_have_attributes_and_odd_forms() {
    for content in [
        "<think time=\"3\">Hm.</think>keep",
        "<think foo=\"x\" bar='y'>\nHm.\n</think >\nkeep",
        "<think\n  effort=\"low\"\n>Hm.</think>keep",
        "<THINK>Hm.</Think>keep",
        "<think/>keep",
        "<think />\n\nkeep",
        "<think></think>keep",
        "<think>\n\n</think>\n\nkeep",
        "\n<thinking signature=\"abc\">Hm.</thinking><answer>keep",
    ] {
        assert_eq!(text(content), "keep", "{content}");
    }
    for plain in [
        "<thinker>keep",
        "<think!>keep",
        "<thinks>keep",
        "<think<b>keep",
    ] {
        assert_eq!(text(plain), plain);
    }
}

#[test]
fn reasoning_may_hold_its_own_marks() {
    for content in [
        "<think>a <think> b</think> c</think>keep",
        "<think>a<think>b<think>c</think>d</think>e</think>keep",
        "[THINK]a[THINK]b[/THINK]c[/THINK]keep",
        "<think><reasoning>a</reasoning></think>keep",
        "<think>a</think><think>b</think>keep",
        "<think>a</think>b</think>keep",
        "<think>He wrote <think> twice.</think>keep",
        "<think>He wrote `</think>` and \"</think>\".</think>keep",
        "Hm. <think> b</think> c</think>keep",
        "<details type=\"reasoning\"><details>a</details>b</details>keep",
    ] {
        assert_eq!(text(content), "keep", "{content}");
    }
}

#[test]
fn an_end_without_a_beginning_ends_reasoning() {
    for content in [
        "Hm.\n</think>\n\nkeep",
        "</think>keep",
        "\n</think>\n\nkeep",
        "Hm.</Thought>keep",
        "Hm.[/THINK]keep",
        "Hm.◁/think▷keep",
        "Hm.<|think:end|>keep",
        "Hm.<|END_THINKING|><|START_RESPONSE|>keep",
        "Hm.<channel|>keep",
        "Hm.</think><answer>keep",
        "a</think>b</think>keep",
        "We need a plan. So final.assistantfinalkeep",
        "We need a plan.\nassistantfinal\nkeep",
        "assistantfinalkeep",
        "Hm.<|end|><|start|>assistant<|channel|>final<|message|>keep",
        "Hm. I am sure.\n<answer>keep</answer>",
        "Hm.\n<answer> keep</answer>\n<|im_end|>",
    ] {
        assert_eq!(found(content).text, "keep", "{content}");
        assert!(found(content).reasoned, "{content}");
    }
    assert_eq!(
        text("We. assistantfinaljson{\"answer\": 1}"),
        "We. assistantfinaljson{\"answer\": 1}"
    );
    assert_eq!(
        text("We.assistantfinaljson{\"answer\": 1}"),
        "{\"answer\": 1}"
    );
    assert_eq!(
        text("We.assistantfinal json\n{\"answer\": 1}"),
        "{\"answer\": 1}"
    );
}

#[test]
fn what_comes_between_marks_in_an_answer_is_left_out() {
    for (content, expected) in [
        ("keep\n<think>Hm.</think>\nleft", "keep\n\nleft"),
        ("keep.<think>Hm.</think> left", "keep. left"),
        ("keep\n[THINK]Hm.[/THINK]", "keep\n"),
        ("keep\n<think>Hm.", "keep\n<think>Hm."),
    ] {
        assert_eq!(text(content), expected, "{content}");
    }
}

#[test]
fn a_mention_of_a_mark_is_part_of_the_answer() {
    for content in [
        "keep",
        " keep",
        "keep <think> left",
        "The tags <think> and <answer> differ",
        "Use `</think>` at the end",
        "`<think>` begins it, \"</think>\" ends it",
        "'[/THINK]' is Mistral's",
        "analysis of the lane",
        "analysis: the lane is free",
        "analysis",
        "analyses",
        "analysisResult is keep",
        "the word assistantfinal is odd",
        "'assistantfinal'",
        "Here is my thought process: the lane is free. Keep",
        "Thinking about it, keep",
        "Thinking...",
        "<thin line",
        "<thi",
        "<",
        "◁",
        "[keep]",
        "[Thinking it over] keep",
        "keep</think>",
        "keep assist",
        "to=them",
        "json is a format",
        "jso",
        "<plan>keep</plan><reason>the lane is free</reason> end",
        "keep <analysis>free</analysis> left",
        "<analysis>keep</analysis>",
        "<reason>keep",
        "<details><summary>a</summary>b</details>",
        "<details class=\"x\">b</details> keep",
        "keep<|end|><|end|>",
        "x <answer> y",
        "i < 3 and [4]",
        " \n",
        "",
    ] {
        let expected = Found {
            text: content.to_owned(),
            reasoned: false,
        };
        assert_eq!(found(content), expected, "{content}");
    }
}

#[test]
fn reasoning_without_an_answer_is_none() {
    for content in [
        "<think>Hm. </thi",
        "<think>Hm.</think>",
        "<think>Hm.</think>\n\n",
        "<think",
        "<|channel|>analysis<|message|>Hm",
        "<|channel|>analysis<|message|>Hm.<|end|>",
        "analysisWe need to choose",
        "analysisHm.assistantfinal",
        "Hm.</think><think>Hm.",
        "Hm.</think><think>Hm.</think>",
    ] {
        let expected = Found {
            text: String::new(),
            reasoned: true,
        };
        if content == "<think" {
            assert_eq!(text(content), content, "perhaps the beginning of an answer");
        } else {
            assert_eq!(found(content), expected, "{content}");
        }
    }
}

#[test]
fn marks_of_the_prompt_are_no_part_of_an_answer() {
    for content in [
        "<|im_start|>assistant\nkeep",
        "<start_of_turn>model\nkeep",
        "<|start_header_id|>assistant<|end_header_id|>\n\nkeep",
        "<|header_start|>assistant<|header_end|>\n\nkeep",
        "<|start_of_role|>assistant<|end_of_role|>keep",
        " [/INST] keep",
        "[|assistant|]keep",
        "<s>keep",
        "<bos><start_of_turn>model\nkeep",
        "<|START_OF_TURN_TOKEN|><|CHATBOT_TOKEN|>keep",
        "<|begin_of_box|>keep",
        "<Output>keep",
        "<|channel|>final <|constrain|>json<|message|>keep",
        "to=user<|message|>keep",
    ] {
        assert_eq!(text(content), "keep", "{content}");
    }
}

#[test]
fn long_contents_are_read_once() {
    for piece in [
        "<think>",
        "<think ",
        "<",
        "a<",
        "</think>x",
        "assistantfina",
        "analysisa ",
        "[",
        "<think></think>",
    ] {
        let mut reader = Reader::default();
        for _ in 0..100_000 {
            reader.push(piece);
        }
        let _ = reader.finish();
    }
}
