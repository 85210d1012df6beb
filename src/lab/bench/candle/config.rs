//! The configuration of a decoder as candle's classes read it: with every key, and in the form
//! before transformers 5.

use super::CandleError;
use serde_json::{Map, Value, json};
use std::path::Path;

/// A decoder of candle, by the `model_type` of its folder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Llama,
    Qwen2,
    Qwen3,
    Gemma3,
    Lfm2,
}

impl Kind {
    /// The kind of a `model_type`, or of the architecture of a GGUF file.
    pub(super) fn named(name: &str) -> Result<Self, CandleError> {
        match name {
            "llama" => Ok(Self::Llama),
            "qwen2" => Ok(Self::Qwen2),
            "qwen3" => Ok(Self::Qwen3),
            "gemma3_text" | "gemma3" => Ok(Self::Gemma3),
            "lfm2" => Ok(Self::Lfm2),
            other => Err(CandleError::Unsupported(format!(
                "'{other}': llama, qwen2, qwen3, gemma3_text and lfm2 are compared"
            ))),
        }
    }

    /// Defaults of the class for keys that a file may leave out and candle requires.
    fn defaults(self) -> Value {
        let shared = json!({
            "rms_norm_eps": 1e-6, "hidden_act": "silu", "attention_bias": false, "tie_word_embeddings": false,
            "sliding_window": 4096, "max_window_layers": 28, "use_sliding_window": false,
        });
        let own = match self {
            Self::Llama => json!({"max_position_embeddings": 2048}),
            Self::Qwen2 => json!({"max_position_embeddings": 32_768}),
            Self::Qwen3 => json!({"max_position_embeddings": 32_768, "head_dim": 128}),
            Self::Gemma3 => json!({
                "max_position_embeddings": 131_072, "head_dim": 256, "hidden_activation": "gelu_pytorch_tanh",
                "query_pre_attn_scalar": 256, "sliding_window_pattern": 6, "tie_word_embeddings": true,
                "final_logit_softcapping": null, "attn_logit_softcapping": null,
            }),
            Self::Lfm2 => json!({
                "max_position_embeddings": 128_000, "num_key_value_heads": 8, "norm_eps": 1e-5, "conv_L_cache": 3,
                "conv_bias": false, "tie_word_embeddings": true, "hidden_size": 2560, "num_hidden_layers": 32,
            }),
        };
        let mut all = shared;
        if let (Some(all), Value::Object(own)) = (all.as_object_mut(), own) {
            all.extend(own);
        }
        all
    }

    fn theta(self) -> f64 {
        match self {
            Self::Gemma3 | Self::Lfm2 => 1e6,
            Self::Llama | Self::Qwen2 | Self::Qwen3 => 1e4,
        }
    }
}

/// The configuration for candle, and what its class leaves out.
pub(super) fn for_candle(path: &Path, config: &Value) -> Result<(Kind, Value), CandleError> {
    let unsupported =
        |problem: String| CandleError::Unsupported(format!("{}: {problem}", path.display()));
    let Some(keys) = config.as_object() else {
        return Err(unsupported("expected an object".to_owned()));
    };
    let kind = Kind::named(keys.get("model_type").and_then(Value::as_str).unwrap_or(""))?;
    let mut all: Map<String, Value> = match kind.defaults() {
        Value::Object(all) => all,
        _ => Map::new(),
    };
    all.extend(
        keys.iter()
            .filter(|(_, value)| !value.is_null())
            .map(|(key, value)| (key.clone(), value.clone())),
    );
    if let Some(heads) = all.get("num_attention_heads").cloned() {
        all.entry("num_key_value_heads").or_insert(heads);
    }
    let part = |name: &str| {
        let sections = ["rope_scaling", "rope_parameters"].map(|key| keys.get(key));
        let found = sections
            .into_iter()
            .flatten()
            .find(|section| !section.is_null());
        found.map(|section| section.get(name).unwrap_or(section).clone())
    };
    let section = part("full_attention").unwrap_or(Value::Null);
    let rope_type = section.get("rope_type").or(section.get("type"));
    match rope_type.and_then(Value::as_str).unwrap_or("default") {
        "default" | "mrope" => {
            all.remove("rope_scaling");
        }
        "llama3" if kind == Kind::Llama => {
            all.insert("rope_scaling".to_owned(), section.clone());
        }
        other => {
            return Err(unsupported(format!(
                "candle's class has no rope_type {other}"
            )));
        }
    }
    // transformers 5 moved these keys into sections; candle reads them where they were before.
    let theta = section.get("rope_theta").or(keys.get("rope_theta"));
    all.insert(
        "rope_theta".to_owned(),
        theta.cloned().unwrap_or(json!(kind.theta())),
    );
    if kind == Kind::Gemma3 {
        let local = part("sliding_attention").unwrap_or(Value::Null);
        let local = local.get("rope_theta").or(keys.get("rope_local_base_freq"));
        all.insert(
            "rope_local_base_freq".to_owned(),
            local.cloned().unwrap_or(json!(1e4)),
        );
    }
    if kind == Kind::Lfm2 {
        write_lfm2(&mut all);
    }
    check(kind, &all).map_err(unsupported)?;
    Ok((kind, Value::Object(all)))
}

