//! The descriptions of `models/` that are compiled into the program, for any working directory.
//! They name models of the hub and servers; weights are downloaded or asked for.

macro_rules! described {
    ($($name:literal),* $(,)?) => {
        &[$(($name, include_str!(concat!("../../../models/", $name, ".toml")))),*]
    };
}

/// Names and texts, by name.
const DESCRIBED: &[(&str, &str)] = described![
    "cogvlm-chat-17b",
    "gemma-3-4b",
    "gemma-3n-e2b",
    "gemma-4-e2b",
    "gemma-4-e4b",
    "internvl3-1b",
    "internvl3-2b",
    "lfm2-vl-450m",
    "lfm2.5-vl-1.6b",
    "lfm2.5-vl-450m",
    "llava-1.5-13b",
    "llava-1.5-7b",
    "llava-onevision-0.5b",
    "llava-onevision-7b",
    "llava-v1.6-mistral-7b",
    "llava-v1.6-vicuna-13b",
    "llava-v1.6-vicuna-7b",
    "local-server",
    "openai",
    "qwen2-vl-2b",
    "qwen2-vl-7b",
    "qwen2.5-vl-3b",
    "qwen2.5-vl-7b",
    "qwen3-vl-2b",
    "qwen3-vl-4b",
    "qwen3.5-0.8b",
    "qwen3.5-2b",
    "qwen3.5-4b",
    "smolvlm2-2.2b",
    "smolvlm2-256m",
    "smolvlm2-500m",
];

pub(super) fn names() -> impl Iterator<Item = &'static str> {
    DESCRIBED.iter().map(|(name, _)| *name)
}

/// The text of a description.
pub(super) fn find(name: &str) -> Option<&'static str> {
    DESCRIBED
        .iter()
        .find(|(known, _)| *known == name)
        .map(|(_, text)| *text)
}
