//! The configuration of a decoder of Llama's kind in the metadata of a GGUF file.

use super::Entries;
use super::gemma;
use super::gemma3n;
use super::gemma4;
use super::header::Header;
use super::lfm2;
use super::qwen35;
use crate::MllmError;
use crate::checkpoint::LlamaConfig;
use planagent_kernels::attention::{RopeScaling, Yarn};
use serde_json::{Value, json};

/// The value of `general.architecture` of the decoders whose queries and keys have paired rows.
pub(crate) const ARCHITECTURE: &str = "llama";

/// The decoders that are read: `general.architecture`, `model_type` of the configuration.
const ARCHITECTURES: [(&str, &str); 10] = [
    (ARCHITECTURE, "llama"),
    ("qwen2", "qwen2"),
    ("qwen3", "qwen3"),
    ("qwen2vl", "qwen2_5_vl_text"),
    ("qwen3vl", "qwen3_vl_text"),
    (gemma::ARCHITECTURE, "gemma3_text"),
    (gemma3n::ARCHITECTURE, "gemma3n_text"),
    (gemma4::ARCHITECTURE, "gemma4_text"),
    (lfm2::ARCHITECTURE, "lfm2"),
    (qwen35::ARCHITECTURE, "qwen3_5_text"),
];
/// The architectures whose axes take turns in the rotary embedding; their files do not say so.
const INTERLEAVED: [&str; 2] = ["qwen3vl", qwen35::ARCHITECTURE];
/// The architectures whose positions have three axes.
const THREE_AXES: [&str; 3] = ["qwen2vl", "qwen3vl", qwen35::ARCHITECTURE];

/// The base of the rotary embedding where a file has none (`rope_freq_base_train` in llama.cpp).
const DEFAULT_THETA: f64 = 10_000.0;

/// Names of the decoders that are read.
pub(crate) fn architectures() -> impl Iterator<Item = &'static str> {
    ARCHITECTURES.into_iter().map(|(name, _)| name)
}

/// llama.cpp's name of the decoder of a `model_type`; none if this program reads no such file.
pub(crate) fn architecture_of(model_type: &str) -> Option<&'static str> {
    let model_type = match model_type {
        "mistral" => "llama",
        "qwen2_5_vl" | "qwen2_vl" | "qwen2_vl_text" => "qwen2_5_vl_text",
        "qwen3_vl" => "qwen3_vl_text",
        "qwen3_5" => "qwen3_5_text",
        "gemma3" => "gemma3_text",
        "gemma3n" => "gemma3n_text",
        "gemma4" => "gemma4_text",
        other => other,
    };
    let is_of = |(_, known): &(&str, &str)| *known == model_type;
    ARCHITECTURES.into_iter().find(is_of).map(|(name, _)| name)
}

