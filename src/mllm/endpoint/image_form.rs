//! The form of a picture in a request. `OpenAI`'s is an object with the address; some servers take
//! the address alone, and say so in their refusal.

use serde_json::Value;

/// Words by which a refusal asks for a text in place of an object.
const TEXT_WANTED: [&str; 5] = [
    "valid string",
    "expected a string",
    "expected string",
    "must be a string",
    "str type expected",
];

/// Whether a refusal says that `image_url` should be a text.
pub(super) fn wants_text(status: u16, message: &str, body: &Value) -> bool {
    let plain = message.to_ascii_lowercase();
    matches!(status, 400 | 422 | 500)
        && plain.contains("image_url")
        && TEXT_WANTED.iter().any(|words| plain.contains(words))
        && with_text(body) != *body
}

/// A request whose pictures are texts.
pub(super) fn with_text(body: &Value) -> Value {
    let mut body = body.clone();
    let messages = body.get_mut("messages").and_then(Value::as_array_mut);
    for message in messages.into_iter().flatten() {
        let parts = message.get_mut("content").and_then(Value::as_array_mut);
        for part in parts.into_iter().flatten() {
            if let Some(picture) = part.get_mut("image_url")
                && let Some(url) = picture.get("url").cloned()
            {
                *picture = url;
            }
        }
    }
    body
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_picture_becomes_a_text_where_the_server_asks_for_it() {
        let of = |picture: Value| {
            json!({"messages": [
                {"role": "system", "content": "drive"},
                {"role": "user", "content": [
                    {"type": "image_url", "image_url": picture},
                    {"type": "text", "text": "Which lane?"},
                ]},
            ]})
        };
        let (object, text) = (of(json!({"url": "data:x"})), of(json!("data:x")));
        assert_eq!(with_text(&object), text);
        assert_eq!(with_text(&text), text);
        for message in [
            "body.messages.1.content.0.image_url: Input should be a valid string",
            "messages[1].content[0].image_url: invalid type: map, expected a string at line 1",
            "image_url must be a string",
        ] {
            assert!(wants_text(422, message, &object), "{message}");
            assert!(!wants_text(422, message, &text), "{message}");
        }
        for (status, message) in [
            (401, "image_url must be a string"),
            (400, "content must be a string"),
            (400, "image_url is not supported"),
        ] {
            assert!(!wants_text(status, message, &object), "{message}");
        }
    }
}
