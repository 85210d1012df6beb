//! The deadline of a planning call, with local and with scripted models.

use super::request;
use planagent_mllm::{Constraint, Deadline, LocalModel, Mllm, MllmError, PromptPrefix, Request};
use std::sync::Arc;
use std::time::{Duration, Instant};

fn tiny() -> Arc<LocalModel> {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures/tiny_llava");
    Arc::new(LocalModel::open("tiny", folder.as_ref()).unwrap())
}

fn prefix() -> PromptPrefix {
    let image = image::open(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/tests/fixtures/tiny_llava/image.png"
    ))
    .unwrap();
    PromptPrefix {
        system: "Drive safely.".into(),
        image: Some(image.into_rgb8().into()),
    }
}

#[test]
fn a_local_model_stops_between_tokens_and_answers_later_as_if_never_asked() {
    let model = tiny();
    let long = Request {
        max_new_tokens: 200,
        deadline: Deadline::after(Instant::now(), Duration::from_millis(1)),
        ..request(Constraint::Regex("[ab]{200}".into()))
    };
    let short = request(Constraint::Regex("[a-f]{6}".into()));
    let mut conversation = model.converse(&prefix(), 5).unwrap();
    // The deadline passes during the answer: 200 tokens take many milliseconds.
    assert!(matches!(
        conversation.ask("Which lane?", &long),
        Err(MllmError::Deadline)
    ));
    let again = conversation.ask("Where to?", &short).unwrap();
    let fresh = model
        .converse(&prefix(), 5)
        .unwrap()
        .ask("Where to?", &short)
        .unwrap();
    assert_eq!(
        (again.text, again.prompt_hash),
        (fresh.text, fresh.prompt_hash)
    );
}

#[test]
fn a_local_model_does_not_begin_after_its_deadline() {
    let model = tiny();
    let late = Request {
        deadline: Deadline::after(Instant::now(), Duration::ZERO),
        ..request(Constraint::Free)
    };
    let mut conversation = model.converse(&prefix(), 0).unwrap();
    assert!(matches!(
        conversation.ask("Which lane?", &late),
        Err(MllmError::Deadline)
    ));
}

#[test]
fn a_far_deadline_changes_no_answer() {
    let model = tiny();
    let ask = |deadline| {
        let request = Request {
            deadline,
            ..request(Constraint::Free)
        };
        model
            .converse(&prefix(), 0)
            .unwrap()
            .ask("Which lane?", &request)
            .unwrap()
            .text
    };
    assert_eq!(
        ask(Deadline::NONE),
        ask(Deadline::after(Instant::now(), Duration::from_hours(1)))
    );
}
