//! What a user can do about a refused request.

use crate::EndpointSettings;
use reqwest::Url;
use serde_json::Value;

/// Fields of a request whose refusal has its own advice, by the field that a server names.
const ADVICE: [(&str, &str); 12] = [
    (
        "max_completion_tokens",
        "write limit = \"max_completion_tokens\" in the description",
    ),
    (
        "max_tokens",
        "write the other limit in the description: max_tokens or max_completion_tokens",
    ),
    (
        "stream_options",
        "write omit = [\"stream_options\"] in the description",
    ),
    (
        "temperature",
        "write omit = [\"temperature\"] in the description",
    ),
    ("top_p", "write omit = [\"top_p\"] in the description"),
    ("seed", "write omit = [\"seed\"] in the description"),
    ("response_format", GRAMMAR),
    ("json_schema", GRAMMAR),
    ("guided_regex", GRAMMAR),
    ("structured_outputs", GRAMMAR),
    ("grammar", GRAMMAR),
    ("regex", GRAMMAR),
];
const GRAMMAR: &str = "the server takes constraints in another form: choose another grammar in the description, or \"none\"";
/// Words about pictures in refusals of servers.
const PICTURES: [&str; 7] = [
    "image",
    "vision",
    "multimodal",
    "mmproj",
    "picture",
    "content type",
    "content must be a string",
];
/// Words of servers that do not have a model.
const ABSENT: [&str; 20] = [
    "not found",
    "does not exist",
    "not exist",
    "not loaded",
    "no models loaded",
    "unknown model",
    "invalid model",
    "not a valid model",
    "no such model",
    "not available",
    "no available channel",
    "could not find",
    "unable to access model",
    "not supported by any provider",
    "no endpoints found for",
    "decommissioned",
    "deprecated",
    "no model specified",
    "specify a model",
    "allowed now",
];

/// Words about a prompt that is too long.
const TOO_LONG: [&str; 7] = [
    "context size",
    "context length",
    "context window",
    "context_length",
    "maximum context",
    "max_model_len",
    "too many tokens",
];

/// A refused request.
#[derive(Debug, Clone, Copy)]
pub(super) struct Refusal<'a> {
    pub(super) status: u16,
    /// The server's words.
    pub(super) message: &'a str,
    pub(super) settings: &'a EndpointSettings,
    /// The address that was asked.
    pub(super) url: &'a Url,
    pub(super) body: &'a Value,
}

impl Refusal<'_> {
    /// Whether the server seems not to have the model, so that its list helps.
    pub(super) fn is_of_the_model(&self) -> bool {
        let plain = self.message.to_ascii_lowercase();
        let own = has_word(&plain, &self.settings.model.to_ascii_lowercase());
        let named = own || plain.contains("model") || plain.contains("deployment");
        let absent = ABSENT.iter().any(|words| plain.contains(words));
        // What is not found and named is the model.
        matches!(self.status, 200 | 400 | 404 | 410 | 422 | 500 | 503) && named && absent
            || self.status == 404 && own
    }

    /// What to do, where it is known.
    pub(super) fn advice(&self) -> Option<String> {
        if matches!(self.status, 401 | 403) {
            return Some(match &self.settings.key_env {
                Some(variable) => format!("check the key in the environment variable {variable}"),
                None => "key_env of the description names the environment variable with the key"
                    .to_owned(),
            });
        }
        // Servers word the same fault in many ways. From the surest sign to the weakest.
        let plain = self.message.to_ascii_lowercase();
        if matches!(self.status, 200 | 404 | 405) && !self.is_of_the_model() {
            return without_version(self.url).or_else(|| self.about_pictures(&plain));
        }
        if !matches!(self.status, 200 | 400 | 413 | 415 | 422 | 500 | 501) {
            return None;
        }
        if plain.contains("support") && has_word(&plain, "stream") {
            return Some("write stream = false in the description".to_owned());
        }
        if TOO_LONG.iter().any(|words| plain.contains(words)) {
            let text = "start the server with a larger context, or take a shorter prompt set (--prompt-set compact)";
            return Some(text.to_owned());
        }
        if self.status == 413 {
            return Some("write a smaller image_size in the description".to_owned());
        }
        if let Some((_, advice)) = ADVICE
            .iter()
            .find(|(field, _)| self.sends(field) && has_word(&plain, field))
        {
            return Some((*advice).to_owned());
        }
        let extra = self
            .settings
            .extra
            .keys()
            .find(|field| has_word(&plain, &field.to_ascii_lowercase()));
        if let Some(field) = extra {
            return Some(format!(
                "{field} is a field of extra in the description: remove it there"
            ));
        }
        self.about_pictures(&plain)
    }

    /// What to do where the server's words, in small letters, are about the picture.
    fn about_pictures(&self, plain: &str) -> Option<String> {
        let pictured = self.sends_picture() && PICTURES.iter().any(|word| plain.contains(word));
        pictured.then(|| {
            "start the server with a model that sees, or set environment.bev = false to ask without the picture"
                .to_owned()
        })
    }

    /// Whether the request has a field, or the other limit of tokens is meant.
    fn sends(&self, field: &str) -> bool {
        let limit = field == "max_completion_tokens" && self.body.get("max_tokens").is_some();
        let schema = field == "json_schema" && self.body.get("response_format").is_some();
        limit || schema || self.body.get(field).is_some()
    }

    fn sends_picture(&self) -> bool {
        let messages = self.body.get("messages").and_then(Value::as_array);
        messages.is_some_and(|messages| {
            messages
                .iter()
                .any(|message| message.get("content").is_some_and(Value::is_array))
        })
    }
}

