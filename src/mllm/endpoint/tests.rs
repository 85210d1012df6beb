//! Questions to servers that differ: which failures last, what is said about them, and which model
//! is asked.

use super::Endpoint;
use super::fake_server::{FakeServer, answer, ask, asked, response, settings};
use crate::{
    EndpointFailure, EndpointSettings, GrammarField, Mllm, MllmError, ProbeQuestion, Sampling,
};

const CHAT: &str = "POST /v1/chat/completions";
const LIST: &str = "GET /v1/models";

/// A completion whose only choice has these fields.
fn choice(fields: &str) -> String {
    response("200 OK", &format!(r#"{{"choices": [{{{fields}}}]}}"#))
}

#[test]
fn a_fault_that_no_retry_mends_is_told_at_the_first_request() {
    for (what, reply, told) in [
        (
            "LM Studio: an error with status 200",
            response("200 OK", r#"{"error": "Unexpected endpoint"}"#),
            "Unexpected endpoint",
        ),
        (
            "a web page",
            response("200 OK", "<html><title>Chat</title></html>"),
            "a web page, 'Chat'",
        ),
        (
            "another interface",
            response("200 OK", r#"{"message": {"content": "x"}}"#),
            "no finished choice",
        ),
        (
            "all reasoning",
            choice(
                r#""message": {"content": null, "reasoning_content": "Hm."}, "finish_reason": "stop""#,
            ),
            "reasoning parser",
        ),
        (
            "all reasoning, cut",
            choice(r#""message": {"content": "<think>Hm"}, "finish_reason": "length""#),
            "max_new_tokens",
        ),
        (
            "a tool",
            choice(r#""message": {"tool_calls": []}, "finish_reason": "tool_calls""#),
            "called a tool",
        ),
        (
            "no money",
            response(
                "429 Too Many Requests",
                r#"{"error": {"code": "insufficient_quota", "message": "pay"}}"#,
            ),
            "pay",
        ),
        (
            "not implemented",
            response("501 Not Implemented", ""),
            "Not Implemented",
        ),
        (
            "moved",
            response("308 Permanent Redirect", "")
                .replace("Connection", "Location: http://b.example/\r\nConnection"),
            "moved to http://b.example/",
        ),
        (
            "a refused field",
            response(
                "400 Bad Request",
                r#"{"error": {"message": "unknown field seed"}}"#,
            ),
            "omit = [\"seed\"]",
        ),
    ] {
        let (result, passes, requests) = asked(vec![reply]);
        let error = result.unwrap_err();
        assert!(
            error.contains(told) && error.contains("/v1/chat/completions: "),
            "{what}: {error}"
        );
        assert!(!passes, "{what}: {error}");
        assert_eq!(requests, [CHAT], "{what}");
    }
}

#[test]
fn after_an_answer_an_odd_reply_costs_one_call_and_no_more() {
    let page = response("200 OK", "<html></html>");
    let reasoning =
        choice(r#""message": {"content": "", "reasoning": "Hm."}, "finish_reason": "stop""#);
    for odd in [page, reasoning] {
        let server = FakeServer::start(vec![answer("left"), odd, answer("right")]);
        let endpoint = Endpoint::open("test", &settings(&server.url())).unwrap();
        assert_eq!(ask(&endpoint).unwrap().text, "left");
        let failed = ask(&endpoint).unwrap_err();
        assert!(failed.is_transient(), "{failed}");
        assert_eq!(ask(&endpoint).unwrap().text, "right");
    }
}

#[test]
fn a_refused_prompt_says_nothing_about_the_next() {
    for (fields, told) in [
        (
            r#""message": {"content": ""}, "finish_reason": "content_filter""#,
            "a filter of the server",
        ),
        (
            r#""message": {"content": null, "refusal": "I cannot"}, "finish_reason": "stop""#,
            "the model refuses: I cannot",
        ),
    ] {
        let (result, passes, requests) = asked(vec![choice(fields)]);
        let error = result.unwrap_err();
        assert!(
            passes && error.contains(told) && requests.len() == 1,
            "{error}"
        );
    }
}

#[test]
fn faults_that_pass_are_retried() {
    let error = |status: &str| response(status, r#"{"error": {"message": "busy"}}"#);
    for passing in [
        error("408 Request Timeout"),
        error("429 Too Many Requests"),
        error("529 Overloaded"),
        response(
            "200 OK",
            r#"{"error": {"code": 502, "message": "provider"}}"#,
        ),
        response(
            "200 OK",
            "data: {\"error\": {\"type\": \"server_error\", \"message\": \"crash\"}}\n\ndata: [DONE]\n\n",
        ),
        response(
            "200 OK",
            "data: {\"choices\": [{\"delta\": {\"content\": \"le\"}}]}\n\nevent: error\ndata: gone\n\n",
        ),
        choice(r#""message": {"content": "le"}, "finish_reason": "abort""#),
        String::new(),
    ] {
        let (result, _, requests) = asked(vec![passing.clone(), answer("left")]);
        assert_eq!(
            (result.as_deref(), requests.len()),
            (Ok("left"), 2),
            "{passing}"
        );
    }
}

#[test]
fn a_server_that_loads_its_model_is_waited_for() {
    let loading = response(
        "503 Service Unavailable",
        r#"{"error": {"code": 503, "message": "Loading model"}}"#,
    );
    let (result, _, requests) = asked(vec![
        loading.clone(),
        loading.clone(),
        loading.clone(),
        answer("left"),
    ]);
    assert_eq!(
        (result.as_deref(), requests.len()),
        (Ok("left"), 4),
        "more requests than retries"
    );

    let opened = |responses: Vec<String>| {
        let server = FakeServer::start(responses);
        let soon = EndpointSettings {
            timeout_ms: 200,
            ..settings(&server.url())
        };
        (Endpoint::open("test", &soon).unwrap(), server)
    };
    let (endpoint, server) = opened(vec![loading.clone()]);
    let failed = ask(&endpoint).unwrap_err();
    assert!(
        matches!(
            &failed,
            MllmError::Endpoint {
                failure: EndpointFailure::Loading { .. },
                ..
            }
        ),
        "{failed:?}"
    );
    let text = failed.to_string();
    assert!(
        text.contains("status 503: Loading model") && text.contains("timeout_ms"),
        "{text}"
    );
    assert!(
        !failed.is_transient(),
        "no later request is likelier to succeed"
    );
    let before = server.requests().len();
    ask(&endpoint).unwrap_err();
    assert_eq!(
        server.requests().len(),
        before + 1,
        "the time to load is given once"
    );

    let (endpoint, _server) = opened(vec![answer("left"), loading]);
    ask(&endpoint).unwrap();
    let failed = ask(&endpoint).unwrap_err();
    assert!(
        failed.is_transient(),
        "a server that answered loads another model: {failed}"
    );
}

#[test]
fn an_unknown_model_is_answered_with_those_that_there_are() {
    let list = response(
        "200 OK",
        r#"{"object": "list", "data": [{"id": "ear"}, {"id": "nose:7b"}]}"#,
    );
    for refusal in [
        response(
            "404 Not Found",
            r#"{"error": {"message": "model 'eye' not found", "type": "not_found_error"}}"#,
        ),
        response(
            "404 Not Found",
            r#"{"object": "error", "message": "The model `eye` does not exist.", "code": 404}"#,
        ),
        response(
            "400 Bad Request",
            r#"{"error": {"message": "eye is not a valid model ID"}}"#,
        ),
        response("200 OK", r#"{"error": "No models loaded"}"#),
    ] {
        let (result, passes, requests) = asked(vec![refusal, list.clone()]);
        let error = result.unwrap_err();
        assert!(
            !passes && error.contains("the server offers ear, nose:7b"),
            "{error}"
        );
        assert_eq!(requests, [CHAT, LIST]);
    }
    let refusal = response("404 Not Found", r#"{"error": "model 'eye' not found"}"#);
    for no_list in [
        response("404 Not Found", ""),
        response("200 OK", "no JSON"),
        response("200 OK", r#"{"data": []}"#),
    ] {
        let (result, _, _) = asked(vec![refusal.clone(), no_list]);
        assert!(
            result
                .unwrap_err()
                .ends_with("status 404: model 'eye' not found"),
            "a list that is none explains nothing"
        );
    }
}

#[test]
fn an_address_without_a_version_is_told_so() {
    let server = FakeServer::start(vec![response(
        "200 OK",
        r#"{"error": "Unexpected endpoint or method."}"#,
    )]);
    let bare = server.url().replace("/v1", "");
    let error = ask(&Endpoint::open("test", &settings(&bare)).unwrap())
        .unwrap_err()
        .to_string();
    let expected = [
        format!("{bare}/chat/completions: "),
        "Unexpected endpoint or method.".into(),
        format!("/v1 may be missing: try endpoint = \"{bare}/v1\""),
    ];
    assert!(expected.iter().all(|part| error.contains(part)), "{error}");
}

#[test]
fn a_server_without_a_description_is_asked_for_its_only_model() {
    let open = |list: &str, address: &dyn Fn(String) -> String| {
        let server = FakeServer::start(vec![response("200 OK", list), answer("left")]);
        let settings = EndpointSettings::of_address(&address(server.url())).unwrap();
        let opened = Endpoint::open("test", &settings);
        if let Ok(endpoint) = &opened {
            assert_eq!(ask(endpoint).unwrap().text, "left");
        }
        (opened, server.requests())
    };
    let as_is = |url: String| url;
    let (endpoint, requests) = open(
        r#"{"data": [{"id": "eye:7b", "owned_by": "library"}]}"#,
        &as_is,
    );
    let endpoint = endpoint.unwrap();
    assert_eq!(endpoint.describe().server.unwrap().model, "eye:7b");
    assert_eq!(
        (endpoint.settings.grammar, requests),
        (GrammarField::None, vec![LIST.to_owned(), CHAT.to_owned()])
    );

    let (endpoint, _) = open(
        r#"{"data": [{"id": "eye.gguf", "owned_by": "llamacpp"}]}"#,
        &as_is,
    );
    assert_eq!(endpoint.unwrap().settings.grammar, GrammarField::Gbnf);
    let (endpoint, _) = open(r#"{"data": [{"id": "eye"}]}"#, &|url| {
        url.replace("/v1", "/")
    });
    assert_eq!(endpoint.unwrap().settings.model, "eye");

    for (list, told) in [
        (
            r#"{"data": [{"id": "ear"}, {"id": "eye"}]}"#,
            "offers ear, eye;",
        ),
        (r#"{"data": []}"#, "offers no model;"),
    ] {
        let error = open(list, &as_is).0.unwrap_err();
        assert!(matches!(&error, MllmError::ChooseModel { .. }), "{error:?}");
        assert!(
            error.to_string().contains(told) && error.to_string().contains("/v1#NAME"),
            "{error}"
        );
    }
    let named = FakeServer::start(vec![answer("left")]);
    let settings = EndpointSettings::of_address(&format!("{}#ear", named.url())).unwrap();
    ask(&Endpoint::open("test", &settings).unwrap()).unwrap();
    assert_eq!(
        named.requests(),
        [CHAT],
        "a model that is named needs no list"
    );
}

#[test]
fn a_stream_that_stays_open_after_the_answer_ends_soon() {
    let piece = r#"{"choices": [{"delta": {"content": "left"}}]}"#;
    let end = r#"{"choices": [{"delta": {}, "finish_reason": "stop"}]}"#;
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("http://{}/v1", listener.local_addr().unwrap());
    std::thread::spawn(move || {
        use std::io::{Read, Write};
        let (mut stream, _) = listener.accept().unwrap();
        let mut buffer = vec![0; 65536];
        let _ = stream.read(&mut buffer);
        let head = "HTTP/1.1 200 OK\r\nContent-Type: text/event-stream\r\n\r\n";
        let body = format!("{head}data: {piece}\n\ndata: {end}\n\n");
        stream.write_all(body.as_bytes()).unwrap();
        // Neither a mark nor the end of the connection.
        std::thread::sleep(std::time::Duration::from_secs(20));
    });
    let mut patient = settings(&address);
    patient.timeout_ms = 15_000;
    let started = std::time::Instant::now();
    let answer = ask(&Endpoint::open("test", &patient).unwrap()).unwrap();
    assert_eq!(answer.text, "left");
    assert!(
        started.elapsed() < std::time::Duration::from_secs(10),
        "{:?}",
        started.elapsed()
    );
}

#[test]
fn a_picture_is_sent_as_a_text_after_a_refusal_that_asks_for_it() {
    let refusal = response(
        "422 Unprocessable Entity",
        r#"{"error": {"message": "body.messages.0.content.0.image_url: Input should be a valid string"}}"#,
    );
    let server = FakeServer::start(vec![refusal.clone(), answer("left"), answer("right")]);
    let endpoint = Endpoint::open("test", &settings(&server.url())).unwrap();
    let with_picture = |endpoint: &Endpoint| {
        let prefix = crate::PromptPrefix {
            system: String::new(),
            image: Some(std::sync::Arc::new(image::RgbImage::new(2, 2))),
        };
        let request = crate::Request {
            constraint: crate::Constraint::Free,
            max_new_tokens: 5,
            sampling: crate::Sampling::Greedy,
            deadline: crate::Deadline::NONE,
            draft: None,
        };
        endpoint
            .converse(&prefix, 0)?
            .ask("Which lane?", &request)
            .map(|answer| answer.text)
    };
    assert_eq!(with_picture(&endpoint).unwrap(), "left");
    assert_eq!(with_picture(&endpoint).unwrap(), "right");
    assert_eq!(server.requests().len(), 3, "the form is remembered");
    // A server that refuses both says so once.
    let server = FakeServer::start(vec![refusal]);
    let endpoint = Endpoint::open("test", &settings(&server.url())).unwrap();
    let error = with_picture(&endpoint).unwrap_err().to_string();
    assert_eq!(error.matches("image_url").count(), 1, "{error}");
    assert_eq!(server.requests().len(), 2);
}

#[test]
fn an_answer_without_a_choice_is_a_turn_that_no_server_is_asked_for() {
    let server = FakeServer::start(vec![answer("left")]);
    let endpoint = Endpoint::open("test", &settings(&server.url())).unwrap();
    let mut conversation = endpoint
        .converse(&crate::PromptPrefix::default(), 0)
        .unwrap();
    let request = |constraint| crate::Request {
        constraint,
        max_new_tokens: 5,
        sampling: crate::Sampling::Greedy,
        deadline: crate::Deadline::NONE,
        draft: None,
    };
    let given = request(crate::Constraint::Choice(vec!["keep the lane".to_owned()]));
    let first = conversation.ask("What now?", &given).unwrap();
    assert_eq!(
        (first.text.as_str(), server.requests().len()),
        ("keep the lane", 0)
    );
    let second = conversation
        .ask("Which lane?", &request(crate::Constraint::Free))
        .unwrap();
    assert_eq!((second.text.as_str(), server.requests().len()), ("left", 1));
    let sent = server.bodies();
    assert!(
        sent.contains("What now?") && sent.contains("keep the lane"),
        "{sent}"
    );
}

/// The answers of a server's refusals, and the requests and remarks of a probe.
fn probed(refusals: &[(&str, &str)]) -> (Result<Vec<String>, String>, Vec<String>) {
    let body = |message: &str| serde_json::json!({ "error": { "message": message } }).to_string();
    let refused = refusals
        .iter()
        .map(|(status, message)| response(status, &body(message)));
    let answers = [answer("red"), answer("blue"), answer("blue")];
    let server = FakeServer::start(refused.chain(answers).collect());
    let endpoint = Endpoint::open("test", &settings(&server.url())).unwrap();
    let question = ProbeQuestion {
        picture: true,
        constrained: false,
        max_new_tokens: 9,
        sampling: Sampling::Greedy,
    };
    let result = endpoint.probe(&question, &|_| ());
    // Whatever the probe learned, the question after it is answered at once.
    let asked = server.requests();
    ask(&endpoint).unwrap();
    assert_eq!(server.requests().len(), asked.len() + 1);
    (result.map_err(|error| error.to_string()), asked)
}

#[test]
fn a_probe_has_at_most_two_requests_whatever_is_refused() {
    let system = ("400 Bad Request", "System role not supported");
    let picture = ("422 Unprocessable", "image_url must be a string");
    for (refusals, remark) in [
        (vec![], ""),
        (vec![system], ""),
        (vec![system, picture], "asks for another"),
    ] {
        let (result, asked) = probed(&refusals);
        assert_eq!(asked.len(), 2, "{refusals:?}");
        let told = result.unwrap().join("\n");
        assert!(
            told.contains(remark) && told.is_empty() == remark.is_empty(),
            "{refusals:?}: {told}"
        );
    }
}
