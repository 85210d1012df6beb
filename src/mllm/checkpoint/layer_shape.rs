//! Layers of a decoder that differ in shape.

use super::config::{
    ConfigObject, MAX_COUNT, MAX_HEAD, MAX_LAYERS, MAX_WIDTH, check_ranges, check_width,
};
use super::llama_config::LlamaConfig;
use crate::MllmError;
use serde_json::{Map, Value};
use std::collections::BTreeMap;

/// The shape of a layer with attention.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct LayerShape {
    /// Heads of keys and values.
    pub kv_heads: usize,
    /// Width of a head.
    pub head_dim: usize,
    /// Width of the feed-forward network.
    pub intermediate: usize,
    pub keys: LayerKeys,
}

/// Where a layer has its keys and values from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum LayerKeys {
    /// A projection to keys, and one to values.
    Projected,
    /// One projection, whose results are keys, and values too before norm and rotation.
    AsValues,
    /// Those of an earlier layer, by its number.
    Of(usize),
}

/// How global layers differ from local ones, and the last layers from those before
/// (`Gemma4TextConfig`).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct VariedShapes {
    /// Heads of keys, and width of a head, in global layers.
    pub global: [usize; 2],
    /// Whether global layers have no projection to values.
    pub keys_as_values: bool,
    /// The last layers, which use the keys and values of earlier ones.
    pub sharing: usize,
    /// Whether these have a feed-forward network of twice the width.
    pub wide: bool,
    /// The layers whose keys and values are used: a local one, a global one.
    pub shared: [usize; 2],
}

const SHARED: &str = "num_kv_shared_layers";
const BY_LAYER: &str = "per_layer_config";
const GLOBAL_WIDTH: &str = "global_head_dim";
const GLOBAL_KEYS: &str = "num_global_key_value_heads";

/// Width of a head in global layers where a file does not say it.
const DEFAULT_GLOBAL_WIDTH: usize = 512;

impl VariedShapes {
    /// Reads the keys of a decoder whose local layers are known.
    pub(super) fn read(
        text: &ConfigObject<'_>,
        config: &LlamaConfig,
        local: &[bool],
    ) -> Result<Self, MllmError> {
        // Keys by layer come before those for all global layers, as in transformers.
        let keys_as_values = text.value("attention_k_eq_v")?.unwrap_or(false);
        let own = [config.kv_heads, config.head_dim];
        let global = if let Some(layers) = text.value(BY_LAYER)? {
            by_layer(text, &layers, own, local)?
        } else {
            let width = text.value(GLOBAL_WIDTH)?.unwrap_or(DEFAULT_GLOBAL_WIDTH);
            let heads: Option<usize> = text.value(GLOBAL_KEYS)?;
            [heads.filter(|_| keys_as_values).unwrap_or(own[0]), width]
        };
        let ranges = [
            (GLOBAL_KEYS, global[0], MAX_LAYERS),
            (GLOBAL_WIDTH, global[1], MAX_HEAD),
        ];
        check_ranges(text, &ranges)?;
        check_width(text, "num_attention_heads", config.heads, global[1])?;
        if !config.heads.is_multiple_of(global[0]) {
            let problem = format!(
                "{} does not divide {} attention heads",
                global[0], config.heads
            );
            return Err(text.error(GLOBAL_KEYS, problem));
        }
        let sharing = text.value(SHARED)?.unwrap_or(0);
        Ok(Self {
            global,
            keys_as_values,
            sharing,
            wide: text.value("use_double_wide_mlp")?.unwrap_or(false),
            shared: shared(text, sharing, local)?,
        })
    }

    /// Reads the keys of a decoder whose layers are alike but for the last, which use the keys and
    /// values of earlier ones (`Gemma3nTextConfig`).
    pub(super) fn read_sharing(
        text: &ConfigObject<'_>,
        config: &LlamaConfig,
        local: &[bool],
    ) -> Result<Self, MllmError> {
        /// What the class takes where a file does not say it.
        const DEFAULT_SHARED: usize = 15;
        let sharing = text.value(SHARED)?.unwrap_or(DEFAULT_SHARED);
        Ok(Self {
            global: [config.kv_heads, config.head_dim],
            keys_as_values: false,
            sharing,
            wide: false,
            shared: shared(text, sharing, local)?,
        })
    }

    /// The shape of a layer, by its number from 0.
    pub(super) fn layer(&self, config: &LlamaConfig, layer: usize, is_local: bool) -> LayerShape {
        let shares = layer + self.sharing >= config.layers;
        let [kv_heads, head_dim] = if is_local {
            [config.kv_heads, config.head_dim]
        } else {
            self.global
        };
        LayerShape {
            kv_heads,
            head_dim,
            intermediate: config.width(layer) * if shares && self.wide { 2 } else { 1 },
            keys: if shares {
                LayerKeys::Of(self.shared[usize::from(!is_local)])
            } else if self.keys_as_values && !is_local {
                LayerKeys::AsValues
            } else {
                LayerKeys::Projected
            },
        }
    }
}