/// What may be missing from an address without a version.
pub(super) fn without_version(url: &Url) -> Option<String> {
    let is_version = |part: &str| {
        part.strip_prefix('v')
            .is_some_and(|rest| rest.starts_with(|c: char| c.is_ascii_digit()))
    };
    if url
        .path_segments()
        .is_some_and(|mut parts| parts.any(is_version))
    {
        return None;
    }
    let base = url
        .as_str()
        .strip_suffix("/chat/completions")
        .unwrap_or(url.as_str());
    Some(format!(
        "the address has no version, and /v1 may be missing: try endpoint = \"{base}/v1\""
    ))
}

/// Whether a failure names an address to try.
pub(super) fn names_address(text: &str) -> bool {
    text.contains("try --model ")
}

/// Where most servers have their list of models, if another address was asked.
pub(super) fn other_route(url: &Url) -> Option<String> {
    let usual = format!("{}/v1", url.origin().ascii_serialization());
    let asked = url.as_str().strip_suffix("/chat/completions");
    (asked != Some(usual.as_str()))
        .then(|| format!("most servers answer at {usual}: try --model {usual}"))
}

/// What to do where a server speaks HTTP to a client of HTTPS, or the other way round.
pub(super) fn other_protocol(scheme: &str, failure: &str) -> Option<&'static str> {
    let plain = failure.to_ascii_lowercase();
    let is_no_tls = [
        "corrupt message",
        "invalidcontenttype",
        "wrong version number",
    ];
    match scheme {
        "https" if is_no_tls.iter().any(|words| plain.contains(words)) => {
            Some("the server may not speak HTTPS: write http:// in place of https://")
        }
        "http" if plain.contains("invalid http version") => {
            Some("the server may speak HTTPS alone: write https:// in place of http://")
        }
        _ => None,
    }
}

