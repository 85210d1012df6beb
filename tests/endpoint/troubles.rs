//! A server that hangs, closes the connection, refuses requests or sends invalid replies.

use super::server::{Reaction, Server, completion, error, models, response, stream};
use super::{EndpointSettings, ask, open, request, settings};
use planagent_mllm::{
    Constraint, Deadline, Endpoint, EndpointFailure, Mllm, MllmError, PromptPrefix, Request,
};
use std::time::{Duration, Instant};

/// The failure of a server and the number of requests.
fn trouble(server: &Server) -> (EndpointFailure, usize) {
    match ask(&open(server), &request(Constraint::Free)) {
        Err(MllmError::Endpoint { endpoint, failure }) => {
            assert!(endpoint.starts_with(&server.url()), "{endpoint}");
            (failure, server.received().len())
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_server_that_hangs_is_left_when_its_time_is_up() {
    for sent in [
        String::new(),
        String::from_utf8(response("200 OK", "", ""))
            .unwrap()
            .replace(": 0", ": 9"),
    ] {
        let server = Server::always(move || Reaction::Hang(sent.clone().into_bytes()));
        let soon = EndpointSettings {
            timeout_ms: 150,
            ..settings(&server.url())
        };
        let asked = Instant::now();
        match ask(
            &Endpoint::open("test", &soon).unwrap(),
            &request(Constraint::Free),
        ) {
            Err(
                error @ MllmError::Endpoint {
                    failure: EndpointFailure::Timeout(_),
                    ..
                },
            ) => {
                assert!(
                    error.is_transient() && error.to_string().contains("timeout_ms"),
                    "{error}"
                );
            }
            other => panic!("{other:?}"),
        }
        assert!(asked.elapsed() >= Duration::from_millis(150));
        assert_eq!(server.received().len(), 1, "no retry after the time limit");
    }
}

#[test]
fn nobody_listens() {
    let server = Server::always(|| completion("left"));
    let url = server.url();
    drop(server);
    let failed = ask(
        &Endpoint::open("test", &settings(&url)).unwrap(),
        &request(Constraint::Free),
    )
    .unwrap_err();
    assert!(
        matches!(
            &failed,
            MllmError::Endpoint {
                failure: EndpointFailure::Connect(_),
                ..
            }
        ),
        "{failed:?}"
    );
    assert!(failed.is_transient());
}

#[test]
fn a_connection_that_closes_is_tried_again() {
    let whole = String::from_utf8(response("200 OK", "", r#"{"choices": []}"#)).unwrap();
    let half = whole.as_bytes()[..whole.len() - 5].to_vec();
    for sent in [Vec::new(), b"HTTP/1.1 200".to_vec(), half] {
        let server = Server::always(move || Reaction::Send(sent.clone()));
        let (failure, requests) = trouble(&server);
        assert!(matches!(failure, EndpointFailure::Closed(_)), "{failure:?}");
        assert_eq!(requests, 3);
    }
    let server = Server::start(|number, _| {
        if number < 2 {
            Reaction::Send(Vec::new())
        } else {
            completion("left")
        }
    });
    assert_eq!(
        ask(&open(&server), &request(Constraint::Free))
            .unwrap()
            .text,
        "left"
    );
}

#[test]
fn a_stream_that_is_cut_is_tried_again() {
    let server = Server::always(|| stream(&["le"], false));
    let (failure, requests) = trouble(&server);
    assert!(matches!(failure, EndpointFailure::Closed(_)), "{failure:?}");
    assert_eq!(requests, 3);
    let server = Server::start(|number, _| stream(&["le", "ft"], number > 0));
    assert_eq!(
        ask(&open(&server), &request(Constraint::Free))
            .unwrap()
            .text,
        "left",
        "no part comes twice"
    );
}

#[test]
fn invalid_replies_are_reported_and_not_retried() {
    for invalid in [
        "{\"choices\": [",
        "<html>Welcome</html>",
        "{\"choices\": []}",
        "null",
    ] {
        let server = Server::always(move || Reaction::Send(response("200 OK", "", invalid)));
        let (failure, requests) = trouble(&server);
        assert!(
            matches!(failure, EndpointFailure::Unusable(_)),
            "the first reply: {failure:?}"
        );
        assert_eq!(requests, 1);
        // Behind an answer, the same reply costs one call.
        let server = Server::start(move |number, _| {
            if number == 0 {
                completion("left")
            } else {
                Reaction::Send(response("200 OK", "", invalid))
            }
        });
        let endpoint = open(&server);
        ask(&endpoint, &request(Constraint::Free)).unwrap();
        let failed = ask(&endpoint, &request(Constraint::Free)).unwrap_err();
        assert!(failed.is_transient(), "{failed}");
        assert!(
            matches!(
                failed,
                MllmError::Endpoint {
                    failure: EndpointFailure::InvalidReply(_),
                    ..
                }
            ),
            "{failed:?}"
        );
    }
}

#[test]
fn a_busy_server_is_given_the_time_it_asks_for() {
    let server = Server::start(|number, _| match number {
        0 => error("429 Too Many Requests", "Retry-After: 1\r\n", "slow down"),
        _ => completion("left"),
    });
    let asked = Instant::now();
    assert_eq!(
        ask(&open(&server), &request(Constraint::Free))
            .unwrap()
            .text,
        "left"
    );
    assert!(
        asked.elapsed() >= Duration::from_secs(1),
        "{:?}",
        asked.elapsed()
    );
    assert_eq!(server.received().len(), 2);
}

#[test]
fn a_wait_longer_than_a_request_may_take_is_not_waited_for() {
    let server = Server::always(|| {
        error(
            "503 Service Unavailable",
            "Retry-After: 3600\r\n",
            "come back later",
        )
    });
    let (failure, requests) = trouble(&server);
    assert_eq!(
        (failure, requests),
        (
            EndpointFailure::Wait {
                status: 503,
                seconds: 3600
            },
            1
        )
    );
}

#[test]
fn a_server_that_keeps_failing_is_given_up() {
    let server = Server::always(|| error("500 Internal Server Error", "", "out of memory"));
    let (failure, requests) = trouble(&server);
    assert_eq!(
        failure,
        EndpointFailure::Unavailable {
            status: 500,
            message: "out of memory".into()
        }
    );
    assert_eq!(requests, 3);
}

#[test]
fn a_wrong_key_ends_the_matter_and_is_not_shown() {
    // Cargo sets this variable, so the test need not change the environment.
    let (variable, key) = ("CARGO_MANIFEST_DIR", env!("CARGO_MANIFEST_DIR"));
    let server = Server::always(move || {
        error(
            "401 Unauthorized",
            "",
            &format!("Incorrect API key: {key}."),
        )
    });
    let settings = EndpointSettings {
        key_env: Some(variable.into()),
        ..settings(&server.url())
    };
    let endpoint = Endpoint::open("test", &settings).unwrap();
    let failed = ask(&endpoint, &request(Constraint::Free)).unwrap_err();
    assert!(!failed.is_transient(), "{failed}");
    assert!(
        failed
            .to_string()
            .contains("status 401: Incorrect API key: [key]."),
        "{failed}"
    );
    let [received] = server.received().try_into().unwrap();
    assert!(
        received
            .head
            .contains(&format!("authorization: Bearer {key}\r\n")),
        "{}",
        received.head
    );
    for shown in [
        format!("{endpoint:?}"),
        format!("{failed:?}"),
        format!("{:?}", endpoint.describe()),
    ] {
        assert!(!shown.contains(key), "{shown}");
    }
}

#[test]
fn what_the_server_does_not_know_ends_the_matter() {
    for status in ["400 Bad Request", "404 Not Found", "301 Moved Permanently"] {
        let server = Server::always(move || error(status, "", "no such thing"));
        let (failure, requests) = trouble(&server);
        assert!(
            matches!(failure, EndpointFailure::Refused { .. }),
            "{failure:?}"
        );
        assert_eq!(requests, 1);
    }
    let server = Server::start(|number, _| match number {
        0 => error("404 Not Found", "", "model 'test-model' not found"),
        _ => models(&["eye", "ear"], "library"),
    });
    let (failure, requests) = trouble(&server);
    assert!(
        failure
            .to_string()
            .ends_with("not found; the server offers eye, ear"),
        "{failure}"
    );
    assert_eq!(requests, 2, "the list is asked for once");
    assert!(
        server.received()[1]
            .head
            .starts_with("GET /v1/models HTTP/1.1\r\n")
    );
}

#[test]
fn an_endless_answer_is_cut_off() {
    let start =
        b"HTTP/1.1 200 OK\r\nConnection: close\r\nContent-Type: application/json\r\n\r\n".to_vec();
    let server =
        Server::always(move || Reaction::Repeat([start.clone(), vec![b' '; 1 << 16]].concat()));
    assert!(matches!(trouble(&server), (EndpointFailure::TooLong(_), 1)));
    let start =
        b"HTTP/1.1 200 OK\r\nConnection: close\r\nContent-Type: text/event-stream\r\n\r\n".to_vec();
    let server =
        Server::always(move || Reaction::Repeat([start.clone(), vec![b'x'; 1 << 16]].concat()));
    assert!(matches!(trouble(&server), (EndpointFailure::TooLong(_), 1)));
}

#[test]
fn the_deadline_bounds_request_and_wait() {
    let within = |milliseconds| Request {
        deadline: Deadline::after(Instant::now(), Duration::from_millis(milliseconds)),
        ..request(Constraint::Free)
    };
    let hanging = Server::always(|| Reaction::Hang(Vec::new()));
    assert!(matches!(
        ask(&open(&hanging), &within(150)),
        Err(MllmError::Deadline)
    ));
    let busy =
        Server::always(|| error("429 Too Many Requests", "Retry-After: 10\r\n", "slow down"));
    let asked = Instant::now();
    assert!(matches!(
        ask(&open(&busy), &within(5000)),
        Err(MllmError::Deadline)
    ));
    assert!(
        asked.elapsed() < Duration::from_secs(5),
        "a wait beyond the deadline is not begun"
    );
    let absent = Endpoint::open("test", &settings("http://127.0.0.1:1")).unwrap();
    let failed = ask(&absent, &within(20)).unwrap_err();
    assert!(
        matches!(
            &failed,
            MllmError::Endpoint {
                failure: EndpointFailure::Connect(_),
                ..
            }
        ),
        "{failed:?}"
    );
    let passed = Request {
        deadline: Deadline::after(Instant::now(), Duration::ZERO),
        ..request(Constraint::Free)
    };
    assert!(matches!(
        ask(&open(&busy), &passed),
        Err(MllmError::Deadline)
    ));
    assert_eq!(
        busy.received().len(),
        1,
        "nothing is sent after the deadline"
    );
}

#[test]
fn after_a_failure_the_conversation_is_as_it_was() {
    let server = Server::start(|number, _| match number {
        1 => Reaction::Send(response("200 OK", "", "no JSON")),
        _ => completion("left"),
    });
    let endpoint = open(&server);
    let mut conversation = endpoint.converse(&PromptPrefix::default(), 0).unwrap();
    conversation
        .ask("first", &request(Constraint::Free))
        .unwrap();
    conversation
        .ask("second", &request(Constraint::Free))
        .unwrap_err();
    conversation
        .ask("second", &request(Constraint::Free))
        .unwrap();
    let received = server.received();
    assert_eq!(received[1].body, received[2].body);
}