/// The `text_config` of a decoder. What llama.cpp requires is required; a key with a default there
/// has this default, and a note says so.
pub(crate) fn text_config(header: &Header, notes: &mut Vec<String>) -> Result<Value, MllmError> {
    let architecture = header.architecture()?;
    let Some((_, model_type)) = ARCHITECTURES
        .into_iter()
        .find(|(name, _)| *name == architecture)
    else {
        return Err(header.error(
            "general.architecture",
            format!("'{architecture}' is not supported"),
        ));
    };
    let key = |name: &str| format!("{architecture}.{name}");
    let embedding = header
        .tensors
        .get("token_embd.weight")
        .and_then(|place| place.shape.first().copied());
    let Some(vocabulary) = embedding else {
        return Err(MllmError::MissingTensor {
            folder: header.path.clone(),
            name: "token_embd.weight".into(),
        });
    };
    if header.count_or_none(&key("expert_count"))?.is_some() {
        return Err(header.error(
            &key("expert_count"),
            "a mixture of experts is not supported",
        ));
    }
    let hidden = header.required_count(&key("embedding_length"))?;
    let heads = header.required_count(&key("attention.head_count"))?;
    let (key_heads, intermediate) = match architecture {
        lfm2::ARCHITECTURE => (lfm2::key_heads(header)?, None),
        gemma3n::ARCHITECTURE => (
            header.count(&key("attention.head_count_kv"))?,
            Some(gemma3n::widest_layer(header)?),
        ),
        gemma4::ARCHITECTURE => {
            let [intermediate, key_heads] = gemma4::first_layer(header)?;
            (Some(key_heads), Some(intermediate))
        }
        _ => (header.count(&key("attention.head_count_kv"))?, None),
    };
    let intermediate = match intermediate {
        Some(intermediate) => intermediate,
        None => header.required_count(&key("feed_forward_length"))?,
    };
    let head_dim = header
        .count(&key("attention.key_length"))?
        .unwrap_or(hidden / heads);
    let kv_heads = match key_heads {
        Some(key_heads) => key_heads,
        None => as_many_key_heads(header, &key("attention.head_count_kv"), heads, head_dim)?,
    };
    if let Some(rotated) = header
        .count(&key("rope.dimension_count"))?
        .filter(|rotated| *rotated != head_dim && architecture != qwen35::ARCHITECTURE)
    {
        return Err(header.error(
            &key("rope.dimension_count"),
            format!(
                "{rotated} of {head_dim} dimensions of a head are rotated; all of them is supported"
            ),
        ));
    }
    if let Some(width) = header
        .count(&key("attention.value_length"))?
        .filter(|width| *width != head_dim)
    {
        let problem = format!(
            "{width} is not the width of keys, {head_dim}; heads of one width are supported"
        );
        return Err(header.error(&key("attention.value_length"), problem));
    }
    let window = header.count_or_none(&key("attention.sliding_window"))?;
    let mut config = json!({
        // A window is the only difference of Mistral.
        "model_type": if window.is_some() && model_type == "llama" { "mistral" } else { model_type },
        "vocab_size": vocabulary,
        "hidden_size": hidden,
        "intermediate_size": intermediate,
        "num_hidden_layers": header.required_count(&key("block_count"))?,
        "num_attention_heads": heads,
        "num_key_value_heads": kv_heads,
        "head_dim": head_dim,
        "max_position_embeddings": header.required_count(&key("context_length"))?,
        "rms_norm_eps": header.required_number(&key("attention.layer_norm_rms_epsilon"))?,
        "rope_theta": theta(header, &key("rope.freq_base"), notes)?,
        "sliding_window": window,
        // The first layer may have no attention.
        "attention_bias": header.tensors.keys().any(|name| name.ends_with(".attn_q.bias")),
        "mlp_bias": header.tensors.contains_key("blk.0.ffn_up.bias"),
        "tie_word_embeddings": !header.tensors.contains_key("output.weight"),
    });
    match header.text(&key("rope.scaling.type"))? {
        Some("none") => {}
        // llama.cpp takes a factor without a type as linear, and 0 for no factor.
        None | Some("linear") => {
            let factor = header.number_or_none(&key("rope.scaling.factor"))?;
            let factor = factor.map_or_else(
                || header.number_or_none(&key("rope.scale_linear")),
                |factor| Ok(Some(factor)),
            )?;
            match factor {
                Some(factor) => {
                    config["rope_scaling"] = json!({"type": "linear", "factor": factor});
                }
                None if header.metadata.contains_key(&key("rope.scaling.type")) => {
                    notes.push(header.taken(&key("rope.scaling.factor"), 1));
                }
                None => {}
            }
        }
        Some("yarn") => config["rope_scaling"] = yarn(header, &key, notes)?,
        Some(other) => {
            return Err(header.error(
                &key("rope.scaling.type"),
                format!("'{other}' is not supported; linear and yarn are"),
            ));
        }
    }
    if architecture == gemma::ARCHITECTURE {
        gemma::add_keys(header, &mut config, notes)?;
    }
    if architecture == gemma3n::ARCHITECTURE {
        gemma3n::add_keys(header, &mut config, notes)?;
    }
    if architecture == gemma4::ARCHITECTURE {
        gemma4::add_keys(header, &mut config, notes)?;
    }
    if architecture == lfm2::ARCHITECTURE {
        lfm2::add_keys(header, &mut config)?;
    }
    if architecture == qwen35::ARCHITECTURE {
        qwen35::add_keys(header, &mut config)?;
    }
    let three = |value: &Value| {
        let counts: Option<Vec<u64>> = value.as_array()?.iter().map(Value::as_u64).collect();
        counts?.get(..3).map(<[u64]>::to_vec)
    };
    let sections_key = key("rope.dimension_sections");
    match header.typed(&sections_key, "a list of three counts or more", three)? {
        Some(sections) => {
            config["rope_scaling"]["mrope_section"] = json!(sections);
            config["rope_scaling"]["mrope_interleaved"] =
                json!(INTERLEAVED.contains(&architecture));
        }
        None if THREE_AXES.contains(&architecture) => return Err(header.missing(&sections_key)),
        None => {}
    }
    Ok(config)
}

/// The base of the rotary embedding.
fn theta(header: &Header, key: &str, notes: &mut Vec<String>) -> Result<f64, MllmError> {
    let named = header.number(key)?;
    if named.is_none() {
        notes.push(header.taken(key, DEFAULT_THETA));
    }
    Ok(named.unwrap_or(DEFAULT_THETA))
}