/// Whether a text has a word that is no part of a longer name.
fn has_word(text: &str, word: &str) -> bool {
    if word.is_empty() {
        return false;
    }
    let inside = |c: char| c.is_ascii_alphanumeric() || c == '_';
    text.match_indices(word).any(|(at, _)| {
        let before = text.get(..at).and_then(|before| before.chars().next_back());
        let after = text
            .get(at + word.len()..)
            .and_then(|after| after.chars().next());
        !before.is_some_and(inside) && !after.is_some_and(inside)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    /// The advice on a refusal of a request with a picture and every field.
    fn advice(address: &str, status: u16, message: &str) -> String {
        let settings = json!({"endpoint": address, "model": "Eye-7B", "grammar": "gbnf", "extra": {"top_k": 3}});
        let settings: EndpointSettings = serde_json::from_value(settings).unwrap();
        let url = Url::parse(&settings.url().unwrap()).unwrap();
        let body = json!({
            "max_tokens": 5, "temperature": 0, "top_p": 1, "seed": 1, "stream_options": {}, "grammar": "root", "top_k": 3,
            "messages": [{"role": "user", "content": [{"type": "image_url"}, {"type": "text"}]}],
        });
        let refusal = Refusal {
            status,
            message,
            settings: &settings,
            url: &url,
            body: &body,
        };
        let listed = if refusal.is_of_the_model() {
            "list"
        } else {
            ""
        };
        refusal.advice().unwrap_or_else(|| listed.to_owned())
    }

    #[test]
    fn a_refusal_says_what_to_do() {
        for (status, message, told) in [
            (
                400,
                "Unsupported parameter: 'max_tokens'. Use 'max_completion_tokens' instead.",
                "limit = \"max_completion_tokens\"",
            ),
            (400, "max_tokens is too large", "the other limit"),
            (
                400,
                "'temperature' does not support 0 with this model. Only the default (1)",
                "omit = [\"temperature\"]",
            ),
            (
                422,
                "body.seed: Extra inputs are not permitted",
                "omit = [\"seed\"]",
            ),
            (
                400,
                "unknown field stream_options",
                "omit = [\"stream_options\"]",
            ),
            (
                400,
                "unexpected keyword argument 'grammar'",
                "another grammar",
            ),
            (422, "top_k: unknown field", "extra"),
            (
                500,
                "image input is not supported - hint: you may need to provide the mmproj",
                "a model that sees",
            ),
            (
                400,
                "This model does not support multimodal input",
                "a model that sees",
            ),
            (
                422,
                "body.messages.0.content: content must be a string",
                "a model that sees",
            ),
            (
                404,
                "No endpoints found that support image input",
                "a model that sees",
            ),
            (
                400,
                "the request exceeds the available context size, try increasing it",
                "a larger context",
            ),
            (
                400,
                "This model's maximum context length is 512 tokens. max_tokens is too large",
                "a larger context",
            ),
            (413, "Payload Too Large", "a smaller image_size"),
            (
                400,
                "stream is not supported for this model",
                "stream = false",
            ),
            (401, "invalid key", "key_env"),
            (400, "the prompt is too long", ""),
            (400, "programmargrammars", ""),
            (404, "model 'Eye-7B' not found", "list"),
            (404, "The model `Eye-7B` does not exist.", "list"),
            (400, "eye-7b is not a valid model ID", "list"),
            (400, "No models loaded. Please load a model", "list"),
            (404, "model: eye-7b", "list"),
            (404, "No endpoints found for Eye-7B.", "list"),
            (
                404,
                "Unable to access model eye-7b. Please visit the list",
                "list",
            ),
            (
                400,
                "The requested model 'Eye-7B' is not supported by any provider you have enabled.",
                "list",
            ),
            (400, "could not find real modelID for Eye-7B", "list"),
            (500, "Model Eye-7B not found. Available models: a", "list"),
            (
                404,
                "The API deployment for this resource does not exist.",
                "list",
            ),
            (400, "Only a, b allowed now, your model Eye-7B", "list"),
            (
                500,
                "this model is missing data required for image input",
                "a model that sees",
            ),
            (404, "Not Found", ""),
            (402, "pay first, also for the image", ""),
        ] {
            let advice = advice("http://127.0.0.1:8080/v1", status, message);
            assert!(
                advice.contains(told) && advice.is_empty() == told.is_empty(),
                "{message}: {advice}"
            );
        }
    }

    #[test]
    fn another_address_and_protocol_are_named() {
        let route = |address: &str| {
            other_route(&Url::parse(&format!("{address}/chat/completions")).unwrap())
        };
        for wrong in [
            "http://127.0.0.1:1234/docs",
            "http://127.0.0.1:1234/api/v0",
            "http://127.0.0.1:1234/v1/v1",
        ] {
            let advice = route(wrong).unwrap();
            assert!(
                advice.ends_with("--model http://127.0.0.1:1234/v1"),
                "{advice}"
            );
        }
        assert_eq!(route("http://127.0.0.1:1234/v1"), None);
        let advice = |scheme, failure| other_protocol(scheme, failure).unwrap_or_default();
        assert!(
            advice(
                "https",
                "received corrupt message of type InvalidContentType"
            )
            .contains("write http://")
        );
        assert!(advice("http", "invalid HTTP version parsed").contains("write https://"));
        assert_eq!(advice("http", "Connection refused"), "");
        assert_eq!(advice("https", "certificate expired"), "");
    }

    #[test]
    fn a_missing_version_is_named() {
        for (address, missing) in [
            ("http://127.0.0.1:1234", true),
            ("http://127.0.0.1:1234/", true),
            ("http://127.0.0.1:1234/api", true),
            ("http://127.0.0.1:1234/vision", true),
            ("http://127.0.0.1:1234/v1", false),
            ("https://host.example/openai/v1beta", false),
        ] {
            for status in [200, 404, 405] {
                let advice = advice(address, status, "Unexpected endpoint or method");
                assert_eq!(advice.contains("/v1\""), missing, "{address}: {advice}");
            }
        }
        assert!(
            advice("http://127.0.0.1:1234/", 404, "x").contains("\"http://127.0.0.1:1234/v1\"")
        );
    }
}
