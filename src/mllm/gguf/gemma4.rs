//! What a Gemma 4 decoder has beyond Gemma 3's, in the metadata of a GGUF file.

use super::header::Header;
use crate::MllmError;
use serde_json::{Map, Value, json};

/// The value of `general.architecture`.
pub(crate) const ARCHITECTURE: &str = "gemma4";

const WIDE: &str = "gemma4.feed_forward_length";
const KEY_HEADS: &str = "gemma4.attention.head_count_kv";
const LOCAL_WIDTH: &str = "gemma4.attention.key_length_swa";
const LOCAL_VALUES: &str = "gemma4.attention.value_length_swa";
const LOCAL_ROTATED: &str = "gemma4.rope.dimension_count_swa";
const LOCAL_BASE: &str = "gemma4.rope.freq_base_swa";
const PATTERN: &str = "gemma4.attention.sliding_window_pattern";
const WINDOW: &str = "gemma4.attention.sliding_window";
const CAP: &str = "gemma4.final_logit_softcapping";
const SHARED: &str = "gemma4.attention.shared_kv_layers";
const INPUTS: &str = "gemma4.embedding_length_per_layer_input";
const TABLE: &str = "per_layer_token_embd.weight";
const FACTORS: &str = "rope_freqs.weight";

/// The bound of logits where a file has none, and the layers that share keys.
const DEFAULT_CAP: f64 = 30.0;
const DEFAULT_SHARED: usize = 0;
/// Widths of E2B and E4B, in which an image's tokens do not see one another, as llama.cpp knows
/// them; no key says it.
const CAUSAL: [u64; 2] = [1536, 2560];

/// A number, or one for each layer.
pub(super) fn by_layer(header: &Header, key: &str) -> Result<Option<Vec<u64>>, MllmError> {
    header.typed(
        key,
        "a whole number, or one for each layer",
        |value| match value {
            Value::Array(list) => list.iter().map(Value::as_u64).collect(),
            value => Some(vec![value.as_u64()?]),
        },
    )
}

/// The width of the first layers' feed-forward networks, and their heads of keys; the others follow
/// from these.
pub(super) fn first_layer(header: &Header) -> Result<[usize; 2], MllmError> {
    let first = |key: &str| -> Result<usize, MllmError> {
        let numbers = by_layer(header, key)?.ok_or_else(|| header.missing(key))?;
        let first = numbers.first().copied().filter(|first| *first > 0);
        first
            .and_then(|first| usize::try_from(first).ok())
            .ok_or_else(|| header.error(key, "expected a whole number above 0"))
    };
    Ok([first(WIDE)?, first(KEY_HEADS)?])
}

/// Adds the keys of Gemma 4 to a `text_config`, whose width of a head is that of global layers.
pub(super) fn add_keys(
    header: &Header,
    config: &mut Value,
    notes: &mut Vec<String>,
) -> Result<(), MllmError> {
    // Key by key, in the order in which one needs another.
    let layers = config["num_hidden_layers"].as_u64().unwrap_or(0) as usize;
    let pattern: Option<Vec<bool>> = header.list(PATTERN, "a list of true and false")?;
    let local = pattern.ok_or_else(|| header.missing(PATTERN))?;
    if local.len() != layers || local.last() != Some(&false) {
        let problem = format!("expected one entry for each of {layers} layers, the last false");
        return Err(header.error(PATTERN, problem));
    }
    config["layer_types"] = json!(
        local
            .iter()
            .map(|local| if *local {
                "sliding_attention"
            } else {
                "full_attention"
            })
            .collect::<Vec<_>>()
    );
    add_rotary(header, config)?;
    add_heads(header, config, &local)?;
    config["sliding_window"] = json!(header.required_count(WINDOW)?);
    if !header.metadata.contains_key(SHARED) {
        notes.push(header.taken(SHARED, DEFAULT_SHARED));
    }
    let shared = header.count_or_none(SHARED)?.unwrap_or(DEFAULT_SHARED);
    config["num_kv_shared_layers"] = json!(shared);
    config["use_double_wide_mlp"] = json!(is_wide(header, layers, shared)?);
    if !header.metadata.contains_key(INPUTS) {
        return Err(header.missing(INPUTS));
    }
    let width = header.count_or_none(INPUTS)?.unwrap_or(0);
    config["hidden_size_per_layer_input"] = json!(width);
    let table = header.tensors.get(TABLE);
    if let Some(rows) = table.and_then(|place| place.shape.first()) {
        config["vocab_size_per_layer_input"] = json!(rows);
    }
    let pad = header.metadata.get("tokenizer.ggml.padding_token_id");
    config["pad_token_id"] = pad.cloned().unwrap_or(json!(0));
    config["hidden_activation"] = json!("gelu_pytorch_tanh");
    config["final_logit_softcapping"] = if header.metadata.contains_key(CAP) {
        json!(header.number_or_none(CAP)?)
    } else {
        notes.push(header.taken(CAP, DEFAULT_CAP));
        json!(DEFAULT_CAP)
    };
    let hidden = config["hidden_size"].as_u64().unwrap_or(0);
    if !CAUSAL.contains(&hidden) {
        config["use_bidirectional_attention"] = json!("vision");
    }
    Ok(())
}

