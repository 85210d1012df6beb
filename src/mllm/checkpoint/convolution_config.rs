//! The layers of a decoder that convolve the last positions in the place of attention.

use super::config::{ConfigObject, check_ranges};
use crate::MllmError;

/// Which layers convolve, and over how many positions (`Lfm2Config`).
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ConvolutionConfig {
    layers: Vec<bool>,
    /// Positions that an output depends on, its own among them.
    pub taps: usize,
    /// Whether the convolution and its projections have biases.
    pub bias: bool,
}

/// Most positions of a convolution. Published ones have 3.
const MAX_TAPS: usize = 64;

impl ConvolutionConfig {
    /// Reads the keys that Llama does not have, of a decoder of so many layers.
    pub(super) fn read(text: &ConfigObject<'_>, layers: usize) -> Result<Self, MllmError> {
        const TYPES: &str = "layer_types";
        const FULL: &str = "full_attn_idxs";
        let types: Option<Vec<String>> = text.value(TYPES)?;
        let full: Option<Vec<usize>> = text.value(FULL)?;
        // Newer files name the kind of each layer, older ones the numbers of those with attention.
        let convolve = match (types, full) {
            (Some(types), _) => types
                .iter()
                .map(|kind| match kind.as_str() {
                    "conv" => Ok(true),
                    "full_attention" => Ok(false),
                    other => Err(text.error(
                        TYPES,
                        format!("'{other}' is not supported; conv and full_attention are"),
                    )),
                })
                .collect::<Result<Vec<_>, _>>()?,
            (None, Some(full)) => {
                if let Some(index) = full.iter().find(|index| **index >= layers) {
                    return Err(text.error(FULL, format!("{index} is none of {layers} layers")));
                }
                (0..layers).map(|layer| !full.contains(&layer)).collect()
            }
            (None, None) => vec![false; layers],
        };
        if convolve.len() != layers {
            let problem = format!("has {} entries for {layers} layers", convolve.len());
            return Err(text.error(TYPES, problem));
        }
        let taps = text.value("conv_L_cache")?.unwrap_or(3);
        check_ranges(text, &[("conv_L_cache", taps, MAX_TAPS)])?;
        Ok(Self {
            layers: convolve,
            taps,
            bias: text.value("conv_bias")?.unwrap_or(false),
        })
    }

    /// Whether a layer convolves.
    pub(crate) fn is_in(&self, layer: usize) -> bool {
        self.layers.get(layer).copied().unwrap_or(false)
    }
}

/// The width of the feed-forward layers: that of the configuration, or two thirds of it, rounded up
/// (`block_auto_adjust_ff_dim`).
pub(super) fn feed_forward_width(
    text: &ConfigObject<'_>,
    written: usize,
) -> Result<usize, MllmError> {
    let named = text.value("block_ff_dim")?;
    let width: usize = named.unwrap_or(written);
    if !text.value("block_auto_adjust_ff_dim")?.unwrap_or(true) {
        return Ok(width);
    }
    let multiple: usize = text.value("block_multiple_of")?.unwrap_or(256);
    check_ranges(
        text,
        &[
            ("block_multiple_of", multiple, super::config::MAX_WIDTH),
            (
                if named.is_some() {
                    "block_ff_dim"
                } else {
                    "intermediate_size"
                },
                width,
                2 * super::config::MAX_WIDTH,
            ),
        ],
    )?;
    let factor = text.positive("block_ffn_dim_multiplier")?.unwrap_or(1.0);
    // A cast of a float keeps to the range of the target.
    let width = ((2 * width / 3) as f64 * factor) as usize;
    let width = width.min(2 * super::config::MAX_WIDTH);
    Ok(width.next_multiple_of(multiple))
}

#[cfg(test)]
mod tests {
    use super::super::{DecoderType, LlamaConfig};
    use crate::checkpoint::ConfigObject;
    use serde_json::{Value, json};
    use std::path::Path;

    fn read(changes: &Value) -> Result<LlamaConfig, crate::MllmError> {
        let mut config = json!({
            "num_hidden_layers": 4, "hidden_size": 64, "num_attention_heads": 4, "num_key_value_heads": 2,
        });
        for (key, value) in changes.as_object().unwrap() {
            config[key] = value.clone();
        }
        LlamaConfig::read_as(
            ConfigObject::root(Path::new("config.json"), &config)?,
            DecoderType::Lfm2,
        )
    }

    #[test]
    fn feed_forward_layers_are_as_wide_as_published() {
        for (written, width) in [(6656, 4608), (10_240, 6912), (12_288, 8192)] {
            for key in ["intermediate_size", "block_ff_dim"] {
                assert_eq!(read(&json!({key: written})).unwrap().intermediate, width);
            }
        }
        let exact = json!({"intermediate_size": 10_752, "block_auto_adjust_ff_dim": false});
        assert_eq!(read(&exact).unwrap().intermediate, 10_752);
        let scaled = json!({"intermediate_size": 144, "block_ffn_dim_multiplier": 1.5, "block_multiple_of": 32});
        assert_eq!(read(&scaled).unwrap().intermediate, 160);
        // The width of a file comes before that of the class.
        let both = json!({"intermediate_size": 6656, "block_ff_dim": 12_288});
        assert_eq!(read(&both).unwrap().intermediate, 8192);
    }

    #[test]
    fn layers_are_named_by_their_kinds_or_by_the_numbers_of_attention() {
        let kinds = ["conv", "conv", "full_attention", "conv"];
        let [kinds, numbers, none] = [
            json!({"layer_types": kinds}),
            json!({"full_attn_idxs": [2]}),
            json!({}),
        ]
        .map(|keys| read(&keys).unwrap().convolution.unwrap());
        assert_eq!(kinds, numbers);
        assert!(kinds.is_in(1) && !kinds.is_in(2) && kinds.is_in(3) && !kinds.is_in(4));
        assert!((0..4).all(|layer| !none.is_in(layer)));
    }

    #[test]
    fn what_contradicts_is_named() {
        for (keys, key) in [
            (json!({"layer_types": ["conv"]}), "layer_types"),
            (
                json!({"layer_types": vec!["sliding_attention"; 4]}),
                "layer_types",
            ),
            (json!({"full_attn_idxs": [4]}), "full_attn_idxs"),
            (json!({"conv_L_cache": 0}), "conv_L_cache"),
            (json!({"conv_L_cache": 1000}), "conv_L_cache"),
            (json!({"block_multiple_of": 0}), "block_multiple_of"),
            (json!({"block_ff_dim": 0}), "block_ff_dim"),
            (
                json!({"block_ffn_dim_multiplier": 1e30}),
                "intermediate_size",
            ),
            (json!({"norm_eps": -1}), "norm_eps"),
            (json!({"hidden_size": 66}), "hidden_size"),
        ] {
            let error = read(&keys).unwrap_err().to_string();
            assert!(
                error.starts_with(&format!("config.json: {key}: ")),
                "{error}"
            );
        }
    }
}
