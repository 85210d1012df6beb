//! What a Qwen 3.5 decoder has beyond Llama's, in the metadata of a GGUF file.

use super::header::Header;
use crate::MllmError;
use serde_json::{Value, json};

/// The value of `general.architecture`.
pub(crate) const ARCHITECTURE: &str = "qwen35";

const BLOCKS: &str = "qwen35.block_count";
const PREDICTING: &str = "qwen35.nextn_predict_layers";
const RECURRENT: &str = "qwen35.attention.recurrent_layers";
const EVERY: &str = "qwen35.full_attention_interval";
const ROTATED: &str = "qwen35.rope.dimension_count";
const TAPS: &str = "qwen35.ssm.conv_kernel";
const KEY_WIDTH: &str = "qwen35.ssm.state_size";
const KEYS: &str = "qwen35.ssm.group_count";
const VALUES: &str = "qwen35.ssm.time_step_rank";
const INNER: &str = "qwen35.ssm.inner_size";

/// Layers from one with attention to the next, where a file does not say it.
const INTERVAL: usize = 4;

/// Layers of the model: the last blocks of a file may be those that predict further tokens, which
/// are no part of it.
pub(super) fn layers(header: &Header) -> Result<usize, MllmError> {
    let blocks = header.required_count(BLOCKS)?;
    let predicting = header.count_or_none(PREDICTING)?.unwrap_or(0);
    match blocks.checked_sub(predicting) {
        Some(layers) if layers > 0 => Ok(layers),
        _ => {
            let problem = format!("is {predicting}, and {BLOCKS} is {blocks}");
            Err(header.error(PREDICTING, problem))
        }
    }
}

/// Adds the keys of Qwen 3.5 to a `text_config`.
pub(super) fn add_keys(header: &Header, config: &mut Value) -> Result<(), MllmError> {
    let layers = layers(header)?;
    config["num_hidden_layers"] = json!(layers);
    let recurrent: Option<Vec<bool>> = header.list(RECURRENT, "a list of true and false")?;
    if let Some(recurrent) = recurrent {
        let Some(own) = recurrent.get(..layers) else {
            let problem = format!("has {} entries for {layers} layers", recurrent.len());
            return Err(header.error(RECURRENT, problem));
        };
        let kind = |recurrent: &bool| {
            if *recurrent {
                "linear_attention"
            } else {
                "full_attention"
            }
        };
        config["layer_types"] = json!(own.iter().map(kind).collect::<Vec<_>>());
        // The list says more.
        header.count_or_none(EVERY)?;
    } else {
        let every = header.count(EVERY)?.unwrap_or(INTERVAL);
        config["full_attention_interval"] = json!(every);
    }
    let (values, inner) = (
        header.required_count(VALUES)?,
        header.required_count(INNER)?,
    );
    if values == 0 || !inner.is_multiple_of(values) {
        let problem = format!("{inner} is no multiple of {values} heads ({VALUES})");
        return Err(header.error(INNER, problem));
    }
    config["linear_num_value_heads"] = json!(values);
    config["linear_value_head_dim"] = json!(inner / values);
    config["linear_num_key_heads"] = json!(header.required_count(KEYS)?);
    config["linear_key_head_dim"] = json!(header.required_count(KEY_WIDTH)?);
    config["linear_conv_kernel_dim"] = json!(header.required_count(TAPS)?);
    let head = config["head_dim"].as_u64().unwrap_or(1).max(1);
    if let Some(rotated) = header.count(ROTATED)? {
        config["partial_rotary_factor"] = json!(rotated as f64 / head as f64);
    }
    Ok(())
}

/// The name by which tables know a tensor of a decoder; none for a tensor of a block that predicts
/// further tokens.
pub(crate) fn renamed(header: &Header, name: &str) -> Result<Option<String>, MllmError> {
    let block = name
        .strip_prefix("blk.")
        .and_then(|rest| rest.split_once('.'));
    let Some((number, part)) = block else {
        return Ok(Some(name.to_owned()));
    };
    let predicts = match number.parse::<usize>() {
        // An adapter does not say how many blocks there are.
        Ok(number) if header.metadata.contains_key(PREDICTING) => number >= layers(header)?,
        _ => false,
    };
    Ok((!predicts).then(|| match part {
        // The one name without an ending.
        "ssm_a" => format!("{name}.weight"),
        _ => name.to_owned(),
    }))
}
