//! Whole replies and streams as servers write them.

use super::*;

impl Body for std::io::Repeat {}

fn read_as(
    body: &str,
    whole: bool,
    on_text: &mut dyn FnMut(&str),
) -> Result<Reply, EndpointFailure> {
    read(
        body.as_bytes(),
        Listen {
            hide: &str::to_owned,
            asked: "http://127.0.0.1:8080/v1/chat/completions",
            whole,
            on_text,
        },
    )
}

fn reply(body: &str) -> Result<Reply, EndpointFailure> {
    read_as(body, false, &mut |_| ())
}

/// A stream of these data.
fn stream(events: &[&str]) -> String {
    events
        .iter()
        .flat_map(|event| ["data: ", event, "\n\n"])
        .collect()
}

#[test]
fn a_whole_completion_is_read() {
    let body = r#"{"id": "x", "choices": [{"index": 0, "message": {"role": "assistant", "content": "keep"},
        "finish_reason": "length"}], "usage": {"prompt_tokens": 12, "completion_tokens": 3, "total_tokens": 15,
        "prompt_tokens_details": {"cached_tokens": 8}}}"#;
    let reply = reply(body).unwrap();
    assert_eq!(
        (reply.content.as_str(), reply.finish),
        ("keep", FinishReason::Length)
    );
    assert_eq!(
        reply.tokens,
        TokenCounts {
            text: 4,
            cached: 8,
            sampled: 3,
            ..TokenCounts::default()
        }
    );
    assert_eq!(reply.first_text, None);
}

#[test]
fn a_stream_is_gathered_over_comments_and_empty_choices() {
    let body = ": ping\r\n\r\ndata: {\"choices\":[{\"delta\":{\"role\":\"assistant\",\"content\":\"\"}}]}\n\n\
        data: {\"choices\":[{\"delta\":{\"content\":\"ke\"},\"finish_reason\":null}]}\n\nevent: x\n\
        data:{\"choices\":[{\"delta\":{\"content\":\"ep\"}}]}\n\n\
        data: {\"choices\":[{\"delta\":{},\"finish_reason\":\"stop\"}]}\n\n\
        data: {\"choices\":[],\"usage\":{\"prompt_tokens\":5,\"completion_tokens\":2}}\n\ndata: [DONE]\n\n";
    let reply = reply(body).unwrap();
    assert_eq!(
        (reply.content.as_str(), reply.finish),
        ("keep", FinishReason::EndOfSequence)
    );
    assert_eq!((reply.tokens.text, reply.tokens.sampled), (5, 2));
    assert!(reply.first_text.is_some());
}

