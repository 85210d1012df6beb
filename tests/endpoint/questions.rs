//! Requests and answers.

use super::server::{Server, completion, stream};
use super::{ask, open, request, settings};
use base64::Engine;
use image::RgbImage;
use planagent_mllm::{
    Constraint, ConstraintUse, Conversation, Endpoint, FinishReason, GrammarField, LimitField,
    Mllm, MllmError, PromptPrefix, Request, Sampling, TokenCounts,
};
use serde_json::{Value, json};

fn lanes() -> Constraint {
    Constraint::Choice(vec!["left".into(), "right".into()])
}

/// How many pictures each question of a request has.
fn pictures(body: &Value) -> Vec<usize> {
    let messages = body["messages"].as_array().unwrap().iter();
    let asked = messages.filter(|message| message["role"] == "user");
    asked
        .map(|message| {
            let parts = message["content"].as_array().map_or(&[][..], Vec::as_slice);
            parts
                .iter()
                .filter(|part| part["type"] == "image_url")
                .count()
        })
        .collect()
}

#[test]
fn pictures_are_sent_in_the_turns_that_they_were_shown_in() {
    let server = Server::start(|number, _| completion(&format!("answer {number}")));
    let endpoint = open(&server);
    let picture = |side| std::sync::Arc::new(RgbImage::new(side, 4));
    let prefix = PromptPrefix {
        system: String::new(),
        image: Some(picture(1)),
    };
    let mut conversation = endpoint.converse(&prefix, 3).unwrap();
    let start = conversation.mark();
    let ask = |conversation: &mut Box<dyn Conversation + '_>| {
        conversation
            .ask("Which lane?", &request(Constraint::Free))
            .unwrap();
    };
    conversation.show(&[picture(2)]).unwrap();
    ask(&mut conversation);
    ask(&mut conversation);
    conversation.show(&[picture(3), picture(4)]).unwrap();
    ask(&mut conversation);
    conversation.rewind(start);
    ask(&mut conversation);
    let received = server.received();
    let sent: Vec<Vec<usize>> = received.iter().map(|sent| pictures(&sent.body)).collect();
    assert_eq!(sent, [vec![2], vec![2, 0], vec![2, 0, 2], vec![1]]);
    let content = &received[2].body["messages"][4]["content"];
    assert_ne!(content[0], content[1], "the pictures differ");
    assert_eq!(content[2]["text"], "Which lane?");
}

#[test]
fn rounds_are_turns_and_the_image_is_in_the_first() {
    let server = Server::start(|number, _| completion(&format!("answer {number}")));
    let endpoint = open(&server);
    let image = RgbImage::from_fn(40, 40, |x, y| image::Rgb([x as u8, y as u8, 7]));
    let prefix = PromptPrefix {
        system: "Drive.".into(),
        image: Some(image.clone().into()),
    };
    let mut conversation = endpoint.converse(&prefix, 3).unwrap();
    let start = conversation.mark();
    conversation
        .ask("first", &request(Constraint::Free))
        .unwrap();
    let second = conversation
        .ask("second", &request(Constraint::Free))
        .unwrap();
    conversation.rewind(start);
    conversation
        .ask("again", &request(Constraint::Free))
        .unwrap();

    let [first, both, again] = server.received().try_into().unwrap();
    assert!(
        first
            .head
            .starts_with("POST /v1/chat/completions HTTP/1.1\r\n"),
        "{}",
        first.head
    );
    assert!(
        !first.head.to_lowercase().contains("authorization"),
        "{}",
        first.head
    );
    assert_eq!(
        first.body["messages"][0],
        json!({"role": "system", "content": "Drive."})
    );
    let content = &first.body["messages"][1]["content"];
    assert_eq!(content[1], json!({"type": "text", "text": "first"}));
    let url = content[0]["image_url"]["url"].as_str().unwrap();
    let png = base64::prelude::BASE64_STANDARD
        .decode(url.strip_prefix("data:image/png;base64,").unwrap())
        .unwrap();
    assert_eq!(image::load_from_memory(&png).unwrap().into_rgb8(), image);
    let said = |body: &Value| -> Vec<(String, Value)> {
        let messages = body["messages"].as_array().unwrap().iter().skip(2);
        messages
            .map(|m| (m["role"].as_str().unwrap().to_owned(), m["content"].clone()))
            .collect()
    };
    assert_eq!(
        said(&both.body),
        [
            ("assistant".into(), json!("answer 0")),
            ("user".into(), json!("second"))
        ]
    );
    assert_eq!(again.body["messages"].as_array().unwrap().len(), 2);
    assert_eq!(again.body["messages"][1]["content"][1]["text"], "again");
    assert_ne!(first.body["seed"], again.body["seed"]);
    assert_eq!(second.text, "answer 1");
    assert_eq!(
        second.tokens,
        TokenCounts {
            text: 60,
            cached: 40,
            sampled: 7,
            ..TokenCounts::default()
        }
    );
    assert_eq!(
        (second.finish, second.constraint),
        (FinishReason::EndOfSequence, ConstraintUse::Unconstrained)
    );
}

