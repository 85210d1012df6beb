//! The search against the probabilities of all answers, each computed from its beginning.

use super::test_reference::fixture;
use super::{Loading, LocalModel, Sequence};
use crate::decoder::Logits;
use crate::family::Chat;
use crate::source::ModelPlace;
use crate::{Constraint, Deadline, Mllm, MllmError, PromptPrefix, Request, Sampling};
use candle_core::Tensor;
use std::collections::BTreeMap;

const PROMPT: &str = "What now?";

fn model(name: &str) -> LocalModel {
    LocalModel::load(
        "tiny",
        &ModelPlace::Folder(fixture(name)),
        &Loading::default(),
    )
    .unwrap()
}

/// Two places with several words each, some of which begin alike.
fn constraint() -> Constraint {
    let words =
        |words: &[&str]| Constraint::Choice(words.iter().map(ToString::to_string).collect());
    let end = Constraint::OneOf(vec![
        words(&["1", "12"]),
        Constraint::Sequence(vec![words(&["2"]), words(&["3", "4"])]),
    ]);
    Constraint::Sequence(vec![
        words(&["go("]),
        words(&["left", "lane", "right"]),
        words(&[", v="]),
        end,
        words(&[")"]),
    ])
}

fn request(constraint: Constraint, max_new_tokens: usize) -> Request {
    Request {
        constraint,
        max_new_tokens,
        sampling: Sampling::Greedy,
        deadline: Deadline::NONE,
        draft: None,
    }
}

/// The logarithm of the probability of each spelling of each answer, by walking through all tokens
/// that the grammar allows.
fn all_spellings(
    local: &LocalModel,
    prompt: &[u32],
    answer: &[u32],
    log: f64,
    found: &mut Vec<(f64, String)>,
) {
    let mut grammar = local.grammars.begin(&constraint()).unwrap().unwrap();
    if !answer.is_empty() {
        grammar.consume(answer).unwrap();
    }
    let forced = grammar.take_fast_forwarded().unwrap();
    let answer = [answer, &forced].concat();
    if grammar.is_complete() {
        found.push((log, local.tokenizer.decode_verbatim(&answer)));
        return;
    }
    let allowed = grammar.allowed().unwrap();
    let mut sequence = Sequence::new(&*local.model);
    let ids = [prompt, &answer].concat();
    let logits = sequence
        .append(&*local.model, &ids, None, Logits::Tail(1))
        .unwrap();
    let logits = logits
        .as_ref()
        .map(Tensor::to_vec2::<f32>)
        .unwrap()
        .unwrap()
        .remove(0);
    let weights: Vec<(u32, f64)> = (0..logits.len() as u32)
        .filter(|token| allowed.is_allowed(*token))
        .map(|token| (token, f64::from(logits[token as usize]).exp()))
        .collect();
    let total: f64 = weights.iter().map(|(_, weight)| weight).sum();
    for (token, weight) in weights {
        let ends = local.end_tokens.contains(&token);
        assert!(!ends, "the answers of this grammar end by themselves");
        all_spellings(
            local,
            prompt,
            &[answer.as_slice(), &[token]].concat(),
            log + (weight / total).ln(),
            found,
        );
    }
}

#[test]
fn the_likeliest_answers_are_those_of_all_answers() {
    for name in ["tiny_llava", "tiny_llava_next_mistral"] {
        let local = model(name);
        let chat = Chat {
            system: "",
            images: &[],
            turns: &[],
            prompt: PROMPT,
        };
        let prompt = local.prompt_ids(&chat).unwrap();
        let mut spellings = Vec::new();
        all_spellings(&local, &prompt, &[], 0.0, &mut spellings);
        let mut texts: BTreeMap<String, f64> = BTreeMap::new();
        for (log, text) in &spellings {
            let best = texts.entry(text.clone()).or_insert(f64::NEG_INFINITY);
            *best = best.max(*log);
        }
        assert_eq!(texts.len(), 12, "{name}: {texts:?}");
        let mut expected: Vec<(&String, f64)> =
            texts.iter().map(|(text, log)| (text, *log)).collect();
        expected.sort_by(|a, b| b.1.total_cmp(&a.1));
        let expected: Vec<&str> = expected.iter().map(|(text, _)| text.as_str()).collect();
        // A plain answer says how likely its own spelling is.
        let mut conversation = local.converse(&PromptPrefix::default(), 5).unwrap();
        let greedy = conversation
            .ask(PROMPT, &request(constraint(), 40))
            .unwrap();
        let likely = greedy.log_probability.unwrap();
        assert!(
            spellings
                .iter()
                .any(|(log, text)| *text == greedy.text && (log - likely).abs() < 1e-3),
            "{name}: {likely} of {spellings:?}"
        );
        for count in [1, 2, 4, 12, 20] {
            let mut conversation = local.converse(&PromptPrefix::default(), 5).unwrap();
            let answers = conversation
                .ask_likeliest(PROMPT, &request(constraint(), 40), count)
                .unwrap();
            let found: Vec<&str> = answers.iter().map(|answer| answer.text.as_str()).collect();
            assert_eq!(
                found,
                expected[..count.min(12)],
                "{name}: {count} of {spellings:?}"
            );
            for answer in &answers {
                let found = answer.log_probability.unwrap();
                let expected = texts[&answer.text];
                assert!((found - expected).abs() < 1e-3, "{found} {expected}");
            }
            // The likeliest answer is the turn; the next round sees the same chat as after a plain
            // answer.
            let next = conversation
                .ask("And now?", &request(Constraint::Free, 4))
                .unwrap();
            let mut plain = local.converse(&PromptPrefix::default(), 5).unwrap();
            let only = Constraint::Choice(vec![found[0].to_owned()]);
            plain.ask(PROMPT, &request(only, 40)).unwrap();
            let after = plain
                .ask("And now?", &request(Constraint::Free, 4))
                .unwrap();
            assert_eq!(
                (next.text, next.prompt_hash),
                (after.text, after.prompt_hash),
                "{name}: {count}"
            );
        }
    }
}

#[test]
fn an_error_of_a_search_leaves_the_conversation_as_it_was() {
    let local = model("tiny_llava");
    let mut conversation = local.converse(&PromptPrefix::default(), 5).unwrap();
    let before = conversation.mark();
    let past = Deadline::after(std::time::Instant::now(), std::time::Duration::ZERO);
    let late = Request {
        deadline: past,
        ..request(constraint(), 40)
    };
    assert!(matches!(
        conversation.ask_likeliest(PROMPT, &late, 3),
        Err(MllmError::Deadline)
    ));
    assert_eq!(conversation.mark(), before);
}
