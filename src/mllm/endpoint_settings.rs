//! Settings of a model behind a server, as a model description has them.

use super::key_variable;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use std::net::IpAddr;

/// Sides of an image that can be drawn for a model, pixels.
pub(crate) const DRAWN_SIDES: std::ops::RangeInclusive<u32> = 32..=4096;

/// The path of chat completions, after the version.
const CHAT: &str = "/chat/completions";
/// Other routes after the version, whose addresses people copy from examples.
const ROUTES: [&str; 6] = [
    "/chat",
    "/completions",
    "/models",
    "/responses",
    "/messages",
    "/embeddings",
];
/// Routes of the own interfaces of Ollama, llama.cpp, Text Generation Inference and `SGLang`, beside
/// which chat completions stand under `/v1`.
const OWN: [&str; 7] = [
    "/api/chat",
    "/api/generate",
    "/api/tags",
    "/api/show",
    "/completion",
    "/generate",
    "/generate_stream",
];
/// Ends of addresses of Gemini's own interface, whose chat completions stand under `/openai`.
const GEMINI: [&str; 2] = [":generateContent", ":streamGenerateContent"];

/// A model behind a server with OpenAI's chat completions.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EndpointSettings {
    /// The server's address up to the version, such as `http://127.0.0.1:8080/v1`;
    /// `/chat/completions` may follow.
    pub endpoint: String,
    /// The server's name of the model; empty for the only one that it offers.
    pub model: String,
    /// The environment variable with the API key; `None` for a server that needs no key.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub key_env: Option<String>,
    /// The field that carries a constraint. It has no default, because servers ignore fields that
    /// they do not know.
    pub grammar: GrammarField,
    /// The field that limits the tokens of an answer.
    #[serde(default)]
    pub limit: LimitField,
    /// Whether the server streams answers, which gives the time to the first token.
    #[serde(default = "stream")]
    pub stream: bool,
    /// Side of the image, pixels.
    #[serde(default = "image_size")]
    pub image_size: u32,
    /// Time limit of the connection, milliseconds.
    #[serde(default = "connect_timeout_ms")]
    pub connect_timeout_ms: u64,
    /// Time limit of a request, from the connection to the last byte of the answer, milliseconds.
    #[serde(default = "timeout_ms")]
    pub timeout_ms: u64,
    /// Retries of a request that met a closed connection, 429 or 5xx.
    #[serde(default = "retries")]
    pub retries: usize,
    /// Wait before the first retry, milliseconds. It doubles each time, plus a random part of up to
    /// the same length.
    #[serde(default = "first_wait_ms")]
    pub first_wait_ms: u64,
    /// Request fields that the server refuses, such as `temperature`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub omit: Vec<String>,
    /// Additional request fields, such as `reasoning_effort`.
    #[serde(default, skip_serializing_if = "Map::is_empty")]
    pub extra: Map<String, Value>,
}

/// The request field that carries a constraint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GrammarField {
    /// No field: answers are unconstrained, and each record says so.
    None,
    /// `grammar`, in GBNF: the servers of llama.cpp and llama-cpp-python.
    Gbnf,
    /// `response_format`, a JSON schema of a string with a pattern: `OpenAI`, Ollama, vLLM,
    /// llama.cpp's server.
    JsonSchema,
    /// `structured_outputs` with a regular expression: vLLM from 0.12 on.
    StructuredOutputs,
    /// `guided_regex`: vLLM before 0.12.
    GuidedRegex,
    /// `regex`: `SGLang`.
    Regex,
    /// `grammar` as an object with a regular expression: mistral.rs.
    TaggedRegex,
}

/// The request field that limits the tokens of an answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LimitField {
    /// All servers except `OpenAI`'s for its newer models.
    #[default]
    MaxTokens,
    /// `OpenAI`'s newer models.
    MaxCompletionTokens,
}

fn stream() -> bool {
    true
}

/// GPT-4V and its successors see this size without cutting it into tiles.
fn image_size() -> u32 {
    512
}

fn connect_timeout_ms() -> u64 {
    10_000
}

/// About ten times the paper's planning call with GPT-4V.
fn timeout_ms() -> u64 {
    60_000
}

fn retries() -> usize {
    4
}

fn first_wait_ms() -> u64 {
    500
}

impl EndpointSettings {
    /// The settings for an address on the command line, `ADDRESS` or `ADDRESS#MODEL`; `None` for a
    /// word that is none. Without a model it stands for the only one that the server offers. An
    /// address without a path gets `/v1`, which all servers on people's machines have.
    pub(crate) fn of_address(word: &str) -> Option<Self> {
        let (address, model) = word.split_once('#').unwrap_or((word, ""));
        let is_network = scheme(address).is_some();
        // Without a scheme only a host of this machine with a port is an address; other words are
        // names of models.
        let has_port = || {
            authority(address)
                .rsplit_once(':')
                .is_some_and(|(_, port)| port.parse::<u16>().is_ok())
        };
        if !(is_network || is_this_machine(address) && has_port()) {
            return None;
        }
        let (_, rest) = scheme(address).unwrap_or(("http://", address));
        let bare = rest.trim_end_matches('/');
        let endpoint = if bare.contains('/') {
            address.to_owned()
        } else {
            format!("{}/v1", address.trim_end_matches('/'))
        };
        Some(Self {
            endpoint,
            model: model.to_owned(),
            key_env: None,
            grammar: GrammarField::None,
            limit: LimitField::default(),
            stream: stream(),
            image_size: image_size(),
            connect_timeout_ms: connect_timeout_ms(),
            timeout_ms: timeout_ms(),
            retries: retries(),
            first_wait_ms: first_wait_ms(),
            omit: Vec::new(),
            extra: Map::new(),
        })
    }

