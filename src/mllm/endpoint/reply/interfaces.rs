//! Replies of other interfaces than chat completions, and where the servers behind them have chat
//! completions.

use reqwest::Url;
use serde_json::Value;

/// An interface by the form of its replies.
#[derive(Debug)]
pub(super) struct Interface {
    /// What the form of a reply is called.
    name: &'static str,
    /// The path of chat completions at such a server, up to the version.
    path: &'static str,
    is: fn(&Value) -> bool,
}

/// Events and types of Anthropic's Messages.
const MESSAGES: [&str; 8] = [
    "message",
    "message_start",
    "content_block_start",
    "content_block_delta",
    "content_block_stop",
    "message_delta",
    "message_stop",
    "completion",
];

/// From the surest form to the weakest.
static INTERFACES: [Interface; 17] = [
    Interface {
        name: "OpenAI's Responses",
        path: "/v1",
        is: |reply| {
            text(reply, "object") == "response" || text(reply, "type").starts_with("response.")
        },
    },
    Interface {
        name: "OpenAI's batches",
        path: "/v1",
        is: |reply| text(reply, "object") == "batch" || reply.get("custom_id").is_some(),
    },
    Interface {
        name: "OpenAI's Assistants",
        path: "/v1",
        is: |reply| text(reply, "object").starts_with("thread"),
    },
    Interface {
        name: "Anthropic's Messages",
        path: "/v1",
        is: |reply| MESSAGES.contains(&text(reply, "type")) && text(reply, "object").is_empty(),
    },
    Interface {
        name: "Gemini's generateContent",
        path: "/v1beta/openai",
        is: |reply| {
            reply.get("candidates").is_some_and(Value::is_array)
                || reply.get("usageMetadata").is_some()
        },
    },
    Interface {
        name: "Ollama's /api/generate",
        path: "/v1",
        is: |reply| is_text(reply, "response") && reply.get("done").is_some(),
    },
    Interface {
        name: "llama.cpp's /completion",
        path: "/v1",
        is: |reply| is_text(reply, "content") && reply.get("stop").is_some(),
    },
    Interface {
        name: "Text Generation Inference's /generate",
        path: "/v1",
        is: |reply| {
            reply.get("generated_text").is_some()
                || reply
                    .get("token")
                    .is_some_and(|token| token.get("logprob").is_some())
        },
    },
    Interface {
        name: "KServe's or Triton's inference",
        path: "/openai/v1",
        is: |reply| {
            let named = reply.get("model_name").is_some();
            reply.get("text_output").is_some()
                || reply.get("predictions").is_some()
                || named && reply.get("outputs").is_some()
        },
    },
    Interface {
        name: "KoboldAI's /api/v1/generate",
        path: "/v1",
        is: |reply| reply.pointer("/results/0/text").is_some(),
    },
    Interface {
        name: "LM Studio's /api/v1/chat",
        path: "/v1",
        is: |reply| {
            reply.get("model_instance_id").is_some() || text(reply, "type").starts_with("chat.")
        },
    },
    Interface {
        name: "Bedrock's Converse",
        path: "/openai/v1",
        is: |reply| reply.pointer("/output/message").is_some(),
    },
    Interface {
        name: "DashScope's generation",
        path: "/compatible-mode/v1",
        is: |reply| {
            reply.pointer("/output/text").is_some()
                || reply.get("request_id").is_some() && reply.get("output").is_some()
        },
    },
    Interface {
        name: "Cohere's chat",
        path: "/compatibility/v1",
        is: |reply| {
            reply.get("generation_id").is_some()
                || reply.get("generations").is_some()
                || reply
                    .pointer("/message/content")
                    .is_some_and(Value::is_array)
        },
    },
    Interface {
        name: "a server's /generate",
        path: "/v1",
        is: |reply| {
            let is_list = |text: &Value| text.pointer("/0").is_some_and(Value::is_string);
            let has_text = is_text(reply, "text") || reply.get("text").is_some_and(is_list);
            has_text && reply.get("choices").is_none()
        },
    },
    Interface {
        name: "embeddings",
        path: "/v1",
        is: |reply| {
            reply.pointer("/data/0/embedding").is_some() || reply.get("embeddings").is_some()
        },
    },
    Interface {
        name: "a list of models",
        path: "/v1",
        is: |reply| {
            text(reply, "object") == "list" || reply.get("models").is_some_and(Value::is_array)
        },
    },
];

/// The interface that a reply, or an event of one, is of.
pub(super) fn interface_of(reply: &Value) -> Option<&'static Interface> {
    INTERFACES.iter().find(|interface| (interface.is)(reply))
}

impl Interface {
    /// What a reply is, and what to ask instead. `asked` is the address of chat completions that
    /// was asked.
    pub(super) fn told(&self, asked: &str) -> String {
        let base = asked.strip_suffix("/chat/completions").unwrap_or(asked);
        let origin = Url::parse(asked)
            .map_or_else(|_| String::new(), |url| url.origin().ascii_serialization());
        let usual = format!("{origin}{}", self.path);
        let name = self.name;
        if usual == base {
            format!(
                "the reply has the form of {name}; such servers have chat completions at {asked}, which was asked: the server, or \
                 what stands before it, is set to another form"
            )
        } else {
            format!(
                "the reply has the form of {name}; such servers have chat completions at {usual}: try --model {usual}, or \
                 endpoint = \"{usual}\" in the description"
            )
        }
    }
}

