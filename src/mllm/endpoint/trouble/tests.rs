//! Error replies as servers write them.

use super::*;
use serde_json::json;

fn behind(status: u16, body: &str) -> EndpointFailure {
    Trouble::behind(StatusCode::from_u16(status).unwrap(), body.as_bytes()).failure(&str::to_owned)
}

fn in_reply(reply: &Value) -> Option<EndpointFailure> {
    Trouble::in_reply(reply).map(|trouble| trouble.failure(&str::to_owned))
}

fn refused(status: u16, message: &str) -> EndpointFailure {
    EndpointFailure::Refused {
        status,
        message: message.into(),
    }
}

fn unavailable(status: u16, message: &str) -> EndpointFailure {
    EndpointFailure::Unavailable {
        status,
        message: message.into(),
    }
}

#[test]
fn errors_are_told_in_the_servers_words() {
    for (what, body, told) in [
        (
            "OpenAI",
            r#"{"error": {"message": "no such field", "type": "x", "code": null}}"#,
            "no such field",
        ),
        (
            "LM Studio",
            r#"{"error": "Unexpected endpoint"}"#,
            "Unexpected endpoint",
        ),
        (
            "older vLLM, SGLang",
            r#"{"object": "error", "message": "too long", "type": "BadRequest"}"#,
            "too long",
        ),
        ("FastAPI", r#"{"detail": "Not Found"}"#, "Not Found"),
        (
            "FastAPI, wrong fields",
            r#"{"detail": [{"loc": ["body", "messages", 0], "msg": "field required", "type": "missing"}]}"#,
            "body.messages.0: field required",
        ),
        (
            "KoboldCpp",
            r#"{"detail": {"msg": "busy with others", "type": "t"}}"#,
            "busy with others",
        ),
        (
            "Cohere",
            r#"{"message": "invalid request"}"#,
            "invalid request",
        ),
        (
            "Cloudflare",
            r#"{"success": false, "errors": [{"code": 7, "message": "no route"}], "result": null}"#,
            "no route",
        ),
        (
            "Gemini",
            r#"[{"error": {"code": 400, "message": "bad name", "status": "INVALID_ARGUMENT"}}]"#,
            "bad name",
        ),
        (
            "Anthropic",
            r#"{"type": "error", "error": {"type": "not_found_error", "message": "model: x"}}"#,
            "model: x",
        ),
        (
            "problem details",
            r#"{"title": "Bad Request", "status": 400, "detail": "no body"}"#,
            "no body",
        ),
        (
            "Mistral",
            r#"{"object": "error", "message": {"detail": [{"loc": ["body", "seed"], "msg": "Extra inputs are not permitted"}]}}"#,
            "body.seed: Extra inputs are not permitted",
        ),
        (
            "an error in an error",
            r#"{"error": {"error": {"msg": "deep"}}}"#,
            "deep",
        ),
        (
            "Spring",
            r#"{"status": 400, "error": "Bad Request", "message": "no route"}"#,
            "no route",
        ),
        ("no words", r#"{"error": {"code": 3}}"#, r#"{"code":3}"#),
        ("a text", " Bad thing\n", "Bad thing"),
        ("a text in quotes", r#""bad thing""#, "bad thing"),
        (
            "a web page",
            "<!DOCTYPE html>\n<html><head><TITLE> 400 Bad </TITLE></head></html>",
            "a web page, '400 Bad'",
        ),
        (
            "a page without a title",
            "<html>Bad</html>",
            "<html>Bad</html>",
        ),
        ("nothing", "", "Bad Request"),
        ("null", "null", "null"),
    ] {
        assert_eq!(behind(400, body), refused(400, told), "{what}");
    }
    let long = "x".repeat(1000);
    assert!(
        matches!(behind(400, &long), EndpointFailure::Refused { message, .. } if message.len() == 303)
    );
}

#[test]
fn an_error_with_status_200_is_found_and_an_answer_is_none() {
    for (what, reply, failure) in [
        (
            "LM Studio",
            json!({"error": "Unexpected endpoint"}),
            refused(200, "Unexpected endpoint"),
        ),
        (
            "a code",
            json!({"error": {"code": 401, "message": "no key"}}),
            refused(401, "no key"),
        ),
        (
            "digits",
            json!({"error": {"code": "404", "message": "no model"}}),
            refused(404, "no model"),
        ),
        (
            "OpenRouter",
            json!({"error": {"code": 502, "message": "provider"}}),
            unavailable(502, "provider"),
        ),
        (
            "OpenRouter, choice",
            json!({"choices": [{"error": {"code": 429, "message": "slow"}}]}),
            unavailable(429, "slow"),
        ),
        (
            "Ollama",
            json!({"error": {"type": "api_error", "message": "runner stopped"}}),
            unavailable(200, "runner stopped"),
        ),
        (
            "older vLLM",
            json!({"object": "error", "message": "crash", "code": 500}),
            unavailable(500, "crash"),
        ),
        (
            "Gemini",
            json!([{"error": {"code": 503, "message": "later"}}]),
            unavailable(503, "later"),
        ),
        (
            "FastAPI",
            json!({"detail": "Not Found"}),
            refused(200, "Not Found"),
        ),
        (
            "Cloudflare",
            json!({"success": false, "errors": [{"message": "no route"}]}),
            refused(200, "no route"),
        ),
        (
            "a message",
            json!({"message": "no route"}),
            refused(200, "no route"),
        ),
    ] {
        assert_eq!(in_reply(&reply), Some(failure), "{what}");
    }
    for reply in [
        json!({"choices": [{"message": {"content": "keep"}}], "error": null}),
        json!({"choices": [{"message": {"content": "keep"}}], "error": ""}),
        json!({"choices": [{"message": {"content": "keep"}}], "error": {}}),
        json!({"choices": [{"message": {"content": "keep"}}], "error": {"code": null, "message": null}}),
        json!({"choices": [{"message": {"content": "keep"}}], "message": "ok", "detail": "beside"}),
        json!({"message": {"role": "assistant", "content": "of another interface"}}),
        json!({}),
        json!(null),
        json!([]),
    ] {
        assert_eq!(in_reply(&reply), None, "{reply}");
    }
}

#[test]
fn what_passes_and_what_lasts_are_told_apart() {
    let error = |message: &str| json!({"error": {"message": message}}).to_string();
    for status in [408, 409, 425, 429, 500, 502, 503, 504, 529] {
        assert_eq!(behind(status, &error("wait")), unavailable(status, "wait"));
    }
    for status in [400, 401, 402, 403, 404, 405, 413, 422, 501, 505] {
        assert_eq!(behind(status, &error("no")), refused(status, "no"));
    }
    for (status, body) in [
        (
            429,
            r#"{"error": {"message": "You are out of money", "code": "insufficient_quota"}}"#,
        ),
        (
            500,
            r#"{"error": {"message": "image input is not supported - hint: you may need to provide the mmproj"}}"#,
        ),
        (500, r#"{"error": {"message": "Failed to parse grammar"}}"#),
    ] {
        assert!(
            matches!(behind(status, body), EndpointFailure::Refused { .. }),
            "{body}"
        );
    }
}

#[test]
fn a_server_that_loads_is_told_from_one_that_cannot() {
    for body in [
        r#"{"error": {"code": 503, "message": "Loading model", "type": "unavailable_error"}}"#,
        r#"{"status": "loading model"}"#,
        r#"{"error": "Model a/b is currently loading", "estimated_time": 20.0}"#,
        "The model is loading",
        r#"{"detail": "Model is not yet loaded"}"#,
        "Server is warming up, try again later",
        r#"{"error": {"message": "the engine is not ready"}}"#,
    ] {
        assert!(
            matches!(
                behind(503, body),
                EndpointFailure::Loading { status: 503, .. }
            ),
            "{body}"
        );
    }
    let inside = json!({"error": {"code": 503, "message": "Loading model"}});
    assert!(matches!(
        in_reply(&inside),
        Some(EndpointFailure::Loading { status: 503, .. })
    ));
    for status in [409, 425, 429, 500, 502, 503, 504] {
        let failure = behind(status, "Loading model");
        assert!(
            matches!(failure, EndpointFailure::Loading { .. }),
            "{status}"
        );
    }
    for (status, message) in [
        (503, "error loading model: no memory"),
        (503, "busy"),
        (500, "the engine is not ready"),
        (429, "the queue is initializing"),
    ] {
        assert!(
            matches!(behind(status, message), EndpointFailure::Unavailable { .. }),
            "{message}"
        );
    }
}