    /// Checks settings that a description wrote. It names the model: a list may be another
    /// tomorrow.
    pub(crate) fn described(&self) -> Result<(), String> {
        if self.model.trim().is_empty() {
            return Err("model is empty; write the server's name of the model".into());
        }
        self.url()?;
        self.key_env.as_deref().map_or(Ok(()), key_variable::check)
    }

    /// Model and server in words.
    pub(crate) fn in_words(&self) -> String {
        let model = if self.model.is_empty() {
            "the model"
        } else {
            &self.model
        };
        format!("{model} at {}", self.endpoint)
    }

    /// The address of chat completions. The description may name it, or what comes before.
    pub(crate) fn url(&self) -> Result<String, String> {
        // A key in an address would end up in records and error messages.
        if self.endpoint.contains(['@', '?', '#']) {
            return Err("endpoint must be a plain address; key_env names the environment variable of the key".into());
        }
        let plain =
            |character: char| character.is_ascii_alphanumeric() || "-._~%:/[]".contains(character);
        if self.host().is_none() || !self.endpoint.trim().chars().all(plain) {
            let endpoint = &self.endpoint;
            return Err(format!(
                "endpoint '{endpoint}' is not an address with http:// or https:// and a host"
            ));
        }
        if !DRAWN_SIDES.contains(&self.image_size) {
            let (min, max) = (DRAWN_SIDES.start(), DRAWN_SIDES.end());
            return Err(format!(
                "image_size is {}; it must be from {min} to {max}",
                self.image_size
            ));
        }
        for (name, value) in [
            ("connect_timeout_ms", self.connect_timeout_ms),
            ("timeout_ms", self.timeout_ms),
        ] {
            if value == 0 {
                return Err(format!("{name} is 0; it must be at least 1"));
            }
        }
        let address = self.endpoint.trim().trim_end_matches('/');
        let base = base_of(address);
        let (scheme, rest) = scheme(&base).unwrap_or(("http://", &base));
        Ok(format!("{}{rest}{CHAT}", scheme.to_ascii_lowercase()))
    }

    /// Whether the server runs on this machine, so that requests do not use the network.
    pub(crate) fn is_local(&self) -> bool {
        self.host().is_some_and(is_own_host)
    }

    /// The host. Only one of this machine may stand without a scheme: of another it is not known.
    fn host(&self) -> Option<&str> {
        let address = self.endpoint.trim();
        let rest = match scheme(address) {
            Some((_, rest)) => rest,
            None if is_this_machine(address) => address,
            None => return None,
        };
        host_of(authority(rest)).filter(|host| !host.is_empty())
    }
}

/// What stands before the route of chat completions, for an address of any route of a server.
fn base_of(address: &str) -> String {
    let trimmed = |text: &str| text.trim_end_matches('/').to_owned();
    if let Some(base) = address.strip_suffix(CHAT) {
        return trimmed(base);
    }
    if let Some(server) = OWN.iter().find_map(|route| address.strip_suffix(route)) {
        return format!("{}/v1", trimmed(server));
    }
    if let Some((version, _)) = address.rsplit_once("/models/")
        && GEMINI.iter().any(|end| address.ends_with(end))
    {
        return format!("{}/openai", trimmed(version));
    }
    // Elsewhere such a part may be one of the address: a version stands before a route.
    let has_version = |base: &&str| {
        let last = base.rsplit('/').next().unwrap_or(base);
        last.strip_prefix('v')
            .is_some_and(|rest| rest.starts_with(|c: char| c.is_ascii_digit()))
    };
    let mut bases = ROUTES
        .iter()
        .filter_map(|route| address.strip_suffix(route));
    bases
        .find(has_version)
        .map_or_else(|| trimmed(address), trimmed)
}

/// Splits `http://` or `https://` from an address.
fn scheme(address: &str) -> Option<(&str, &str)> {
    let mut schemes = ["http://", "https://"].into_iter();
    let length = schemes
        .find(|name| {
            address
                .get(..name.len())
                .is_some_and(|text| text.eq_ignore_ascii_case(name))
        })?
        .len();
    address.split_at_checked(length)
}

/// Host and port of an address without a scheme.
fn authority(rest: &str) -> &str {
    rest.split_once('/')
        .map_or(rest, |(authority, _)| authority)
}

