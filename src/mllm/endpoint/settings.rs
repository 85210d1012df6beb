//! What a description says about a server.

use std::net::IpAddr;

use reqwest::Url;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

/// How long a connection may take to come about, milliseconds.
const CONNECT_TIMEOUT_MS: u64 = 10_000;
/// How long an answer may take, milliseconds: some ten times what the paper measured for a planning call of GPT-4V.
const TIMEOUT_MS: u64 = 60_000;
/// How often a request is made again.
const RETRIES: usize = 4;
/// The wait before the first repetition, milliseconds; it doubles from one to the next.
const FIRST_WAIT_MS: u64 = 500;
/// Side of the picture that is sent, pixels: what GPT-4V and its successors see without cutting it into tiles.
const IMAGE_SIZE: u32 = 512;
/// Sides that a picture may have, pixels.
const IMAGE_SIZES: std::ops::RangeInclusive<u32> = 32..=4096;

/// A model that a server computes, behind OpenAI's chat completions.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EndpointSettings {
    /// The server's address up to the version, such as `http://127.0.0.1:8080/v1`.
    pub endpoint: String,
    /// The model, as the server calls it.
    pub model: String,
    /// The environment variable that holds the key; none for a server that asks for none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub key_env: Option<String>,
    /// How constraints are sent. There is no default, since every server takes another field and ignores the others.
    pub grammar: GrammarField,
    /// The field that limits an answer's tokens.
    #[serde(default)]
    pub limit: LimitField,
    /// Whether answers are streamed, which tells the time to the first token.
    #[serde(default = "yes")]
    pub stream: bool,
    /// Side of the picture that is sent, pixels.
    #[serde(default = "image_size")]
    pub image_size: u32,
    /// How long a connection may take to come about, milliseconds.
    #[serde(default = "connect_timeout_ms")]
    pub connect_timeout_ms: u64,
    /// How long one request may take, from the connection to the answer's last byte, milliseconds.
    #[serde(default = "timeout_ms")]
    pub timeout_ms: u64,
    /// How often a request is made again that met a closed connection, 429 or 5xx.
    #[serde(default = "retries")]
    pub retries: usize,
    /// The wait before the first repetition, milliseconds; it doubles, and a random part of as much is added.
    #[serde(default = "first_wait_ms")]
    pub first_wait_ms: u64,
    /// Fields of the request that the server refuses and that are left out, such as `temperature`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub omit: Vec<String>,
    /// Further fields of the request, such as `reasoning_effort`.
    #[serde(default, skip_serializing_if = "Map::is_empty")]
    pub extra: Map<String, Value>,
}

/// The field in which a server takes a constraint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GrammarField {
    /// Nowhere: answers are free, and every record says so.
    None,
    /// `grammar`, in GBNF: llama.cpp's server and that of llama-cpp-python.
    Gbnf,
    /// `response_format` with a JSON schema, a string with a pattern: `OpenAI`, Ollama, vLLM, llama.cpp's server.
    JsonSchema,
    /// `structured_outputs` with a regular expression: vLLM from 0.12 on.
    StructuredOutputs,
    /// `guided_regex`: vLLM before 0.12.
    GuidedRegex,
}

/// The field that limits an answer's tokens.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LimitField {
    /// Everyone but `OpenAI`'s newer models.
    #[default]
    MaxTokens,
    /// `OpenAI`'s newer models.
    MaxCompletionTokens,
}

impl LimitField {
    /// Its name in a request.
    pub(super) fn as_str(self) -> &'static str {
        match self {
            Self::MaxTokens => "max_tokens",
            Self::MaxCompletionTokens => "max_completion_tokens",
        }
    }
}

fn yes() -> bool {
    true
}

fn image_size() -> u32 {
    IMAGE_SIZE
}

fn connect_timeout_ms() -> u64 {
    CONNECT_TIMEOUT_MS
}

fn timeout_ms() -> u64 {
    TIMEOUT_MS
}

fn retries() -> usize {
    RETRIES
}

fn first_wait_ms() -> u64 {
    FIRST_WAIT_MS
}

impl EndpointSettings {
    /// The address of chat completions.
    ///
    /// # Errors
    /// When a setting makes no sense, in words that name it.
    pub(crate) fn url(&self) -> Result<Url, String> {
        let wrong = |problem: &str| format!("endpoint {:?} {problem}", self.endpoint);
        let url = Url::parse(&self.endpoint).map_err(|error| wrong(&format!("is no address: {error}")))?;
        if !matches!(url.scheme(), "http" | "https") || url.host_str().is_none() {
            return Err(wrong("must begin with http:// or https:// and a host"));
        }
        if !url.username().is_empty() || url.password().is_some() || url.query().is_some() || url.fragment().is_some() {
            return Err("endpoint must be a plain address; a key is read from the variable that key_env names".into());
        }
        if self.model.trim().is_empty() {
            return Err("model is empty".into());
        }
        if !IMAGE_SIZES.contains(&self.image_size) {
            let (least, most) = (IMAGE_SIZES.start(), IMAGE_SIZES.end());
            return Err(format!("image_size is {}; it must lie in {least} to {most}", self.image_size));
        }
        for (name, value) in [("connect_timeout_ms", self.connect_timeout_ms), ("timeout_ms", self.timeout_ms)] {
            if value == 0 {
                return Err(format!("{name} is 0; it must be at least 1"));
            }
        }
        let whole = format!("{}/chat/completions", self.endpoint.trim_end_matches('/'));
        Url::parse(&whole).map_err(|error| wrong(&format!("is no address: {error}")))
    }

    /// Whether the server is on this machine, which is no use of the network.
    pub(crate) fn is_local(&self) -> bool {
        let Ok(url) = Url::parse(&self.endpoint) else { return false };
        let host = url.host_str().unwrap_or_default().trim_matches(['[', ']']);
        host == "localhost" || host.parse::<IpAddr>().is_ok_and(|address| address.is_loopback())
    }
}
