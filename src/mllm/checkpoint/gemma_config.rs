//! What a Gemma 3, 3n or 4 decoder has beyond Llama's.

use super::config::ConfigObject;
use super::layer_shape::VariedShapes;
use super::llama_config::LlamaConfig;
use super::rope_config::read_local_rope;
use crate::MllmError;
use planagent_kernels::attention::Rope;
use serde_json::json;

/// What a Gemma 3, 3n or 4 decoder has beyond Llama's: layers that see a window, with a rotary embedding
/// of their own, a norm behind each part of a layer, and scaled embeddings and queries. The norms of
/// Gemma 3 multiply by 1 + weight.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct GemmaConfig {
    /// Positions that a token of a local layer sees, its own among them.
    pub window: usize,
    /// Which layers are local.
    pub local: Vec<bool>,
    /// The rotary embedding of local layers.
    pub local_rope: Rope,
    /// Queries are multiplied by its root's inverse, not by that of the head's width
    /// (`query_pre_attn_scalar`).
    pub query_scalar: f64,
    /// The layers in which the tokens of an image see one another.
    pub image_mask: ImageMask,
    /// How layers differ in shape; none where they are alike.
    pub shapes: Option<VariedShapes>,
}

/// The layers in which the tokens of an image see one another, and not only those before.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ImageMask {
    All,
    Local,
    None,
}

/// Layers from a global one to the next, where nothing says it.
const PATTERN: usize = 6;
/// The same in Gemma 3n.
const PATTERN_OF_3N: usize = 5;

impl GemmaConfig {
    /// Reads the keys that Llama does not have; the number of layers and the window are those of
    /// `config`.
    pub(super) fn read(text: &ConfigObject<'_>, config: &LlamaConfig) -> Result<Self, MllmError> {
        const LIST: &str = "layer_types";
        const EVERY: &str = "sliding_window_pattern";
        const SCALAR: &str = "query_pre_attn_scalar";
        let types: Option<Vec<String>> = text.value(LIST)?;
        let local = if let Some(types) = types {
            types
                .iter()
                .map(|kind| match kind.as_str() {
                    "sliding_attention" => Ok(true),
                    "full_attention" => Ok(false),
                    other => Err(text.error(
                        LIST,
                        format!(
                            "'{other}' is not supported; sliding_attention and full_attention are"
                        ),
                    )),
                })
                .collect::<Result<Vec<_>, _>>()?
        } else {
            let every = text.value(EVERY)?.unwrap_or(PATTERN);
            if every == 0 {
                return Err(text.error(EVERY, "expected a whole number from 1 on, found 0"));
            }
            (1..=config.layers)
                .map(|layer| !layer.is_multiple_of(every))
                .collect()
        };
        if local.len() != config.layers {
            let problem = format!("has {} entries for {} layers", local.len(), config.layers);
            return Err(text.error(LIST, problem));
        }
        Ok(Self {
            // Without a window, a local layer differs by its rotary embedding alone.
            window: config.window.unwrap_or(config.context),
            local,
            local_rope: read_local_rope(text)?,
            query_scalar: text.positive(SCALAR)?.unwrap_or(config.head_dim as f64),
            image_mask: ImageMask::All,
            shapes: None,
        })
    }

    /// Reads the keys of a Gemma 4, whose layers differ in shape, and whose queries are not scaled.
    pub(super) fn read_varied(
        text: &ConfigObject<'_>,
        config: &LlamaConfig,
    ) -> Result<Self, MllmError> {
        const MASK: &str = "use_bidirectional_attention";
        let mut text = text.clone();
        // No keys of this class.
        for key in [
            "sliding_window_pattern",
            "query_pre_attn_scalar",
            "rope_local_base_freq",
        ] {
            text.remove(key);
        }
        let mut gemma = Self::read(&text, config)?;
        // As transformers does, whatever the list says.
        if let Some(last) = gemma.local.last_mut() {
            *last = false;
        }
        let mask: Option<String> = text.value(MASK)?;
        gemma.image_mask = match mask.as_deref() {
            None => ImageMask::None,
            Some("vision") => ImageMask::Local,
            Some(other) => {
                let problem = format!("'{other}' is not supported; vision and null are");
                return Err(text.error(MASK, problem));
            }
        };
        gemma.query_scalar = 1.0;
        gemma.shapes = Some(VariedShapes::read(&text, config, &gemma.local)?);
        Ok(gemma)
    }