/// Writes the keys of an LFM2 as candle's class reads them: the kind of each layer by name, and the
/// width of the feed-forward layers, for which it has another rule, by a factor that gives it.
fn write_lfm2(all: &mut Map<String, Value>) {
    let number = |key: &str, default: u64| all.get(key).and_then(Value::as_u64).unwrap_or(default);
    let (layers, hidden) = (number("num_hidden_layers", 0), number("hidden_size", 1));
    let mut width = number("block_ff_dim", number("intermediate_size", 12_288));
    let adjusts = all.get("block_auto_adjust_ff_dim").and_then(Value::as_bool);
    if adjusts.unwrap_or(true) {
        let factor = all.get("block_ffn_dim_multiplier").and_then(Value::as_f64);
        let scaled = (2 * width / 3) as f64 * factor.unwrap_or(1.0);
        width = (scaled as u64).next_multiple_of(number("block_multiple_of", 256).max(1));
    }
    if let Some(full) = all.get("full_attn_idxs").and_then(Value::as_array).cloned() {
        let kind = |layer: u64| {
            if full.contains(&json!(layer)) {
                "full_attention"
            } else {
                "conv"
            }
        };
        let kinds: Vec<&str> = (0..layers.min(4096)).map(kind).collect();
        all.entry("layer_types").or_insert(json!(kinds));
    }
    let tied = all.get("tie_embedding").or(all.get("tie_word_embeddings"));
    let tied = tied.cloned().unwrap_or(json!(true));
    all.insert("tie_embedding".to_owned(), tied);
    // Half a number more, since the class rounds down.
    let factor = (width as f64 + 0.5) / (4 * hidden.max(1)) as f64;
    all.insert("block_ffn_dim_multiplier".to_owned(), json!(factor));
    all.insert("block_multiple_of".to_owned(), json!(1));
    // It takes one number each, and does not use them.
    for key in ["bos_token_id", "eos_token_id"] {
        all.remove(key);
    }
}

