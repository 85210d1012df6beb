//! The configuration of a decoder in the metadata of a `llama` GGUF file, in both directions.

use serde_json::{Value, json};

use super::Entries;
use super::header::Header;
use crate::mllm::MllmError;
use crate::mllm::checkpoint::{LlamaConfig, RopeScaling};

/// The value of `general.architecture`.
pub(crate) const ARCHITECTURE: &str = "llama";

/// The `text_config` of a decoder.
pub(crate) fn text_config(header: &Header) -> Result<Value, MllmError> {
    let embedding = header.tensors.get("token_embd.weight").and_then(|place| place.shape.first().copied());
    let Some(vocabulary) = embedding else {
        return Err(MllmError::MissingTensor { folder: header.path.clone(), name: "token_embd.weight".into() });
    };
    if header.tensors.contains_key("rope_freqs.weight") {
        return Err(header.error(
            "rope_freqs.weight",
            "frequencies of rotary embeddings that are scaled one by one (Llama 3.1) are not read from a tensor; open the \
             safetensors, whose config.json says how they are scaled",
        ));
    }
    if header.count("llama.expert_count")?.is_some() {
        return Err(header.error("llama.expert_count", "a mixture of experts is not supported"));
    }
    let hidden = header.required_count("llama.embedding_length")?;
    let heads = header.required_count("llama.attention.head_count")?;
    let kv_heads = header.count("llama.attention.head_count_kv")?.unwrap_or(heads);
    let head_dim = header.count("llama.attention.key_length")?.unwrap_or(hidden / heads);
    if let Some(rotated) = header.count("llama.rope.dimension_count")?.filter(|rotated| *rotated != head_dim) {
        return Err(header.error(
            "llama.rope.dimension_count",
            format!("{rotated} of {head_dim} dimensions of a head are rotated; all of them is supported"),
        ));
    }
    let window = header.count("llama.attention.sliding_window")?;
    let mut config = json!({
        // A window is the only difference of Mistral.
        "model_type": if window.is_some() { "mistral" } else { "llama" },
        "vocab_size": vocabulary,
        "hidden_size": hidden,
        "intermediate_size": header.required_count("llama.feed_forward_length")?,
        "num_hidden_layers": header.required_count("llama.block_count")?,
        "num_attention_heads": heads,
        "num_key_value_heads": kv_heads,
        "head_dim": head_dim,
        "max_position_embeddings": header.required_count("llama.context_length")?,
        "rms_norm_eps": header.number("llama.attention.layer_norm_rms_epsilon")?,
        "rope_theta": header.number("llama.rope.freq_base")?,
        "sliding_window": window,
        "attention_bias": header.tensors.contains_key("blk.0.attn_q.bias"),
        "mlp_bias": header.tensors.contains_key("blk.0.ffn_up.bias"),
        "tie_word_embeddings": !header.tensors.contains_key("output.weight"),
    });
    match header.text("llama.rope.scaling.type")? {
        None | Some("none") => {}
        Some("linear") => {
            config["rope_scaling"] = json!({"type": "linear", "factor": header.number("llama.rope.scaling.factor")?});
        }
        Some(other) => {
            return Err(header.error("llama.rope.scaling.type", format!("'{other}' is not supported; linear is")));
        }
    }
    Ok(config)
}

/// The metadata that [`text_config`] reads.
///
/// # Errors
/// The part that llama.cpp has no key for.
pub(crate) fn metadata(config: &LlamaConfig) -> Result<Entries, &'static str> {
    let mut metadata = vec![
        ("llama.vocab_size", json!(config.vocabulary)),
        ("llama.embedding_length", json!(config.hidden)),
        ("llama.feed_forward_length", json!(config.intermediate)),
        ("llama.block_count", json!(config.layers)),
        ("llama.attention.head_count", json!(config.heads)),
        ("llama.attention.head_count_kv", json!(config.kv_heads)),
        ("llama.attention.key_length", json!(config.head_dim)),
        ("llama.attention.value_length", json!(config.head_dim)),
        ("llama.context_length", json!(config.context)),
        ("llama.attention.layer_norm_rms_epsilon", json!(config.rms_norm_eps)),
        ("llama.rope.dimension_count", json!(config.head_dim)),
        ("llama.rope.freq_base", json!(config.rope.theta)),
    ];
    if let Some(window) = config.window {
        metadata.push(("llama.attention.sliding_window", json!(window)));
    }
    match config.rope.scaling {
        RopeScaling::None => {}
        RopeScaling::Linear { factor } => {
            metadata.push(("llama.rope.scaling.type", json!("linear")));
            metadata.push(("llama.rope.scaling.factor", json!(factor)));
        }
        RopeScaling::Llama3 { .. } => return Err("llama3 scaling of rotary embeddings"),
    }
    Ok(metadata.into_iter().map(|(key, value)| (key.to_string(), value)).collect())
}

/// The projection of a decoder layer that a tensor makes (`attn_q`, `attn_k`, ...), by its name in the file.
pub(crate) fn projection(name: &str) -> Option<&str> {
    name.strip_prefix("blk.")?.split('.').nth(1)
}