/// The rotary embeddings: a tensor has the factors of global layers.
fn add_rotary(header: &Header, config: &mut Value) -> Result<(), MllmError> {
    if !config["rope_scaling"].is_null() {
        let problem = "scaled positions are not supported for this model";
        return Err(header.error("gemma4.rope.scaling.type", problem));
    }
    if !header.tensors.contains_key(FACTORS) {
        return Err(MllmError::MissingTensor {
            folder: header.path.clone(),
            name: FACTORS.into(),
        });
    }
    let local = header.required_number(LOCAL_BASE)?;
    config["rope_parameters"] = json!({
        "full_attention": {"rope_type": "default", "rope_theta": config["rope_theta"].take()},
        "sliding_attention": {"rope_type": "default", "rope_theta": local},
    });
    Ok(())
}

/// The heads of both kinds of layers.
fn add_heads(header: &Header, config: &mut Value, local: &[bool]) -> Result<(), MllmError> {
    let global_width = config["head_dim"].take();
    let width = json!(header.required_count(LOCAL_WIDTH)?);
    for key in [LOCAL_VALUES, LOCAL_ROTATED] {
        if header
            .count(key)?
            .is_some_and(|found| json!(found) != width)
        {
            let problem =
                format!("is not the width of keys, {width}; heads of one width are supported");
            return Err(header.error(key, problem));
        }
    }
    let heads = by_layer(header, KEY_HEADS)?.ok_or_else(|| header.missing(KEY_HEADS))?;
    let of = |layer: usize| {
        heads
            .get(layer)
            .or(heads.first())
            .filter(|_| heads.len() == 1 || heads.len() == local.len())
    };
    // transformers' keys by layer say any heads that a file may have; only global layers differ.
    let mut own = None;
    let mut written = Map::new();
    for (layer, is_local) in local.iter().enumerate() {
        let found = of(layer).ok_or_else(|| {
            header.error(KEY_HEADS, format!("expected 1 or {} entries", local.len()))
        })?;
        if *is_local {
            let differs = own.replace(*found).is_some_and(|own| own != *found);
            if differs {
                let problem = "local layers with different heads are not supported";
                return Err(header.error(KEY_HEADS, problem));
            }
        } else {
            let shape = json!({"head_dim": global_width, "num_key_value_heads": found});
            written.insert(layer.to_string(), shape);
        }
    }
    config["head_dim"] = width;
    if let Some(own) = own {
        config["num_key_value_heads"] = json!(own);
    }
    config["per_layer_config"] = Value::Object(written);
    let global = local.iter().position(|local| !local).unwrap_or(0);
    let has = |part: &str| {
        let name = format!("blk.{global}.attn_{part}.weight");
        header.tensors.contains_key(&name)
    };
    config["attention_k_eq_v"] = json!(has("k") && !has("v"));
    Ok(())
}

/// Whether the layers that share keys have feed-forward networks of twice the width.
fn is_wide(header: &Header, layers: usize, shared: usize) -> Result<bool, MllmError> {
    let widths = by_layer(header, WIDE)?.ok_or_else(|| header.missing(WIDE))?;
    let [first, ..] = widths.as_slice() else {
        return Err(header.missing(WIDE));
    };
    if widths.len() == 1 {
        return Ok(false);
    }
    let split = layers.saturating_sub(shared);
    let (own, sharing) = widths.split_at(split.min(widths.len()));
    let all = |part: &[u64], width: u64| part.iter().all(|found| *found == width);
    let wide = first.saturating_mul(2);
    if widths.len() == layers && all(own, *first) {
        if all(sharing, *first) {
            return Ok(false);
        }
        if all(sharing, wide) {
            return Ok(true);
        }
    }
    let problem = format!(
        "expected {first} for each of {layers} layers, or {wide} for the last {shared}, which share keys ({SHARED})"
    );
    Err(header.error(WIDE, problem))
}