#[test]
fn the_same_seed_sends_the_same_bytes() {
    let server = Server::always(|| completion("left"));
    let endpoint = open(&server);
    for seed in [7, 7, 8] {
        let mut conversation = endpoint.converse(&PromptPrefix::default(), seed).unwrap();
        conversation.ask("Which lane?", &request(lanes())).unwrap();
    }
    let [first, same, other] = server.received().try_into().unwrap();
    assert_eq!(first.body, same.body);
    assert_ne!(first.body, other.body);
}

#[test]
fn a_streamed_answer_tells_when_it_began() {
    let server = Server::always(|| stream(&["le", "ft"], true));
    let answer = ask(&open(&server), &request(lanes())).unwrap();
    assert_eq!(
        (answer.text.as_str(), answer.constraint),
        ("left", ConstraintUse::Satisfied)
    );
    let time = answer.time;
    assert!(
        time.first_token > 0.0 && time.first_token <= time.total && time.remote <= time.total,
        "{time:?}"
    );
    assert_eq!(
        (time.prefill, time.decode, time.image_encode),
        (0.0, 0.0, 0.0)
    );
    assert_eq!(
        server.received()[0].body["stream_options"]["include_usage"],
        true
    );

    let whole = Server::always(|| completion("left"));
    let unstreamed = Endpoint::open(
        "test",
        &super::EndpointSettings {
            stream: false,
            ..settings(&whole.url())
        },
    );
    let answer = ask(&unstreamed.unwrap(), &request(lanes())).unwrap();
    assert!(
        answer.time.first_token == 0.0 && answer.time.remote > 0.0,
        "{:?}",
        answer.time
    );
    assert_eq!(whole.received()[0].body["stream"], false);
}

