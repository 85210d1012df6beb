//! What a Gemma 3 decoder has beyond Llama's, in the metadata of a GGUF file.

use super::Entries;
use super::header::Header;
use crate::MllmError;
use crate::checkpoint::LlamaConfig;
use serde_json::{Value, json};

/// The value of `general.architecture`.
pub(crate) const ARCHITECTURE: &str = "gemma3";

/// The base of the rotary embedding of local layers where a file has none: older files name that of
/// global layers alone.
const LOCAL_THETA: f64 = 10_000.0;
/// Layers from a global one to the next, where a file does not say it.
const PATTERN: usize = 6;
/// Layers of the one model whose queries are not scaled by the width of a head (27 billion
/// weights), as llama.cpp knows it; no key says it.
const LAYERS_OF_27B: u64 = 62;

const LOCAL_BASE: &str = "gemma3.rope.freq_base_swa";
const WINDOW: &str = "gemma3.attention.sliding_window";
const EVERY: &str = "gemma3.attention.sliding_window_pattern";

/// Adds the keys of Gemma 3 to a `text_config`.
pub(super) fn add_keys(
    header: &Header,
    config: &mut Value,
    notes: &mut Vec<String>,
) -> Result<(), MllmError> {
    let number = |config: &Value, key: &str| config[key].as_u64().unwrap_or(1);
    let (layers, hidden) = (
        number(config, "num_hidden_layers"),
        number(config, "hidden_size"),
    );
    let heads = number(config, "num_attention_heads");
    let scalar = if layers == LAYERS_OF_27B {
        hidden / heads.max(1)
    } else {
        number(config, "head_dim")
    };
    config["query_pre_attn_scalar"] = json!(scalar);
    config["hidden_activation"] = json!("gelu_pytorch_tanh");
    let local = header.number_or_none(LOCAL_BASE)?;
    if local.is_none() {
        notes.push(header.taken(LOCAL_BASE, LOCAL_THETA));
    }
    config["rope_local_base_freq"] = json!(local.unwrap_or(LOCAL_THETA));
    config["sliding_window"] = json!(header.required_count(WINDOW)?);
    config["sliding_window_pattern"] = json!(header.count(EVERY)?.unwrap_or(PATTERN));
    Ok(())
}

/// The keys beyond Llama's of a decoder, or the part that llama.cpp has no key for.
pub(crate) fn metadata(config: &LlamaConfig) -> Result<Entries, &'static str> {
    let Some(gemma) = &config.gemma else {
        return Err("another decoder than Gemma 3");
    };
    let is_local = |layer: usize| !(layer + 1).is_multiple_of(PATTERN);
    if !(0..config.layers).all(|layer| gemma.is_local(layer) == is_local(layer)) {
        return Err("other global layers than every sixth");
    }
    let scalar = if config.layers as u64 == LAYERS_OF_27B {
        (config.hidden / config.heads.max(1)) as f64
    } else {
        config.head_dim as f64
    };
    if gemma.query_scalar.to_bits() != scalar.to_bits() {
        return Err("queries scaled by another number than the width of a head");
    }
    Ok(vec![
        (WINDOW.to_owned(), json!(gemma.window)),
        (LOCAL_BASE.to_owned(), json!(gemma.local_rope.theta)),
    ])
}
