//! Other forms of a request, for servers that refuse the usual one and say so.

use serde_json::{Value, json};

/// Words by which a refusal asks for a text in place of an object.
const TEXT_WANTED: [&str; 5] = [
    "valid string",
    "expected a string",
    "expected string",
    "must be a string",
    "str type expected",
];
/// Words of refusals of a system prompt: chat templates of Gemma and Mistral, behind any server;
/// servers that name the role; Gemini for Gemma.
const NO_SYSTEM: [&str; 9] = [
    "system role not supported",
    "system role is not supported",
    "does not support system",
    "does not support the system role",
    "system messages are not supported",
    "system message is not supported",
    "roles must alternate",
    "only user and assistant roles",
    "developer instruction is not enabled",
];

/// The forms that a request may take beside the usual one, as bits.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Forms(pub(super) u8);

/// A picture as a text: `OpenAI`'s is an object with the address, and some servers take the address
/// alone.
const PICTURE_AS_TEXT: u8 = 1;
/// The system prompt as the beginning of the first prompt.
const SYSTEM_IN_PROMPT: u8 = 2;

impl Forms {
    /// These forms and the one that a refusal of `body` asks for; `None` where it asks for no other.
    pub(super) fn with_wanted(self, status: u16, message: &str, body: &Value) -> Option<Self> {
        if !matches!(status, 200 | 400 | 422 | 500) {
            return None;
        }
        let plain = message.to_ascii_lowercase();
        let says = |words: &[&str]| words.iter().any(|words| plain.contains(words));
        let wanted = if plain.contains("image_url") && says(&TEXT_WANTED) {
            PICTURE_AS_TEXT
        } else if says(&NO_SYSTEM) {
            SYSTEM_IN_PROMPT
        } else {
            return None;
        };
        let forms = Self(self.0 | wanted);
        (forms.applied(body) != *body).then_some(forms)
    }

    /// A request in these forms.
    pub(super) fn applied(self, body: &Value) -> Value {
        let mut body = body.clone();
        if let Some(messages) = body.get_mut("messages").and_then(Value::as_array_mut) {
            if self.0 & PICTURE_AS_TEXT != 0 {
                pictures_as_texts(messages);
            }
            if self.0 & SYSTEM_IN_PROMPT != 0 {
                system_in_prompt(messages);
            }
        }
        body
    }
}

fn pictures_as_texts(messages: &mut [Value]) {
    for message in messages {
        let parts = message.get_mut("content").and_then(Value::as_array_mut);
        for part in parts.into_iter().flatten() {
            if let Some(picture) = part.get_mut("image_url")
                && let Some(url) = picture.get("url").cloned()
            {
                *picture = url;
            }
        }
    }
}

fn system_in_prompt(messages: &mut Vec<Value>) {
    let [system, prompt, ..] = messages.as_mut_slice() else {
        return;
    };
    if system.get("role").and_then(Value::as_str) != Some("system") {
        return;
    }
    let Some(system) = system.get("content").and_then(Value::as_str) else {
        return;
    };
    let begun = |text: &Value| {
        let text = text.as_str().unwrap_or("");
        json!(format!("{system}\n\n{text}"))
    };
    match prompt.get_mut("content") {
        Some(Value::Array(parts)) => {
            let mut texts = parts.iter_mut().filter_map(|part| part.get_mut("text"));
            let Some(text) = texts.next() else {
                return;
            };
            *text = begun(text);
        }
        Some(text) => *text = begun(text),
        None => return,
    }
    messages.remove(0);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request(picture: &Value) -> Value {
        json!({"messages": [
            {"role": "system", "content": "drive"},
            {"role": "user", "content": [
                {"type": "image_url", "image_url": picture},
                {"type": "text", "text": "Which lane?"},
            ]},
        ]})
    }

    #[test]
    fn a_picture_becomes_a_text_where_the_server_asks_for_it() {
        let (object, text) = (
            request(&json!({"url": "data:x"})),
            request(&json!("data:x")),
        );
        let wanted = |status, message, body| Forms::default().with_wanted(status, message, body);
        for message in [
            "body.messages.1.content.0.image_url: Input should be a valid string",
            "messages[1].content[0].image_url: invalid type: map, expected a string at line 1",
            "image_url must be a string",
        ] {
            let forms = wanted(422, message, &object).unwrap();
            assert_eq!(forms.applied(&object), text, "{message}");
            assert_eq!(wanted(422, message, &text), None, "{message}");
        }
        for (status, message) in [
            (401, "image_url must be a string"),
            (400, "content must be a string"),
            (400, "image_url is not supported"),
        ] {
            assert_eq!(wanted(status, message, &object), None, "{message}");
        }
    }

    #[test]
    fn the_system_prompt_moves_into_the_first_prompt_where_there_is_none() {
        let wanted = |message: &str, body: &Value| Forms::default().with_wanted(400, message, body);
        let usual = request(&json!("data:x"));
        for message in [
            "System role not supported",
            "Jinja Exception: Conversation roles must alternate user/assistant/user/assistant/...",
            "Only user and assistant roles are supported!",
            "Developer instruction is not enabled for models/gemma-3-27b-it",
        ] {
            let forms = wanted(message, &usual).unwrap();
            let moved = json!({"messages": [{"role": "user", "content": [
                {"type": "image_url", "image_url": "data:x"},
                {"type": "text", "text": "drive\n\nWhich lane?"},
            ]}]});
            assert_eq!(forms.applied(&usual), moved, "{message}");
            assert_eq!(wanted(message, &moved), None, "there is none to move");
        }
        let plain = json!({"messages": [
            {"role": "system", "content": "drive"},
            {"role": "user", "content": "a"},
            {"role": "assistant", "content": "b"},
            {"role": "user", "content": "c"},
        ]});
        let moved = wanted("roles must alternate", &plain)
            .unwrap()
            .applied(&plain);
        assert_eq!(
            moved.pointer("/messages/0/content"),
            Some(&json!("drive\n\na"))
        );
        assert_eq!(moved.pointer("/messages/2/content"), Some(&json!("c")));
    }

    #[test]
    fn forms_add_up() {
        let usual = request(&json!({"url": "data:x"}));
        let first = Forms::default()
            .with_wanted(400, "system role not supported", &usual)
            .unwrap();
        let both = first
            .with_wanted(422, "image_url must be a string", &first.applied(&usual))
            .unwrap();
        assert_eq!(
            both.applied(&usual)
                .pointer("/messages/0/content/0/image_url"),
            Some(&json!("data:x"))
        );
        assert_eq!(
            both.with_wanted(400, "system role not supported", &both.applied(&usual)),
            None
        );
    }
}