#[test]
fn every_field_for_constraints_is_filled_as_its_servers_read_it() {
    let answers = [
        (GrammarField::None, "left", ConstraintUse::NotSent),
        (GrammarField::Gbnf, "right", ConstraintUse::Satisfied),
        (GrammarField::Gbnf, "Perhaps left.", ConstraintUse::Violated),
        (
            GrammarField::JsonSchema,
            r#"{"answer": "left"}"#,
            ConstraintUse::Satisfied,
        ),
        (GrammarField::JsonSchema, "upwards", ConstraintUse::Violated),
        (
            GrammarField::StructuredOutputs,
            "left",
            ConstraintUse::Satisfied,
        ),
        (GrammarField::GuidedRegex, "left", ConstraintUse::Satisfied),
        (GrammarField::Regex, "left", ConstraintUse::Satisfied),
        (GrammarField::TaggedRegex, "left", ConstraintUse::Satisfied),
    ];
    let server = Server::start(move |number, _| completion(answers[number].1));
    for (grammar, sent, constraint) in answers {
        let endpoint = Endpoint::open(
            "test",
            &super::EndpointSettings {
                grammar,
                ..settings(&server.url())
            },
        )
        .unwrap();
        let answer = ask(&endpoint, &request(lanes())).unwrap();
        let text = if sent.starts_with('{') { "left" } else { sent };
        assert_eq!(
            (answer.text.as_str(), answer.constraint),
            (text, constraint),
            "{grammar:?}"
        );
    }
    let received = server.received();
    let fields = [
        "grammar",
        "response_format",
        "structured_outputs",
        "guided_regex",
        "regex",
    ];
    let present: Vec<usize> = received
        .iter()
        .map(|request| {
            fields
                .iter()
                .filter(|field| request.body.get(field).is_some())
                .count()
        })
        .collect();
    assert_eq!(
        present,
        [0, 1, 1, 1, 1, 1, 1, 1, 1],
        "one field and no other"
    );
    assert_eq!(
        received[1].body["grammar"],
        r#"root ::= ("left" | "right")"#
    );
    let format = &received[3].body["response_format"];
    assert_eq!(
        (&format["type"], &format["json_schema"]["strict"]),
        (&json!("json_schema"), &json!(true))
    );
    assert_eq!(
        format["json_schema"]["schema"]["properties"]["answer"]["pattern"],
        "^(left|right)$"
    );
    assert_eq!(
        received[5].body["structured_outputs"],
        json!({"regex": "(left|right)"})
    );
    assert_eq!(received[6].body["guided_regex"], "(left|right)");
    assert_eq!(received[7].body["regex"], "(left|right)");
    assert_eq!(
        received[8].body["grammar"],
        json!({"type": "regex", "value": "(left|right)"})
    );
}

#[test]
fn what_cannot_be_sent_is_an_error_and_nothing_is_sent() {
    let server = Server::always(|| completion("left"));
    let endpoint = open(&server);
    let refused = ask(
        &endpoint,
        &request(Constraint::Lark("start: \"left\"".into())),
    );
    assert!(
        matches!(refused, Err(MllmError::Grammar { .. })),
        "{refused:?}"
    );
    let cold = Request {
        sampling: Sampling::Sample {
            temperature: -1.0,
            top_p: 1.0,
        },
        ..request(Constraint::Free)
    };
    assert!(matches!(
        ask(&endpoint, &cold),
        Err(MllmError::Request { .. })
    ));
    assert!(server.received().is_empty());
}

#[test]
fn a_description_may_leave_fields_out_and_add_others() {
    let server = Server::always(|| completion("left"));
    let settings = super::EndpointSettings {
        limit: LimitField::MaxCompletionTokens,
        omit: vec!["temperature".into(), "seed".into()],
        extra: [("reasoning_effort".to_owned(), json!("none"))]
            .into_iter()
            .collect(),
        ..settings(&server.url())
    };
    ask(
        &Endpoint::open("test", &settings).unwrap(),
        &request(Constraint::Free),
    )
    .unwrap();
    let sampled = Request {
        sampling: Sampling::Sample {
            temperature: 0.5,
            top_p: 0.25,
        },
        ..request(Constraint::Free)
    };
    ask(&open(&server), &sampled).unwrap();
    let [bare, full] = server.received().try_into().unwrap();
    assert!(
        bare.body.get("temperature").is_none() && bare.body.get("seed").is_none(),
        "{}",
        bare.body
    );
    assert_eq!(
        (
            &bare.body["max_completion_tokens"],
            &bare.body["reasoning_effort"]
        ),
        (&json!(50), &json!("none"))
    );
    assert_eq!(
        (&full.body["temperature"], &full.body["top_p"]),
        (&json!(0.5), &json!(0.25))
    );
    assert_eq!(
        (&full.body["max_tokens"], &full.body["model"]),
        (&json!(50), &json!("test-model"))
    );
}