/// Refuses what candle's class would pass over.
fn check(kind: Kind, all: &Map<String, Value>) -> Result<(), String> {
    let number = |key: &str| all.get(key).and_then(Value::as_u64);
    let is_on = |key: &str| all.get(key).and_then(Value::as_bool).unwrap_or(false);
    // candle ignores keys that it does not know, so such a model would run and give wrong answers.
    for key in ["use_sliding_window", "mlp_bias"] {
        if is_on(key) {
            return Err(format!("candle's class has no {key}"));
        }
    }
    if kind == Kind::Lfm2 && is_on("conv_bias") {
        return Err("candle's class has no conv_bias".to_owned());
    }
    if kind == Kind::Llama {
        if is_on("attention_bias") {
            return Err("candle's class has no attention_bias".to_owned());
        }
        let (width, heads) = (number("hidden_size"), number("num_attention_heads"));
        let follows = width.zip(heads).map(|(width, heads)| width / heads.max(1));
        if let Some(named) = number("head_dim").filter(|named| Some(*named) != follows) {
            return Err(format!("candle's class has no head_dim, here {named}"));
        }
    }
    let types = all.get("layer_types").and_then(Value::as_array);
    if let (Kind::Gemma3, Some(types)) = (kind, types) {
        let every = number("sliding_window_pattern").unwrap_or(6).max(1);
        let expected = |layer: usize| {
            if (layer as u64 + 1).is_multiple_of(every) {
                "full_attention"
            } else {
                "sliding_attention"
            }
        };
        let differs = |(layer, kind): (usize, &Value)| kind.as_str() != Some(expected(layer));
        if types.iter().enumerate().any(differs) {
            return Err(format!("candle's class has a global layer every {every}"));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(config: &Value) -> Result<(Kind, Value), String> {
        for_candle(Path::new("config.json"), config).map_err(|error| error.to_string())
    }

    #[test]
    fn both_forms_of_a_configuration_become_one() {
        let old = json!({"model_type": "qwen2", "rope_theta": 5e5, "num_attention_heads": 4, "rope_scaling": null,
            "sliding_window": null});
        let new = json!({"model_type": "qwen2", "num_attention_heads": 4, "rope_parameters":
            {"rope_type": "default", "rope_theta": 5e5}});
        for config in [old, new] {
            let (kind, all) = read(&config).unwrap();
            assert_eq!(kind, Kind::Qwen2);
            assert_eq!(
                (&all["rope_theta"], &all["num_key_value_heads"]),
                (&json!(5e5), &json!(4))
            );
            assert_eq!(all["sliding_window"], json!(4096));
        }
        let gemma = json!({"model_type": "gemma3_text", "rope_parameters": {"full_attention": {"rope_theta": 2e6},
            "sliding_attention": {"rope_theta": 3e4}}});
        let (_, all) = read(&gemma).unwrap();
        assert_eq!(
            (&all["rope_theta"], &all["rope_local_base_freq"]),
            (&json!(2e6), &json!(3e4))
        );
    }

    #[test]
    fn an_lfm2_has_the_width_of_its_own_rule() {
        for (hidden, written, width) in [(1024, 6656, 4608), (2048, 12_288, 8192), (32, 90, 256)] {
            let config = json!({"model_type": "lfm2", "hidden_size": hidden, "intermediate_size": written,
                "num_hidden_layers": 3, "full_attn_idxs": [1]});
            let (_, all) = read(&config).unwrap();
            let factor = all["block_ffn_dim_multiplier"].as_f64().unwrap() as f32;
            assert_eq!((hidden as f32 * 4.0 * factor) as usize, width);
            assert_eq!(
                all["layer_types"],
                json!(["conv", "full_attention", "conv"])
            );
            assert_eq!(all["tie_embedding"], json!(true));
        }
    }

    #[test]
    fn what_a_class_would_pass_over_is_refused() {
        for (config, said) in [
            (json!({"model_type": "mistral"}), "'mistral'"),
            (json!([]), "expected an object"),
            (
                json!({"model_type": "qwen2", "rope_scaling": {"type": "yarn", "factor": 4}}),
                "rope_type yarn",
            ),
            (
                json!({"model_type": "qwen3", "use_sliding_window": true}),
                "use_sliding_window",
            ),
            (
                json!({"model_type": "llama", "hidden_size": 64, "num_attention_heads": 4, "head_dim": 32}),
                "head_dim, here 32",
            ),
            (
                json!({"model_type": "llama", "attention_bias": true}),
                "attention_bias",
            ),
            (
                json!({"model_type": "lfm2", "conv_bias": true}),
                "conv_bias",
            ),
            (
                json!({"model_type": "gemma3_text", "layer_types": ["full_attention"]}),
                "a global layer every 6",
            ),
        ] {
            let found = read(&config).unwrap_err();
            assert!(found.contains(said), "{config}: {found}");
        }
    }
}
