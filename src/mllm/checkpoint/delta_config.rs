//! The layers of a decoder that keep a matrix by the gated delta rule in the place of attention.

use super::config::{ConfigObject, MAX_WIDTH, check_ranges, check_width};
use crate::MllmError;
use planagent_kernels::DeltaHeads;

/// Which layers have the rule, their heads, and the convolution before it (`Qwen3_5TextConfig`).
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct DeltaConfig {
    layers: Vec<bool>,
    /// Heads, the values of each key's heads one behind the other.
    pub heads: DeltaHeads,
    /// Positions that the convolution spans, the present among them.
    pub taps: usize,
}

/// Most positions of the convolution. Published ones have 4.
const MAX_TAPS: usize = 64;
/// Most heads, and widest ones. Published ones have up to 64 heads of 128 numbers.
const MAX_HEADS: usize = 1 << 12;
/// Most numbers of the state of a layer. Published ones have up to a million.
const MAX_STATE: usize = 1 << 24;
/// Layers from one with attention to the next, where nothing says it.
const INTERVAL: usize = 4;

impl DeltaConfig {
    /// Reads the keys that Llama does not have, of a decoder of so many layers.
    pub(super) fn read(text: &ConfigObject<'_>, layers: usize) -> Result<Self, MllmError> {
        const VALUES: &str = "linear_num_value_heads";
        let number = |key: &str, default: usize, most: usize| -> Result<usize, MllmError> {
            let number = text.value(key)?.unwrap_or(default);
            check_ranges(text, &[(key, number, most)])?;
            Ok(number)
        };
        let heads = DeltaHeads {
            keys: number("linear_num_key_heads", 16, MAX_HEADS)?,
            values: number(VALUES, 32, MAX_HEADS)?,
            key_width: number("linear_key_head_dim", 128, MAX_HEADS)?,
            value_width: number("linear_value_head_dim", 128, MAX_HEADS)?,
            tiled: false,
        };
        let taps = number("linear_conv_kernel_dim", 4, MAX_TAPS)?;
        check_width(text, "linear_num_key_heads", heads.keys, heads.key_width)?;
        check_width(text, VALUES, heads.values, heads.value_width)?;
        if !heads.values.is_multiple_of(heads.keys) {
            let problem = format!(
                "{} is no multiple of {} key heads",
                heads.values, heads.keys
            );
            return Err(text.error(VALUES, problem));
        }
        // Each is at most 2^12, so that the product fits.
        let state = heads.values * heads.key_width * heads.value_width;
        if state > MAX_STATE || heads.channels() > MAX_WIDTH {
            let problem = format!(
                "a state of {state} numbers and rows of {} are larger than the {MAX_STATE} and {MAX_WIDTH} that are supported",
                heads.channels()
            );
            return Err(text.error(VALUES, problem));
        }
        Ok(Self {
            layers: kinds(text, layers)?,
            heads,
            taps,
        })
    }

    /// Whether a layer has the rule.
    pub(crate) fn is_in(&self, layer: usize) -> bool {
        self.layers.get(layer).copied().unwrap_or(false)
    }

    /// Numbers of the state of a layer: the matrices, and the last inputs of the convolution.
    pub(super) fn state(&self) -> usize {
        let heads = self.heads;
        let matrices = heads.values * heads.key_width * heads.value_width;
        matrices.saturating_add((self.taps - 1).saturating_mul(heads.channels()))
    }

    /// Numbers of a row that a layer's state reads: the inputs of the convolution, and two for each
    /// value head.
    pub(super) fn row(&self) -> usize {
        self.heads.channels() + 2 * self.heads.values
    }
}

/// Which of the layers have the rule: they are named one by one, or attention stands in each n-th.
fn kinds(text: &ConfigObject<'_>, layers: usize) -> Result<Vec<bool>, MllmError> {
    const TYPES: &str = "layer_types";
    const EVERY: &str = "full_attention_interval";
    let Some(types) = text.value::<Vec<String>>(TYPES)? else {
        let every = text.value(EVERY)?.unwrap_or(INTERVAL);
        if every == 0 {
            return Err(text.error(EVERY, "expected a whole number from 1 on, found 0"));
        }
        let layers = (1..=layers).map(|layer| !layer.is_multiple_of(every));
        return Ok(layers.collect());
    };
    if types.len() != layers {
        let problem = format!("has {} entries for {layers} layers", types.len());
        return Err(text.error(TYPES, problem));
    }
    let kind = |kind: &String| match kind.as_str() {
        "linear_attention" => Ok(true),
        "full_attention" => Ok(false),
        other => {
            let problem =
                format!("'{other}' is not supported; linear_attention and full_attention are");
            Err(text.error(TYPES, problem))
        }
    };
    types.iter().map(kind).collect()
}