/// The heads of keys of a file that does not say them: as many as heads, if its weights agree.
fn as_many_key_heads(
    header: &Header,
    key: &str,
    heads: usize,
    head_dim: usize,
) -> Result<usize, MllmError> {
    let keys = header.tensors.get("blk.0.attn_k.weight");
    match keys.and_then(|place| place.shape.first()) {
        Some(&rows) if rows != heads.saturating_mul(head_dim) => {
            let problem = format!(
                "is missing from the metadata, and the {rows} rows of keys are not those of {heads} heads"
            );
            Err(header.error(key, problem))
        }
        _ => Ok(heads),
    }
}

/// The `rope_scaling` of a decoder with `YaRN`. llama.cpp's converter writes transformers' keys
/// under its own names; a factor that is left out is 1 there.
fn yarn(
    header: &Header,
    key: &dyn Fn(&str) -> String,
    notes: &mut Vec<String>,
) -> Result<Value, MllmError> {
    let number = |name: &str| header.number_or_none(&key(&format!("rope.scaling.{name}")));
    // 1 is its default. Others mix in what transformers does not know.
    if let Some(mix) = number("yarn_ext_factor")?.filter(|mix| (mix - 1.0).abs() > 1e-6) {
        let problem = format!("{mix} is not supported; 1 is");
        return Err(header.error(&key("rope.scaling.yarn_ext_factor"), problem));
    }
    let named = number("factor")?;
    if named.is_none() {
        notes.push(header.taken(&key("rope.scaling.factor"), 1));
    }
    let factor = named.unwrap_or(1.0);
    let scale = number("attn_factor")?.unwrap_or(1.0);
    let named = number("yarn_attn_factor")?;
    let attention = named.unwrap_or_else(|| Yarn::advised_attention(factor, 1.0)) * scale;
    Ok(json!({
        "type": "yarn",
        "factor": factor,
        "original_max_position_embeddings": number("original_context_length")?,
        "beta_fast": number("yarn_beta_fast")?,
        "beta_slow": number("yarn_beta_slow")?,
        "attention_factor": attention,
    }))
}

/// The metadata that [`text_config`] reads, for a decoder of this architecture.
///
/// # Errors
/// The part that llama.cpp has no key for.
pub(crate) fn metadata(architecture: &str, config: &LlamaConfig) -> Result<Entries, &'static str> {
    let mut metadata = vec![
        ("vocab_size", json!(config.vocabulary)),
        ("embedding_length", json!(config.hidden)),
        ("feed_forward_length", json!(config.intermediate)),
        ("block_count", json!(config.layers)),
        ("attention.head_count", json!(config.heads)),
        ("attention.head_count_kv", json!(config.kv_heads)),
        ("attention.key_length", json!(config.head_dim)),
        ("attention.value_length", json!(config.head_dim)),
        ("context_length", json!(config.context)),
        (
            "attention.layer_norm_rms_epsilon",
            json!(config.rms_norm_eps),
        ),
        ("rope.dimension_count", json!(config.head_dim)),
        ("rope.freq_base", json!(config.rope.theta)),
    ];
    if let Some(window) = config.window {
        metadata.push(("attention.sliding_window", json!(window)));
    }
    match config.rope.scaling {
        // A tensor has the factors of Llama 3. A dynamic base is that of the training up to its
        // context, and llama.cpp has no other for it.
        RopeScaling::None | RopeScaling::Llama3 { .. } | RopeScaling::Dynamic { .. } => {}
        RopeScaling::Proportional { .. } => return Err("heads of which some pairs are not turned"),
        RopeScaling::Yarn(yarn) if !yarn.truncate => {
            return Err("borders of YaRN between two pairs");
        }
        RopeScaling::Yarn(yarn) => {
            let advised = Yarn::advised_attention(yarn.factor, 1.0);
            metadata.extend([
                ("rope.scaling.type", json!("yarn")),
                ("rope.scaling.factor", json!(yarn.factor)),
                (
                    "rope.scaling.original_context_length",
                    json!(yarn.original_context as u64),
                ),
                ("rope.scaling.yarn_beta_fast", json!(yarn.beta_fast)),
                ("rope.scaling.yarn_beta_slow", json!(yarn.beta_slow)),
                ("rope.scaling.attn_factor", json!(yarn.attention / advised)),
            ]);
        }
        RopeScaling::Linear { factor } => {
            metadata.push(("rope.scaling.type", json!("linear")));
            metadata.push(("rope.scaling.factor", json!(factor)));
        }
    }
    Ok(metadata
        .into_iter()
        .map(|(key, value)| (format!("{architecture}.{key}"), value))
        .collect())
}

/// The projection of a decoder layer that a tensor makes (`attn_q`, `attn_k`, ...), by its name in
/// the file.
pub(crate) fn projection(name: &str) -> Option<&str> {
    name.strip_prefix("blk.")?.split('.').nth(1)
}