    /// Reads the keys of a Gemma 3n, whose last layers share keys, and whose queries are not scaled.
    pub(super) fn read_sharing(
        text: &ConfigObject<'_>,
        config: &LlamaConfig,
    ) -> Result<Self, MllmError> {
        const EVERY: &str = "sliding_window_pattern";
        let mut text = text.clone();
        // No keys of this class, whose own pattern is another one.
        for key in [EVERY, "query_pre_attn_scalar"] {
            text.remove(key);
        }
        let text = text.with_defaults(json!({EVERY: PATTERN_OF_3N}));
        let gemma = Self::read(&text, config)?;
        Ok(Self {
            image_mask: ImageMask::None,
            query_scalar: 1.0,
            shapes: Some(VariedShapes::read_sharing(&text, config, &gemma.local)?),
            ..gemma
        })
    }

    /// Whether the tokens of an image see one another in a layer.
    pub(crate) fn sees_image(&self, layer: usize) -> bool {
        match self.image_mask {
            ImageMask::All => true,
            ImageMask::Local => self.is_local(layer),
            ImageMask::None => false,
        }
    }

    /// Whether they do so in any layer.
    pub(crate) fn sees_image_at_once(&self) -> bool {
        (0..self.local.len()).any(|layer| self.sees_image(layer))
    }

    /// Whether a layer is local.
    pub(crate) fn is_local(&self, layer: usize) -> bool {
        self.local.get(layer).copied().unwrap_or(false)
    }
}

#[cfg(test)]
mod tests {
    use super::super::{DecoderType, LlamaConfig};
    use crate::checkpoint::ConfigObject;
    use serde_json::{Value, json};
    use std::path::Path;

    fn read(changes: &Value) -> Result<LlamaConfig, crate::MllmError> {
        let mut config = json!({
            "num_hidden_layers": 7, "hidden_size": 64, "num_attention_heads": 4, "num_key_value_heads": 1, "head_dim": 32,
        });
        for (key, value) in changes.as_object().unwrap() {
            config[key] = value.clone();
        }
        LlamaConfig::read_as(
            ConfigObject::root(Path::new("config.json"), &config)?,
            DecoderType::Gemma3,
        )
    }

    #[test]
    fn both_forms_of_the_rotary_embeddings_are_read() {
        let old = json!({
            "rope_theta": 2e6, "rope_local_base_freq": 3e4, "rope_scaling": {"rope_type": "linear", "factor": 8.0},
            "sliding_window": 24, "sliding_window_pattern": 6,
        });
        let new = json!({
            "rope_parameters": {
                "full_attention": {"rope_theta": 2e6, "rope_type": "linear", "factor": 8.0},
                "sliding_attention": {"rope_theta": 3e4, "rope_type": "default"},
            },
            "sliding_window": 24,
            "layer_types": (1..=7).map(|layer| if layer == 6 { "full_attention" } else { "sliding_attention" }).collect::<Vec<_>>(),
        });
        let [old, new] = [old, new].map(|keys| read(&keys).unwrap());
        assert_eq!(old, new);
        let gemma = old.gemma.as_ref().unwrap();
        assert_eq!(gemma.window, 24);
        assert!(gemma.is_local(4) && !gemma.is_local(5) && gemma.is_local(6));
        assert_eq!((old.rope.theta, gemma.local_rope.theta), (2e6, 3e4));
        let plain = read(&json!({})).unwrap();
        let gemma = plain.gemma.as_ref().unwrap();
        assert_eq!((plain.rope.theta, gemma.local_rope.theta), (1e6, 1e4));
        assert_eq!((gemma.window, gemma.query_scalar), (4096, 256.0));
        assert!(plain.tie_word_embeddings && plain.head_norms && !plain.mlp_bias);
    }

    #[test]
    fn wrong_keys_are_named() {
        for (keys, named) in [
            (json!({"layer_types": ["full_attention"]}), "layer_types"),
            (
                json!({"layer_types": vec!["chunked_attention"; 7]}),
                "layer_types",
            ),
            (
                json!({"sliding_window_pattern": 0}),
                "sliding_window_pattern",
            ),
            (json!({"sliding_window": 0}), "sliding_window"),
            (json!({"query_pre_attn_scalar": 0}), "query_pre_attn_scalar"),
            (json!({"rope_local_base_freq": -1}), "rope_local_base_freq"),
            (
                json!({"attn_logit_softcapping": 50.0}),
                "attn_logit_softcapping",
            ),
            (
                json!({"final_logit_softcapping": 30.0}),
                "final_logit_softcapping",
            ),
            (
                json!({"use_bidirectional_attention": true}),
                "use_bidirectional_attention",
            ),
            (json!({"hidden_activation": "silu"}), "hidden_activation"),
        ] {
            let error = read(&keys).unwrap_err().to_string();
            assert!(error.contains(named), "{keys}: {error}");
        }
    }
}