fn host_of(authority: &str) -> Option<&str> {
    match authority.strip_prefix('[') {
        Some(ipv6) => ipv6.split_once(']').map(|(host, _port)| host),
        None => Some(
            authority
                .split_once(':')
                .map_or(authority, |(host, _port)| host),
        ),
    }
}

/// Whether an address without a scheme is one of this machine.
fn is_this_machine(address: &str) -> bool {
    host_of(authority(address)).is_some_and(is_own_host)
}

/// Servers name `0.0.0.0` when they listen; a client reaches this machine by it.
fn is_own_host(host: &str) -> bool {
    let is_own = |address: IpAddr| address.is_loopback() || address.is_unspecified();
    host.eq_ignore_ascii_case("localhost") || host.parse::<IpAddr>().is_ok_and(is_own)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_addresses_of_this_machine_are_local() {
        for (endpoint, local) in [
            ("http://127.0.0.1:8080/v1", Some(true)),
            ("http://[::1]:8080/v1", Some(true)),
            ("http://localhost/v1/", Some(true)),
            ("https://localhost.example.com/v1", Some(false)),
            ("https://192.0.2.1", Some(false)),
            ("http://", None),
            ("http://[::1", None),
            ("http://localhost\\@example.com", None),
            ("http://local host", None),
        ] {
            let settings =
                serde_json::json!({"endpoint": endpoint, "model": "m", "grammar": "none"});
            let settings: EndpointSettings = serde_json::from_value(settings).unwrap();
            assert_eq!(
                settings.url().is_ok().then(|| settings.is_local()),
                local,
                "{endpoint}"
            );
        }
    }

    #[test]
    fn an_address_is_asked_in_every_form_that_people_write() {
        let url = |endpoint: &str| {
            let settings =
                serde_json::json!({"endpoint": endpoint, "model": "m", "grammar": "none"});
            serde_json::from_value::<EndpointSettings>(settings)
                .unwrap()
                .url()
        };
        let asked = "http://127.0.0.1:8080/v1/chat/completions";
        for endpoint in [
            "http://127.0.0.1:8080/v1",
            "http://127.0.0.1:8080/v1/",
            "http://127.0.0.1:8080/v1//",
            "http://127.0.0.1:8080/v1/chat/completions",
            "http://127.0.0.1:8080/v1/chat/completions/",
            " HTTP://127.0.0.1:8080/v1 ",
            "127.0.0.1:8080/v1",
            "http://127.0.0.1:8080/v1/models",
            "http://127.0.0.1:8080/v1/completions/",
            "127.0.0.1:8080/v1/responses",
            "http://127.0.0.1:8080/api/chat",
            "http://127.0.0.1:8080/api/tags",
            "http://127.0.0.1:8080/v1/messages",
            "http://127.0.0.1:8080/completion",
            "http://127.0.0.1:8080/generate",
            "127.0.0.1:8080/generate_stream/",
        ] {
            assert_eq!(url(endpoint).as_deref(), Ok(asked), "{endpoint}");
        }
        assert_eq!(
            url("http://127.0.0.1:1234").as_deref(),
            Ok("http://127.0.0.1:1234/chat/completions")
        );
        assert_eq!(
            url("https://a.example/v1beta/models/gemini-flash:generateContent").as_deref(),
            Ok("https://a.example/v1beta/openai/chat/completions")
        );
        // A part of the address that has the name of a route.
        assert_eq!(
            url("https://a.example/models").as_deref(),
            Ok("https://a.example/models/chat/completions")
        );
        assert_eq!(
            url("localhost").as_deref(),
            Ok("http://localhost/chat/completions")
        );
        assert_eq!(
            url("[::1]:80/v1").as_deref(),
            Ok("http://[::1]:80/v1/chat/completions")
        );
        for endpoint in [
            "api.example.com/v1",
            "",
            "/v1",
            "ftp://localhost/v1",
            "http:/localhost",
        ] {
            assert!(url(endpoint).unwrap_err().contains("http://"), "{endpoint}");
        }
    }

    #[test]
    fn an_address_needs_no_description() {
        for (word, endpoint, model) in [
            ("http://127.0.0.1:8080/v1", "http://127.0.0.1:8080/v1", ""),
            ("http://127.0.0.1:8080", "http://127.0.0.1:8080/v1", ""),
            ("http://127.0.0.1:8080/", "http://127.0.0.1:8080/v1", ""),
            (
                "https://a.example/openai#org/eye:7b",
                "https://a.example/openai",
                "org/eye:7b",
            ),
            ("localhost:11434#eye", "localhost:11434/v1", "eye"),
            ("0.0.0.0:8080/v1", "0.0.0.0:8080/v1", ""),
        ] {
            let settings = EndpointSettings::of_address(word).unwrap();
            assert_eq!(
                (settings.endpoint.as_str(), settings.model.as_str()),
                (endpoint, model),
                "{word}"
            );
            assert!(settings.url().is_ok(), "{word}");
        }
        for word in [
            "nano",
            "localhost/model",
            "org/model",
            "a.example:80/v1",
            "localhost:main",
            "./http",
            "",
            "#x",
        ] {
            assert_eq!(EndpointSettings::of_address(word), None, "{word}");
        }
    }
}