/// A member that is a text; empty where there is none.
fn text<'a>(reply: &'a Value, name: &str) -> &'a str {
    reply.get(name).and_then(Value::as_str).unwrap_or("")
}

fn is_text(reply: &Value, name: &str) -> bool {
    reply.get(name).is_some_and(Value::is_string)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn replies_of_other_interfaces_are_named_with_the_address_to_ask() {
        for (name, path, reply) in [
            (
                "Responses",
                "/v1",
                json!({"object": "response", "output": [{"type": "message", "content": [{"type": "output_text", "text": "keep"}]}]}),
            ),
            (
                "Responses",
                "/v1",
                json!({"type": "response.output_text.delta", "delta": "ke"}),
            ),
            (
                "batches",
                "/v1",
                json!({"id": "batch_1", "object": "batch", "status": "validating"}),
            ),
            (
                "batches",
                "/v1",
                json!({"custom_id": "1", "response": null}),
            ),
            (
                "Assistants",
                "/v1",
                json!({"object": "thread.run", "status": "queued"}),
            ),
            (
                "Messages",
                "/v1",
                json!({"type": "message", "role": "assistant", "content": [{"type": "text", "text": "keep"}], "stop_reason": "end_turn"}),
            ),
            (
                "Messages",
                "/v1",
                json!({"type": "content_block_delta", "delta": {"type": "text_delta", "text": "ke"}}),
            ),
            (
                "generateContent",
                "/v1beta/openai",
                json!({"candidates": [{"content": {"parts": [{"text": "keep"}]}, "finishReason": "STOP"}]}),
            ),
            (
                "/api/generate",
                "/v1",
                json!({"model": "x", "response": "ke", "done": false}),
            ),
            (
                "/completion",
                "/v1",
                json!({"content": "keep", "stop": true, "tokens_predicted": 3}),
            ),
            (
                "Text Generation Inference",
                "/v1",
                json!({"generated_text": "keep"}),
            ),
            (
                "Text Generation Inference",
                "/v1",
                json!({"token": {"id": 3, "text": "ke", "logprob": -0.1}, "generated_text": null}),
            ),
            (
                "KServe",
                "/openai/v1",
                json!({"model_name": "x", "text_output": "keep"}),
            ),
            (
                "KServe",
                "/openai/v1",
                json!({"model_name": "x", "outputs": [{"name": "out", "data": ["keep"]}]}),
            ),
            ("KServe", "/openai/v1", json!({"predictions": ["keep"]})),
            ("KoboldAI", "/v1", json!({"results": [{"text": "keep"}]})),
            (
                "LM Studio",
                "/v1",
                json!({"model_instance_id": "x", "output": [{"type": "message", "content": "keep"}]}),
            ),
            (
                "Converse",
                "/openai/v1",
                json!({"output": {"message": {"content": [{"text": "keep"}]}}, "stopReason": "end_turn"}),
            ),
            (
                "DashScope",
                "/compatible-mode/v1",
                json!({"output": {"text": "keep", "finish_reason": "stop"}, "request_id": "1"}),
            ),
            (
                "Cohere",
                "/compatibility/v1",
                json!({"message": {"role": "assistant", "content": [{"type": "text", "text": "keep"}]}, "finish_reason": "COMPLETE"}),
            ),
            (
                "/generate",
                "/v1",
                json!({"text": "keep", "meta_info": {"id": "1"}}),
            ),
            ("/generate", "/v1", json!({"text": ["keep"]})),
            (
                "embeddings",
                "/v1",
                json!({"object": "list", "data": [{"object": "embedding", "embedding": [0.1]}]}),
            ),
            (
                "a list of models",
                "/v1",
                json!({"object": "list", "data": [{"id": "x"}]}),
            ),
            (
                "a list of models",
                "/v1",
                json!({"models": [{"name": "x"}]}),
            ),
        ] {
            let interface = interface_of(&reply).unwrap();
            assert!(interface.name.contains(name), "{reply}: {}", interface.name);
            let told = interface.told("http://127.0.0.1:1234/api/chat/completions");
            let usual = format!("try --model http://127.0.0.1:1234{path},");
            assert!(told.contains(name) && told.contains(&usual), "{told}");
            let told = interface.told(&format!("http://127.0.0.1:1234{path}/chat/completions"));
            assert!(told.contains(name) && !told.contains("--model"), "{told}");
        }
    }

    #[test]
    fn chat_completions_are_of_no_other_interface() {
        for reply in [
            json!({"object": "chat.completion", "choices": [{"message": {"content": "keep"}}]}),
            json!({"object": "chat.completion.chunk", "choices": []}),
            json!({"choices": [{"text": "keep"}]}),
            json!({"usage": {"prompt_tokens": 3}}),
            json!({"type": "ping"}),
            json!({}),
            json!([]),
            json!("keep"),
        ] {
            let found = interface_of(&reply).map(|interface| interface.name);
            assert_eq!(found, None, "{reply}");
        }
    }
}
