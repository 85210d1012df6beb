//! Answers under a constraint.

use super::{FIRST, open, prefix, request};
use planagent_mllm::{
    Answer, Constraint, ConstraintUse, Deadline, FinishReason, Mllm, MllmError, Request, Sampling,
};

fn answer(constraint: Constraint, max_new_tokens: usize) -> Result<Answer, MllmError> {
    let model = open();
    let mut conversation = model.converse(&prefix(), 0).unwrap();
    conversation.ask(FIRST, &request(constraint, max_new_tokens))
}

fn texts(texts: &[&str]) -> Constraint {
    Constraint::Choice(texts.iter().map(ToString::to_string).collect())
}

#[test]
fn a_choice_is_one_of_its_texts() {
    let odd = [
        "keep \"lane\"",
        "left\nand \\ back",
        "überholen \u{1f697}",
        "keep",
    ];
    let chosen = answer(texts(&odd), 60).unwrap();
    assert!(odd.contains(&chosen.text.as_str()), "{chosen:?}");
    for only in odd {
        let answer = answer(texts(&[only]), 60).unwrap();
        assert_eq!(answer.text, only);
        assert_eq!(
            (answer.finish, answer.tokens.sampled),
            (FinishReason::Complete, 0)
        );
    }
}

#[test]
fn what_the_grammar_forces_is_not_chosen() {
    let code = r#"start: "Generate_IDM_Planner(c=" ("left" | "right") ", v0=" /[0-9]\.[0-9]/ ")""#;
    let answer = answer(Constraint::Lark(code.into()), 80).unwrap();
    let inside = answer
        .text
        .strip_prefix("Generate_IDM_Planner(c=")
        .unwrap()
        .strip_suffix(')')
        .unwrap();
    let (lane, speed) = inside.split_once(", v0=").unwrap();
    assert!(
        ["left", "right"].contains(&lane) && speed.len() == 3,
        "{}",
        answer.text
    );
    assert_eq!(answer.finish, FinishReason::Complete);
    // Sampled are one token of the lane, and the digits around the point.
    assert!(answer.tokens.sampled <= 4, "{:?}", answer.tokens);
    assert!(
        answer.tokens.fast_forwarded > answer.tokens.sampled,
        "{:?}",
        answer.tokens
    );
}

#[test]
fn a_sequence_is_its_parts_one_after_the_other() {
    let parts = vec![
        texts(&["lane="]),
        texts(&["left", "right"]),
        texts(&[", because "]),
        Constraint::Regex("[a-f]{3}".into()),
    ];
    let answer = answer(Constraint::Sequence(parts), 80).unwrap();
    let (lane, why) = answer
        .text
        .strip_prefix("lane=")
        .unwrap()
        .split_once(", because ")
        .unwrap();
    assert!(
        ["left", "right"].contains(&lane) && why.len() == 3,
        "{}",
        answer.text
    );
    assert_eq!(
        (answer.finish, answer.constraint),
        (FinishReason::Complete, ConstraintUse::Enforced)
    );
}

#[test]
fn forced_tokens_are_spelled_as_the_tokenizer_spells_them() {
    let text = "Generate_IDM_Planner(c=left, la=agent 3, v0=8.5)";
    let tokenizer = tokenizers::Tokenizer::from_file(super::tiny().join("tokenizer.json")).unwrap();
    let expected = tokenizer.encode(text, false).unwrap().len();
    let answer = answer(texts(&[text]), 80).unwrap();
    assert_eq!(
        (answer.text.as_str(), answer.tokens.fast_forwarded),
        (text, expected)
    );
}

#[test]
fn a_regular_expression_is_matched_as_a_whole() {
    let answer = answer(Constraint::Regex("(yes|no), [a-f]{3} m/s".into()), 40).unwrap();
    let (word, rest) = answer.text.split_once(", ").unwrap();
    assert!(["yes", "no"].contains(&word));
    assert!(rest.len() == 7 && rest.ends_with(" m/s"), "{}", answer.text);
}

#[test]
fn an_answer_that_is_cut_short_says_so() {
    let answer = answer(Constraint::Regex("a{50}".into()), 7).unwrap();
    assert_eq!(
        (
            answer.finish,
            answer.tokens.fast_forwarded + answer.tokens.sampled
        ),
        (FinishReason::Length, 7)
    );
    let none = super::constraints::answer(texts(&["keep"]), 0).unwrap();
    assert_eq!(
        (none.text.as_str(), none.finish),
        ("", FinishReason::Length)
    );
}

#[test]
fn sampled_answers_obey_as_well() {
    let model = open();
    let mut seen = std::collections::BTreeSet::new();
    for seed in 0..24 {
        let mut conversation = model.converse(&prefix(), seed).unwrap();
        let request = Request {
            constraint: texts(&["keep lane", "left", "right"]),
            max_new_tokens: 20,
            sampling: Sampling::Sample {
                temperature: 5.0,
                top_p: 1.0,
            },
            deadline: Deadline::NONE,
            draft: None,
        };
        seen.insert(conversation.ask(FIRST, &request).unwrap().text);
    }
    let seen: Vec<&str> = seen.iter().map(String::as_str).collect();
    assert_eq!(seen, ["keep lane", "left", "right"]);
}

#[test]
fn what_does_not_compile_is_an_error_and_never_dropped() {
    for constraint in [
        texts(&[]),
        texts(&["keep", ""]),
        Constraint::Regex(String::new()),
        Constraint::Regex("(unclosed".into()),
        Constraint::Regex("trailing\\".into()),
        Constraint::Lark("start: undefined_rule".into()),
        Constraint::Lark("this is no grammar".into()),
        Constraint::Lark(String::new()),
        Constraint::Sequence(Vec::new()),
        Constraint::Sequence(vec![Constraint::Free]),
    ] {
        match answer(constraint.clone(), 10) {
            Err(MllmError::Grammar {
                constraint: shown,
                problem,
            }) => {
                assert!(!shown.is_empty() && !problem.is_empty());
            }
            other => panic!("{constraint:?}: {other:?}"),
        }
    }
}

#[test]
fn impossible_sampling_is_an_error() {
    let model = open();
    let mut conversation = model.converse(&prefix(), 0).unwrap();
    let mut request = request(Constraint::Free, 3);
    request.sampling = Sampling::Sample {
        temperature: -1.0,
        top_p: 0.5,
    };
    assert!(matches!(
        conversation.ask(FIRST, &request),
        Err(MllmError::Request { .. })
    ));
}

#[test]
fn a_placeholder_in_an_answer_is_text_and_the_chat_goes_on() {
    let model = open();
    let mut conversation = model.converse(&prefix(), 0).unwrap();
    let answer = conversation
        .ask(FIRST, &request(texts(&["see <image> </s>"]), 60))
        .unwrap();
    assert_eq!(answer.text, "see <image> </s>");
    let next = conversation
        .ask("And now?", &request(texts(&["yes", "no"]), 8))
        .unwrap();
    assert!(["yes", "no"].contains(&next.text.as_str()));
}