#[test]
fn a_complete_answer_is_kept_whatever_its_form() {
    let piece = r#"{"choices": [{"delta": {"content": "keep"}}]}"#;
    let end = r#"{"choices": [{"delta": {}, "finish_reason": "stop"}]}"#;
    for (what, body) in [
        ("no finish_reason", r#"{"choices": [{"message": {"content": "keep"}}]}"#.to_owned()),
        (
            "a null finish_reason",
            r#"{"choices": [{"message": {"content": "keep"}, "finish_reason": null}]}"#.to_owned(),
        ),
        ("an unknown one", r#"{"choices": [{"message": {"content": "keep"}, "finish_reason": "eos"}]}"#.to_owned()),
        (
            "odd counts",
            r#"{"choices": [{"message": {"content": "keep"}, "finish_reason": 0}], "usage": "many"}"#.to_owned(),
        ),
        ("parts", r#"{"choices": [{"message": {"content": [{"type": "text", "text": "keep"}]}}]}"#.to_owned()),
        ("the older interface", r#"{"choices": [{"text": "keep", "finish_reason": "stop"}]}"#.to_owned()),
        ("reasoning beside it", r#"{"choices": [{"message": {"content": "keep", "reasoning": "Hm."}}]}"#.to_owned()),
        ("reasoning inside it", r#"{"choices": [{"message": {"content": "<think>Hm.</think>\n\nkeep"}}]}"#.to_owned()),
        (
            "the end of a turn inside it",
            r#"{"choices": [{"message": {"content": "keep<|im_end|>\n"}, "finish_reason": "stop"}]}"#.to_owned(),
        ),
        (
            "tools that are not called",
            r#"{"choices": [{"message": {"content": "keep", "tool_calls": []}, "finish_reason": "tool_calls"}]}"#.to_owned(),
        ),
        (
            "an error of code 0 beside it",
            r#"{"choices": [{"message": {"content": "keep"}}], "error": {"code": 0, "message": ""}}"#.to_owned(),
        ),
        (
            "words of success in the place of an error",
            r#"{"choices": [{"message": {"content": "keep"}, "finish_reason": "stop"}], "error": "success"}"#.to_owned(),
        ),
        (
            "inside a gateway's data",
            r#"{"code": 0, "message": "ok", "data": {"choices": [{"message": {"content": "keep"}}]}}"#.to_owned(),
        ),
        (
            "a number that is none",
            r#"{"choices": [{"message": {"content": "keep"}, "logprobs": -Infinity}], "usage": NaN}"#.to_owned(),
        ),
        ("in a list", format!("[{piece}, {end}]")),
        (
            "Ollama's own",
            r#"{"message": {"content": "keep"}, "done": true, "done_reason": "stop"}"#.to_owned(),
        ),
        (
            "lines of Ollama",
            "{\"message\": {\"content\": \"k\"}, \"done\": false}\n{\"message\": {\"content\": \"eep\"}, \"done\": true}".to_owned(),
        ),
        ("a word that keeps the connection open", stream(&["keep-alive", piece, end, "[DONE]"])),
        (
            "channels",
            r#"{"choices": [{"message": {"content": "<|channel|>analysis<|message|>Hm.<|end|><|start|>assistant<|channel|>final<|message|>keep<|return|>"}}]}"#.to_owned(),
        ),
        ("a choice that is a text", r#"{"choices": ["keep"]}"#.to_owned()),
        (
            "a line of a batch",
            r#"{"custom_id": "1", "response": {"status_code": 200, "body": {"choices": [{"message": {"content": "keep"}}]}}, "error": null}"#.to_owned(),
        ),
        (
            "a text in the reply of a cloud's function",
            r#"{"statusCode": 200, "body": "{\"choices\": [{\"message\": {\"content\": \"keep\"}}]}"}"#.to_owned(),
        ),
        (
            "a text of JSON",
            r#""{\"choices\": [{\"message\": {\"content\": \"keep\"}}]}""#.to_owned(),
        ),
        ("an empty choice before it", r#"{"choices": [null, {"message": {"content": "keep"}}]}"#.to_owned()),
        ("lines of JSON", format!("{piece}\n{end}\n")),
        ("a byte order mark", "\u{feff}{\"choices\": [{\"message\": {\"content\": \"keep\"}}]}".to_owned()),
        (
            "text behind it",
            r#"{"choices": [{"message": {"content": "keep"}, "finish_reason": "stop"}]} and more"#.to_owned(),
        ),
        ("no end mark", stream(&[piece, end])),
        ("no finish_reason in a stream", stream(&[piece, "[DONE]"])),
        (
            "an empty finish_reason",
            stream(&[r#"{"choices": [{"delta": {"content": "keep"}, "finish_reason": ""}]}"#, "[DONE]"]),
        ),
        (
            "the end with the text",
            stream(&[r#"{"choices": [{"delta": {"content": "keep"}, "finish_reason": "stop"}]}"#]),
        ),
        ("nonsense after the end", stream(&[piece, end, "nonsense", "[DONE]"])),
        ("an error after the end", stream(&[piece, end, r#"{"error": {"message": "late"}}"#])),
        (
            "the whole at the end",
            stream(&[piece, r#"{"choices": [{"message": {"content": "keep"}, "finish_reason": "stop"}]}"#]),
        ),
        (
            "streamed parts",
            stream(&[r#"{"choices": [{"delta": {"content": [{"type": "text", "text": "keep"}]}}]}"#, end]),
        ),
        ("streamed reasoning", stream(&[r#"{"choices": [{"delta": {"reasoning_content": "Hm."}}]}"#, piece, end])),
        ("streamed text of the older interface", stream(&[r#"{"choices": [{"text": "keep"}]}"#, end])),
        ("an event of several lines", format!("data: {}\n\n{}", piece.replace(", ", ",\ndata: "), stream(&[end]))),
        ("no data in an event", stream(&[piece, "{}", r#"{"choices": []}"#, r#"{"choices": null}"#, end])),
    ] {
        let read = reply(&body).map(|reply| reply.content);
        assert_eq!(read.as_deref(), Ok("keep"), "{what}");
    }
}

#[test]
fn a_complete_answer_is_kept_when_the_connection_breaks_after_it() {
    struct Broken;
    impl Body for std::io::Chain<&[u8], Broken> {}

    impl Read for Broken {
        fn read(&mut self, _: &mut [u8]) -> std::io::Result<usize> {
            Err(std::io::Error::other("reset"))
        }
    }
    let events = [r#"{"choices": [{"delta": {"content": "keep"}, "finish_reason": "stop"}]}"#];
    let before_break = |body: String| {
        let listen = Listen {
            hide: &str::to_owned,
            asked: "http://127.0.0.1:8080/v1/chat/completions",
            whole: false,
            on_text: &mut |_| (),
        };
        read(body.as_bytes().chain(Broken), listen)
    };
    assert_eq!(before_break(stream(&events)).unwrap().content, "keep");
    let broken =
        before_break(stream(&[r#"{"choices": [{"delta": {"content": "ke"}}]}"#])).unwrap_err();
    assert!(matches!(broken, EndpointFailure::Closed(text) if text.contains("reset")));
}

#[test]
fn pieces_are_passed_on_without_reasoning() {
    let pieces = |texts: &[&str], whole| {
        let event = |text: &&str| {
            serde_json::json!({"choices": [{"delta": {"content": text}}]}).to_string()
        };
        let events: Vec<String> = texts
            .iter()
            .map(event)
            .chain(["[DONE]".to_owned()])
            .collect();
        let body = stream(&events.iter().map(String::as_str).collect::<Vec<_>>());
        let mut told = Vec::new();
        let reply = read_as(&body, whole, &mut |text| told.push(text.to_owned())).unwrap();
        assert_eq!(told.concat(), reply.content, "the pieces are the answer");
        told
    };
    assert_eq!(pieces(&["ke", "ep"], false), ["ke", "ep"]);
    assert_eq!(pieces(&["ke", "ep"], true), ["keep"]);
    assert_eq!(
        pieces(&["<th", "ink>Hm", ".</think>", "\n\nke", "ep"], false),
        ["ke", "ep"]
    );
    assert_eq!(pieces(&["ke", "ep<|im_", "end|>"], false), ["ke", "ep"]);
    assert_eq!(pieces(&["keep<", "b>"], false), ["keep", "<b>"]);
    assert_eq!(pieces(&["<", "b>"], false), ["<b>"]);
    assert_eq!(pieces(&["<"], false), ["<"]);
    assert_eq!(pieces(&["Hm.", "</think>", "keep"], true), ["keep"]);
    assert_eq!(
        pieces(&["Well.\n<think>", "Hm.", "</think>", "keep"], false),
        ["Well.\n", "keep"]
    );
    assert_eq!(
        pieces(&["analysis", "Hm.assis", "tantfinal", "keep"], false),
        ["keep"]
    );
    assert_eq!(
        pieces(&["a", "nalysis", " of it"], false),
        ["analysis of it"]
    );
}

#[test]
fn a_late_end_of_reasoning_ends_what_is_passed_on() {
    let event = |text| serde_json::json!({"choices": [{"delta": {"content": text}}]}).to_string();
    let events = [event("Hm."), event("</think>"), event("ke"), event("ep")];
    let [first, mark, second, third] = events.each_ref().map(String::as_str);
    let body = stream(&[first, mark, second, third, "[DONE]"]);
    let mut told = Vec::new();
    let reply = read_as(&body, false, &mut |text| told.push(text.to_owned())).unwrap();
    assert_eq!(
        (reply.content.as_str(), told),
        ("keep", vec!["Hm.".to_owned()])
    );
}

#[test]
fn an_answer_that_is_all_reasoning_says_what_to_do() {
    for body in [
        r#"{"choices": [{"message": {"content": null, "reasoning_content": "keep"}, "finish_reason": "stop"}]}"#
            .to_owned(),
        r#"{"choices": [{"message": {"content": "", "reasoning": "keep"}, "finish_reason": "length"}]}"#.to_owned(),
        r#"{"choices": [{"message": {"content": "<think>keep"}, "finish_reason": "length"}]}"#.to_owned(),
        r#"{"choices": [{"message": {"content": [{"type": "thinking", "thinking": "keep"}]}}]}"#.to_owned(),
        stream(&[r#"{"choices": [{"delta": {"content": "", "reasoning": "keep"}}]}"#, "[DONE]"]),
    ] {
        let failure = reply(&body).unwrap_err();
        assert!(matches!(&failure, EndpointFailure::NoAnswer(_)), "{body}: {failure:?}");
        let text = failure.to_string();
        assert!(
            ["reasoning parser", "thinking off", "max_new_tokens"].iter().all(|advice| text.contains(advice)),
            "{text}"
        );
    }
    let empty = r#"{"choices": [{"message": {"content": ""}, "finish_reason": "stop"}]}"#;
    assert_eq!(
        reply(empty).unwrap().content,
        "",
        "an answer without text and without reasoning is one"
    );
}

#[test]
fn nonsense_and_broken_answers_are_told_apart() {
    for invalid in [
        "",
        "<html>",
        "[]",
        "{}",
        "null",
        r#"{"choices": []}"#,
        r#"{"choices": [{"finish_reason": "stop"}]}"#,
        "data: nonsense\n\n",
        "data: 3\n\n",
    ] {
        let failure = reply(invalid).unwrap_err();
        assert!(
            matches!(failure, EndpointFailure::InvalidReply(_)),
            "{invalid}: {failure:?}"
        );
    }
    let called = r#"{"choices":[{"message":{"content":"Hm.","tool_calls":[{"id":"1"}]},"finish_reason":"tool_calls"}]}"#;
    assert!(matches!(reply(called), Err(EndpointFailure::NoAnswer(_))));
    let minimax =
        r#"{"choices":null,"base_resp":{"status_code":1004,"status_msg":"token invalid"}}"#;
    assert!(
        matches!(reply(minimax), Err(EndpointFailure::Refused { message, .. }) if message == "token invalid")
    );
    let refusal = r#"{"choices":[{"message":{"refusal":"I cannot"},"finish_reason":"stop"}]}"#;
    assert!(
        matches!(reply(refusal), Err(EndpointFailure::Withheld(text)) if text.contains("I cannot"))
    );
    let begun = r#"{"choices":[{"delta":{"content":"ke"}}]}"#;
    let role = r#"{"choices":[{"delta":{"role":"assistant"}}]}"#;
    for cut in [
        stream(&[begun]),
        stream(&[role, "[DONE]"]),
        stream(&[begun, r#"{"error":{"message":"no memory"}}"#]),
        stream(&[
            begun,
            r#"{"choices":[{"delta":{},"finish_reason":"error"}]}"#,
        ]),
        format!("{}event: error\ndata: no memory\n\n", stream(&[begun])),
        format!(
            "{}error: {{\"message\":\"no memory\"}}\n\n",
            stream(&[begun])
        ),
    ] {
        assert!(
            matches!(reply(&cut), Err(EndpointFailure::Closed(_))),
            "{cut}"
        );
    }
    let refused = stream(&[role, r#"{"error":{"message":"no","code":400}}"#]);
    assert_eq!(
        reply(&refused),
        Err(EndpointFailure::Refused {
            status: 400,
            message: "no".into()
        })
    );
}

#[test]
fn a_reply_of_another_interface_is_named_in_one_piece_and_streamed() {
    let anthropic =
        r#"{"type":"message","content":[{"type":"text","text":"keep"}],"stop_reason":"end_turn"}"#;
    let started =
        r#"{"type":"message_start","message":{"id":"1","role":"assistant","content":[]}}"#;
    let piece =
        r#"{"type":"content_block_delta","index":0,"delta":{"type":"text_delta","text":"keep"}}"#;
    let gemini = r#"{"candidates":[{"content":{"parts":[{"text":"keep"}]}}]}"#;
    let ollama = "{\"response\":\"ke\",\"done\":false}\n{\"response\":\"ep\",\"done\":true}\n";
    for (name, body) in [
        ("Anthropic's Messages", anthropic.to_owned()),
        (
            "Anthropic's Messages",
            stream(&[started, piece, r#"{"type":"message_stop"}"#]),
        ),
        ("generateContent", gemini.to_owned()),
        ("generateContent", format!("[{gemini}]")),
        ("generateContent", stream(&[gemini])),
        ("/api/generate", ollama.to_owned()),
        (
            "Text Generation Inference",
            r#"[{"generated_text":"keep"}]"#.to_owned(),
        ),
    ] {
        let failure = reply(&body).unwrap_err();
        assert!(
            matches!(&failure, EndpointFailure::InvalidReply(text) if text.contains(name)),
            "{body}: {failure:?}"
        );
    }
}

#[test]
fn an_endless_answer_is_not_read_to_its_end() {
    for byte in [b' ', b'\n', b'x', b'\r'] {
        let listen = Listen {
            hide: &str::to_owned,
            asked: "http://127.0.0.1:8080/v1/chat/completions",
            whole: false,
            on_text: &mut |_| (),
        };
        assert_eq!(
            read(std::io::repeat(byte), listen),
            Err(EndpointFailure::TooLong(MAX_BYTES))
        );
    }
}
