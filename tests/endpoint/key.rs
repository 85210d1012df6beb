//! A server that repeats the API key: in answers, errors and headers, in every encoding, at every
//! place.

use super::server::{Reaction, Server, completion, error, response, stream};
use super::{ask, request, settings};
use base64::Engine;
use base64::engine::general_purpose::{STANDARD, URL_SAFE_NO_PAD};
use planagent_mllm::{Constraint, Endpoint, EndpointSettings};

/// Environment variable with a key; Cargo sets it for every test.
const VARIABLE: &str = "CARGO_PKG_DESCRIPTION";
/// Its value, as long as a key and with characters that addresses escape.
const KEY: &str = env!("CARGO_PKG_DESCRIPTION");
/// Longest part of the key that may be seen, characters.
const MAX_PART: usize = 11;

fn encodings() -> Vec<String> {
    let percent = KEY
        .bytes()
        .map(|byte| format!("%{byte:02X}"))
        .collect::<Vec<_>>()
        .concat();
    let hexadecimal = KEY
        .bytes()
        .map(|byte| format!("{byte:02x}"))
        .collect::<Vec<_>>()
        .concat();
    vec![
        KEY.to_owned(),
        percent,
        KEY.replace(' ', "%20").replace('\'', "%27"),
        STANDARD.encode(format!("Bearer {KEY}")),
        URL_SAFE_NO_PAD.encode(KEY),
        hexadecimal,
    ]
}

/// Whether a text has a part of the key, or of an encoding of it, that is long enough to be of use.
fn leaks(text: &str) -> bool {
    let part = |encoded: &String| {
        let bytes = encoded.as_bytes();
        let length = (MAX_PART + 1) * encoded.len().div_ceil(KEY.len());
        bytes
            .windows(length + 4)
            .any(|part| text.contains(std::str::from_utf8(part).unwrap()))
    };
    encodings().iter().any(part)
}

/// What is seen of a server's reaction: the answer, or the error.
fn seen(react: impl Fn() -> Reaction + Send + Sync + 'static) -> String {
    let server = Server::always(react);
    let settings = EndpointSettings {
        key_env: Some(VARIABLE.to_owned()),
        retries: 0,
        ..settings(&server.url())
    };
    let endpoint = Endpoint::open("test", &settings).unwrap();
    let text = match ask(&endpoint, &request(Constraint::Free)) {
        Ok(answer) => answer.text,
        Err(error) => format!("{error} {error:?}"),
    };
    assert!(
        server.received()[0].head.contains(KEY),
        "the header has the key"
    );
    text
}

#[test]
fn no_answer_and_no_error_has_the_key() {
    for encoded in encodings() {
        assert!(leaks(&encoded), "the test sees {encoded}");
        let said = format!("before {encoded} after");
        let reactions: [fn(&str) -> Reaction; 7] = [
            |text| completion(text),
            |text| stream(&[text], true),
            |text| error("401 Unauthorized", "", text),
            |text| error("503 Service Unavailable", "", text),
            |text| {
                Reaction::Send(response(
                    "302 Found",
                    &format!("Location: http://a.b/?key={text}\r\n"),
                    "",
                ))
            },
            |text| Reaction::Send(response("200 OK", "", &format!("<html>{text}"))),
            |text| {
                Reaction::Send(response(
                    "200 OK",
                    "",
                    &format!("{{\"choices\": [{{\"finish_reason\": \"{text}\"}}]}}"),
                ))
            },
        ];
        for (number, react) in reactions.into_iter().enumerate() {
            let text = said.clone();
            let shown = seen(move || react(&text));
            assert!(!leaks(&shown), "reaction {number}: {shown}");
            assert!(shown.contains("[key]"), "reaction {number}: {shown}");
        }
    }
}

#[test]
fn no_cut_leaves_a_part_of_the_key() {
    // Messages are cut after 300 characters: the key lies before, across and behind the cut.
    for before in (300 - KEY.len() - 2..=301).step_by(3) {
        let said = format!("{}{KEY}{}", "x".repeat(before), "y".repeat(200));
        let refused = said.clone();
        let shown = seen(move || error("401 Unauthorized", "", &refused));
        assert!(!leaks(&shown), "{before}: {shown}");
        let shown = seen(move || Reaction::Send(response("200 OK", "", &said)));
        assert!(!leaks(&shown), "{before}: {shown}");
    }
    // A stream may end an event within the key.
    for place in (1..KEY.len()).step_by(5) {
        let shown = seen(move || stream(&["a ", &KEY[..place], &KEY[place..], " b"], true));
        assert_eq!(shown, "a [key] b");
    }
}

#[test]
fn a_description_may_not_repeat_the_key() {
    let mut settings = EndpointSettings {
        key_env: Some(VARIABLE.to_owned()),
        ..settings("http://127.0.0.1:1/v1")
    };
    settings.extra.insert(
        "token".into(),
        serde_json::json!({"inner": [STANDARD.encode(KEY)]}),
    );
    let problem = Endpoint::open("test", &settings).unwrap_err().to_string();
    assert!(
        problem.contains("extra") && problem.contains(VARIABLE) && !leaks(&problem),
        "{problem}"
    );
}
