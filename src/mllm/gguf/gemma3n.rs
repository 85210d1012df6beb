//! What a Gemma 3n decoder has beyond Gemma 3's, in the metadata of a GGUF file.

use super::gemma4::by_layer;
use super::header::Header;
use crate::MllmError;
use crate::checkpoint::part_below;
use serde_json::{Value, json};

/// The value of `general.architecture`.
pub(crate) const ARCHITECTURE: &str = "gemma3n";

const WIDTHS: &str = "gemma3n.feed_forward_length";
const LOCAL_BASE: &str = "gemma3n.rope.freq_base_swa";
const PATTERN: &str = "gemma3n.attention.sliding_window_pattern";
const WINDOW: &str = "gemma3n.attention.sliding_window";
const CAP: &str = "gemma3n.final_logit_softcapping";
const SHARED: &str = "gemma3n.attention.shared_kv_layers";
const INPUTS: &str = "gemma3n.embedding_length_per_layer_input";
const STREAMS: &str = "gemma3n.altup.num_inputs";
const ACTIVE: &str = "gemma3n.altup.active_idx";
const DEVIATIONS: &str = "gemma3n.activation_sparsity_scale";
const TABLE: &str = "per_layer_token_embd.weight";
const LOW_RANK: &str = "blk.0.laurel_l.weight";

/// What llama.cpp takes where a file does not say it.
const DEFAULT_CAP: f64 = 30.0;
const DEFAULT_LOCAL_BASE: f64 = 10_000.0;

/// The width of the widest feed-forward network.
pub(super) fn widest_layer(header: &Header) -> Result<usize, MllmError> {
    let widths = by_layer(header, WIDTHS)?.ok_or_else(|| header.missing(WIDTHS))?;
    let widest = widths
        .iter()
        .max()
        .and_then(|width| usize::try_from(*width).ok());
    widest
        .filter(|_| widths.iter().all(|width| *width > 0))
        .ok_or_else(|| header.error(WIDTHS, "expected whole numbers above 0"))
}

/// Adds the keys of Gemma 3n to a `text_config`.
pub(super) fn add_keys(
    header: &Header,
    config: &mut Value,
    notes: &mut Vec<String>,
) -> Result<(), MllmError> {
    add_layers(header, config)?;
    config["rope_local_base_freq"] = json!(number(header, LOCAL_BASE, DEFAULT_LOCAL_BASE, notes)?);
    config["final_logit_softcapping"] = json!(number(header, CAP, DEFAULT_CAP, notes)?);
    config["sliding_window"] = json!(header.required_count(WINDOW)?);
    config["hidden_size_per_layer_input"] = json!(header.required_count(INPUTS)?);
    config["altup_num_inputs"] = json!(header.required_count(STREAMS)?);
    // Their 0 is a number, so they must be there.
    for (key, name) in [
        (SHARED, "num_kv_shared_layers"),
        (ACTIVE, "altup_active_idx"),
    ] {
        if !header.metadata.contains_key(key) {
            return Err(header.missing(key));
        }
        config[name] = json!(header.count_or_none(key)?.unwrap_or(0));
    }
    for (tensor, name) in [
        (TABLE, "vocab_size_per_layer_input"),
        (LOW_RANK, "laurel_rank"),
    ] {
        let place = header.tensors.get(tensor);
        if let Some(rows) = place.and_then(|place| place.shape.first()) {
            config[name] = json!(rows);
        }
    }
    config["hidden_activation"] = json!("gelu_pytorch_tanh");
    Ok(())
}

/// Adds how layers differ: their width, kind and sparsity.
fn add_layers(header: &Header, config: &mut Value) -> Result<(), MllmError> {
    let layers = config["num_hidden_layers"].as_u64().unwrap_or(0) as usize;
    // One number stands for all layers.
    if let Some(widths) = by_layer(header, WIDTHS)?.filter(|widths| widths.len() > 1) {
        check_length(header, WIDTHS, widths.len(), layers)?;
        config["intermediate_size"] = json!(widths);
    }
    let local: Option<Vec<bool>> = header.list(PATTERN, "a list of true and false")?;
    let local = local.ok_or_else(|| header.missing(PATTERN))?;
    check_length(header, PATTERN, local.len(), layers)?;
    let kind = |local| {
        if local {
            "sliding_attention"
        } else {
            "full_attention"
        }
    };
    config["layer_types"] = local.into_iter().map(kind).collect();
    config["activation_sparsity_pattern"] = json!(sparse_parts(header, layers)?);
    Ok(())
}

fn check_length(header: &Header, key: &str, found: usize, layers: usize) -> Result<(), MllmError> {
    if found == layers {
        return Ok(());
    }
    let problem = format!("expected one entry for each of {layers} layers, found {found}");
    Err(header.error(key, problem))
}

/// A positive number, or the one that llama.cpp takes.
fn number(
    header: &Header,
    key: &str,
    default: f64,
    notes: &mut Vec<String>,
) -> Result<f64, MllmError> {
    let found = header.number(key)?;
    if found.is_none() {
        notes.push(header.taken(key, default));
    }
    Ok(found.unwrap_or(default))
}

/// The part of gates that are 0 in each layer. A file has deviations above the mean, minus infinity
/// for no such part, which its reader holds as null.
fn sparse_parts(header: &Header, layers: usize) -> Result<Vec<f64>, MllmError> {
    let expected = "a list of numbers";
    let found: Option<Vec<Option<f64>>> = header.list(DEVIATIONS, expected)?;
    let deviations = found.ok_or_else(|| header.missing(DEVIATIONS))?;
    check_length(header, DEVIATIONS, deviations.len(), layers)?;
    let part = |deviations: Option<f64>| deviations.map_or(0.0, part_below);
    let parts: Vec<f64> = deviations.into_iter().map(part).collect();
    if parts.iter().all(|part| (0.0..1.0).contains(part)) {
        return Ok(parts);
    }
    Err(header.error(DEVIATIONS, "some are so many that no gate counts"))
}