#[cfg(test)]
mod tests {
    use super::super::{DecoderType, LlamaConfig};
    use crate::checkpoint::ConfigObject;
    use serde_json::{Value, json};
    use std::path::Path;

    fn read(changes: &Value) -> Result<LlamaConfig, crate::MllmError> {
        let mut config = json!({
            "num_hidden_layers": 6, "hidden_size": 64, "num_attention_heads": 4, "num_key_value_heads": 2,
        });
        for (key, value) in changes.as_object().unwrap() {
            config[key] = value.clone();
        }
        LlamaConfig::read_as(
            ConfigObject::root(Path::new("config.json"), &config)?,
            DecoderType::Qwen35,
        )
    }

    #[test]
    fn layers_are_named_by_their_kinds_or_by_an_interval() {
        let kinds = ["linear_attention", "linear_attention", "full_attention"].repeat(2);
        let [named, every, none] = [
            json!({"layer_types": kinds}),
            json!({"full_attention_interval": 3}),
            json!({}),
        ]
        .map(|keys| read(&keys).unwrap());
        assert_eq!(named, every);
        let delta = named.delta.as_ref().unwrap();
        assert!(delta.is_in(0) && !delta.is_in(2) && delta.is_in(3) && !delta.is_in(5));
        assert_eq!((named.attention_layers(), none.attention_layers()), (2, 1));
        assert_eq!(delta.state(), 32 * 128 * 128 + 3 * 8192);
    }

    #[test]
    fn a_part_of_a_head_is_turned_and_norms_add_one() {
        let config = read(&json!({})).unwrap();
        assert_eq!((config.head_dim, config.rotated), (256, 64));
        assert!(config.norms_add_one && config.output_gate && config.head_norms);
        assert_eq!(config.rope.theta.to_bits(), 10_000_f64.to_bits());
        let beside = json!({"partial_rotary_factor": 0.5, "head_dim": 128});
        let within = json!({"rope_parameters": {"partial_rotary_factor": 0.5}, "head_dim": 128});
        assert_eq!(read(&beside).unwrap(), read(&within).unwrap());
        assert_eq!(read(&beside).unwrap().rotated, 64);
    }

    #[test]
    fn what_contradicts_is_named() {
        for (keys, key) in [
            (json!({"layer_types": ["full_attention"]}), "layer_types"),
            (json!({"layer_types": vec!["mamba"; 6]}), "layer_types"),
            (
                json!({"full_attention_interval": 0}),
                "full_attention_interval",
            ),
            (json!({"linear_num_key_heads": 0}), "linear_num_key_heads"),
            (
                json!({"linear_num_value_heads": 24}),
                "linear_num_value_heads",
            ),
            (
                json!({"linear_num_value_heads": 1 << 20}),
                "linear_num_value_heads",
            ),
            (
                json!({"linear_key_head_dim": 4096, "linear_value_head_dim": 4096}),
                "linear_num_value_heads",
            ),
            (
                json!({"linear_conv_kernel_dim": 0}),
                "linear_conv_kernel_dim",
            ),
            (
                json!({"linear_conv_kernel_dim": 1000}),
                "linear_conv_kernel_dim",
            ),
            (
                json!({"partial_rotary_factor": 1.5}),
                "partial_rotary_factor",
            ),
            (
                json!({"partial_rotary_factor": 0.001}),
                "partial_rotary_factor",
            ),
            // 32 pairs by default.
            (json!({"head_dim": 128}), "mrope_section"),
            (json!({"hidden_act": "gelu"}), "hidden_act"),
        ] {
            let error = read(&keys).unwrap_err().to_string();
            assert!(
                error.starts_with("config.json: ") && error.contains(key),
                "{error}"
            );
        }
    }
}