/// Heads of keys and width of a head in global layers, from what is written for single layers. The
/// rotary embedding of a kind has one width, so that layers of a kind are alike.
fn by_layer(
    text: &ConfigObject<'_>,
    layers: &BTreeMap<String, Map<String, Value>>,
    own: [usize; 2],
    local: &[bool],
) -> Result<[usize; 2], MllmError> {
    // First what is written, layer by layer, then whether layers of a kind are alike.
    let mut shapes = vec![own; local.len()];
    let wrong = |key: &str, problem: &str| text.error(&format!("{BY_LAYER}.{key}"), problem);
    for (key, keys) in layers {
        let number = key.parse().ok();
        let Some(shape) = number.and_then(|layer: usize| shapes.get_mut(layer)) else {
            return Err(wrong(key, &format!("is none of {} layers", local.len())));
        };
        for (name, value) in keys {
            let at = format!("{key}.{name}");
            let place = match name.as_str() {
                "num_key_value_heads" => 0,
                "head_dim" => 1,
                _ => {
                    let problem = "is not supported; head_dim and num_key_value_heads are";
                    return Err(wrong(&at, problem));
                }
            };
            let number = value.as_u64().and_then(|number| number.try_into().ok());
            shape[place] = number.ok_or_else(|| wrong(&at, "expected a whole number"))?;
        }
    }
    let of_kind = |kind: bool| {
        let alike = shapes.iter().zip(local).enumerate();
        alike.filter(move |(_, (_, local))| **local == kind)
    };
    if let Some((layer, _)) = of_kind(true).find(|(_, (shape, _))| **shape != own) {
        let problem = "local layers have the shape that is written for all";
        return Err(wrong(&layer.to_string(), problem));
    }
    let global = of_kind(false).next().map_or(own, |(_, (shape, _))| *shape);
    match of_kind(false).find(|(_, (shape, _))| **shape != global) {
        Some((layer, _)) => {
            let problem = "another shape than that of the global layers before is not supported";
            Err(wrong(&layer.to_string(), problem))
        }
        None => Ok(global),
    }
}

/// The last local and the last global layer before those that share.
fn shared(
    text: &ConfigObject<'_>,
    sharing: usize,
    local: &[bool],
) -> Result<[usize; 2], MllmError> {
    let split = local.len().checked_sub(sharing).filter(|split| *split > 0);
    let Some((before, sharers)) = split.and_then(|split| local.split_at_checked(split)) else {
        let problem = format!("{sharing} of {} layers cannot share", local.len());
        return Err(text.error(SHARED, problem));
    };
    let of_kind = |kind: bool| before.iter().rposition(|local| *local == kind);
    let found = [of_kind(true), of_kind(false)];
    for (kind, found) in [true, false].into_iter().zip(found) {
        if found.is_none() && sharers.contains(&kind) {
            let problem = format!("no layer before the last {sharing} is of the kind of each");
            return Err(text.error(SHARED, problem));
        }
    }
    Ok(found.map(|layer| layer.unwrap_or(0)))
}

/// Key of the tokens that have a row in the table of layers, in configurations that are made of
/// llama.cpp's files.
pub(crate) const KNOWN_TOKENS: &str = "known_tokens_per_layer_input";

/// Numbers of a token for each layer, from a table of their own and from its input row
/// ("per-layer embeddings").
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct LayerInputConfig {
    /// Numbers of a token for a layer.
    pub width: usize,
    /// Rows of the table.
    pub vocabulary: usize,
    /// Tokens that have a row: llama.cpp's files have rows of zeros behind those of a Gemma 3n.
    pub known: usize,
    /// The token whose row stands for that of an image's tokens, and of tokens behind the table.
    pub pad: u32,
}

impl LayerInputConfig {
    /// The row of a token; none stands for a row of an image.
    pub(crate) fn row(&self, token: Option<u32>) -> u32 {
        let in_table = |token: &u32| (*token as usize) < self.known;
        token.filter(in_table).unwrap_or(self.pad)
    }

    /// Reads the keys of a decoder that cannot do without such numbers, whose table may have fewer
    /// rows than there are tokens (`Gemma3nTextConfig`).
    pub(super) fn read_shorter(
        text: &ConfigObject<'_>,
        config: &LlamaConfig,
    ) -> Result<Self, MllmError> {
        const WIDTH: &str = "hidden_size_per_layer_input";
        const ROWS: &str = "vocab_size_per_layer_input";
        let width = text.value(WIDTH)?.unwrap_or(256);
        check_ranges(text, &[(WIDTH, width, MAX_WIDTH)])?;
        check_width(text, WIDTH, width, config.layers)?;
        let vocabulary = text.value(ROWS)?.unwrap_or(262_144);
        check_ranges(text, &[(ROWS, vocabulary, MAX_COUNT as usize)])?;
        let known = text.value(KNOWN_TOKENS)?.unwrap_or(vocabulary);
        // transformers takes the first row, whatever the padding is.
        Ok(Self {
            width,
            vocabulary,
            known: known.min(vocabulary),
            pad: 0,
        })
    }

    /// Reads the keys; none for a decoder without such numbers.
    pub(super) fn read(
        text: &ConfigObject<'_>,
        config: &LlamaConfig,
    ) -> Result<Option<Self>, MllmError> {
        const WIDTH: &str = "hidden_size_per_layer_input";
        const ROWS: &str = "vocab_size_per_layer_input";
        const PAD: &str = "pad_token_id";
        // Products are checked before a table is made for them.
        let width = text.value(WIDTH)?.unwrap_or(256);
        if width == 0 {
            return Ok(None);
        }
        check_width(text, WIDTH, width, config.layers)?;
        let vocabulary: usize = text.value(ROWS)?.unwrap_or(262_144);
        if vocabulary < config.vocabulary {
            let problem = format!("{vocabulary} rows for {} tokens", config.vocabulary);
            return Err(text.error(ROWS, problem));
        }
        check_ranges(text, &[(ROWS, vocabulary, MAX_COUNT as usize)])?;
        let pad: u32 = text.value(PAD)?.unwrap_or(0);
        if pad as usize >= config.vocabulary {
            let problem = format!("{pad} is none of {} tokens", config.vocabulary);
            return Err(text.error(PAD, problem));
        }
        Ok(Some(Self {
            width,
            vocabulary,
            known: vocabulary,
            pad,
        }))
    }
}
