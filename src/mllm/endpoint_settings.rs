//! Settings of a model behind a server, as a model description has them.

use std::net::IpAddr;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

/// Accepted sides of the image, pixels.
const IMAGE_SIZES: std::ops::RangeInclusive<u32> = 32..=4096;

/// A model behind a server with OpenAI's chat completions.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EndpointSettings {
    /// The server's address up to the version, such as `http://127.0.0.1:8080/v1`.
    pub endpoint: String,
    /// The server's name of the model.
    pub model: String,
    /// The environment variable with the API key; `None` for a server that needs no key.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub key_env: Option<String>,
    /// The field that carries a constraint. It has no default, because servers ignore fields that they do not know.
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
    /// Wait before the first retry, milliseconds. It doubles each time, plus a random part of up to the same length.
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
    /// `response_format`, a JSON schema of a string with a pattern: `OpenAI`, Ollama, vLLM, llama.cpp's server.
    JsonSchema,
    /// `structured_outputs` with a regular expression: vLLM from 0.12 on.
    StructuredOutputs,
    /// `guided_regex`: vLLM before 0.12.
    GuidedRegex,
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
    /// The address of chat completions.
    pub(crate) fn url(&self) -> Result<String, String> {
        if self.endpoint.contains(['@', '?', '#']) {
            return Err("endpoint must be a plain address; key_env names the environment variable of the key".into());
        }
        let plain = |character: char| character.is_ascii_alphanumeric() || "-._~%:/[]".contains(character);
        if self.host().is_none() || !self.endpoint.chars().all(plain) {
            let endpoint = &self.endpoint;
            return Err(format!("endpoint '{endpoint}' is not an address with http:// or https:// and a host"));
        }
        if self.model.trim().is_empty() {
            return Err("model is empty".into());
        }
        if !IMAGE_SIZES.contains(&self.image_size) {
            let (min, max) = (IMAGE_SIZES.start(), IMAGE_SIZES.end());
            return Err(format!("image_size is {}; it must be from {min} to {max}", self.image_size));
        }
        for (name, value) in [("connect_timeout_ms", self.connect_timeout_ms), ("timeout_ms", self.timeout_ms)] {
            if value == 0 {
                return Err(format!("{name} is 0; it must be at least 1"));
            }
        }
        Ok(format!("{}/chat/completions", self.endpoint.trim_end_matches('/')))
    }

    /// Whether the server runs on this machine, so that requests do not use the network.
    pub(crate) fn is_local(&self) -> bool {
        self.host().is_some_and(|host| {
            host.eq_ignore_ascii_case("localhost") || host.parse::<IpAddr>().is_ok_and(|address| address.is_loopback())
        })
    }

    fn host(&self) -> Option<&str> {
        let rest = self.endpoint.strip_prefix("http://").or_else(|| self.endpoint.strip_prefix("https://"))?;
        let authority = rest.split('/').next().expect("a split gives one part at least");
        let (host, _port) = match authority.strip_prefix('[') {
            Some(ipv6) => ipv6.split_once(']')?,
            None => authority.split_once(':').unwrap_or((authority, "")),
        };
        (!host.is_empty()).then_some(host)
    }
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
            let settings = serde_json::json!({"endpoint": endpoint, "model": "m", "grammar": "none"});
            let settings: EndpointSettings = serde_json::from_value(settings).unwrap();
            assert_eq!(settings.url().is_ok().then(|| settings.is_local()), local, "{endpoint}");
        }
    }
}
