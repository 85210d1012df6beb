//! What an LFM2 decoder has beyond Llama's, in the metadata of a GGUF file.

use super::Entries;
use super::header::Header;
use super::llama;
use crate::MllmError;
use crate::checkpoint::LlamaConfig;
use serde_json::{Value, json};

/// The value of `general.architecture`.
pub(crate) const ARCHITECTURE: &str = "lfm2";

const KEY_HEADS: &str = "lfm2.attention.head_count_kv";
const TAPS: &str = "lfm2.shortconv.l_cache";

/// The heads of keys, and the kind of each layer: a file has the heads layer by layer, 0 where one
/// convolves, or one number where none does.
pub(super) fn key_heads(header: &Header) -> Result<Option<usize>, MllmError> {
    let mut heads = listed(header)?;
    heads.retain(|heads| *heads > 0);
    heads.dedup();
    match heads.as_slice() {
        [] => Ok(None),
        [one] => Ok(usize::try_from(*one).ok()),
        several => Err(header.error(
            KEY_HEADS,
            format!("{several:?} heads of keys in several layers; one number is supported"),
        )),
    }
}

fn listed(header: &Header) -> Result<Vec<u64>, MllmError> {
    let read = |value: &Value| match value {
        Value::Array(list) => list.iter().map(Value::as_u64).collect(),
        value => Some(vec![value.as_u64()?]),
    };
    let found = header.typed(KEY_HEADS, "a whole number, or one for each layer", read)?;
    Ok(found.unwrap_or_default())
}

/// Adds the keys of LFM2 to a `text_config`.
pub(super) fn add_keys(header: &Header, config: &mut Value) -> Result<(), MllmError> {
    let kinds: Vec<&str> = listed(header)?
        .iter()
        .map(|heads| if *heads > 0 { "full_attention" } else { "conv" })
        .collect();
    if kinds.len() > 1 {
        config["layer_types"] = json!(kinds);
    }
    config["norm_eps"] = config["rms_norm_eps"].take();
    config["conv_L_cache"] = json!(header.required_count(TAPS)?);
    config["conv_bias"] = json!(header.tensors.contains_key("blk.0.shortconv.conv.bias"));
    // The width in the file is the adjusted one.
    config["block_auto_adjust_ff_dim"] = json!(false);
    Ok(())
}

/// The metadata of a decoder, or the part that llama.cpp has no place for.
pub(crate) fn metadata(config: &LlamaConfig) -> Result<Entries, &'static str> {
    let Some(convolution) = &config.convolution else {
        return Err("another decoder than LFM2");
    };
    if convolution.bias {
        return Err("biases of short convolutions");
    }
    if config.head_dim * config.heads != config.hidden {
        return Err("heads that are not as wide together as the hidden states");
    }
    let heads = (0..config.layers).map(|layer| {
        if convolution.is_in(layer) {
            0
        } else {
            config.kv_heads
        }
    });
    let mut metadata = llama::metadata(ARCHITECTURE, config)?;
    metadata.retain(|(key, _)| key != KEY_HEADS);
    metadata.push((KEY_HEADS.to_owned(), json!(heads.collect::<Vec<_>>())));
    metadata.push((TAPS.to_owned(), json!(convolution.taps)));
    Ok(metadata)
}
