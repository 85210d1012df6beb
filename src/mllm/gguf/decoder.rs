//! The metadata of a decoder of any kind that llama.cpp has an architecture for.

use super::{Entries, gemma, lfm2, llama};
use crate::checkpoint::LlamaConfig;
use serde_json::json;

/// The value of `general.architecture` and the other metadata of a decoder.
///
/// # Errors
/// The part that llama.cpp has no key for.
pub(crate) fn describe(config: &LlamaConfig) -> Result<(&'static str, Entries), &'static str> {
    if config.streams.is_some() {
        return Err("streams of hidden states one by one");
    }
    if config.layer_scales {
        return Err("layers of different shapes");
    }
    if config.gemma.is_some() {
        if config.attention_bias {
            return Err("biases of these projections");
        }
        let mut metadata = llama::metadata(gemma::ARCHITECTURE, config)?;
        metadata.extend(gemma::metadata(config)?);
        return Ok((gemma::ARCHITECTURE, metadata));
    }
    if config.delta.is_some() {
        // Its value heads would have to be written in another order.
        return Err("layers with a delta rule");
    }
    if config.convolution.is_some() {
        return Ok((lfm2::ARCHITECTURE, lfm2::metadata(config)?));
    }
    let architecture = architecture(config)?;
    let mut metadata = llama::metadata(architecture, config)?;
    if let Some(sections) = config.rope.sections {
        let [time, height, width] = sections.lengths;
        let key = format!("{architecture}.rope.dimension_sections");
        // llama.cpp has four axes.
        metadata.push((key, json!([time, height, width, 0])));
    }
    Ok((architecture, metadata))
}

/// The architecture of a decoder with the tensors of Llama.
fn architecture(config: &LlamaConfig) -> Result<&'static str, &'static str> {
    let axes = config.rope.sections.map(|sections| sections.interleaved);
    let biases = (config.head_norms, config.attention_bias, config.output_bias);
    match (axes, biases) {
        (None, (true, false, false)) => Ok("qwen3"),
        (None, (false, true, false)) => Ok("qwen2"),
        (None, (false, false, false)) => Ok("llama"),
        (Some(true), (true, false, false)) => Ok("qwen3vl"),
        (Some(false), (false, true, false)) => Ok("qwen2vl"),
        _ => Err("biases of these projections"),
    }
}
