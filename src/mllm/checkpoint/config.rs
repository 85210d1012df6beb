//! `config.json` of a `LlavaForConditionalGeneration` checkpoint.
//!
//! Absent keys take the defaults of Hugging Face transformers' `LlavaConfig`, `CLIPVisionConfig` and `LlamaConfig`.

use std::path::Path;

use serde_json::{Map, Value};

use super::clip_config::{CLIP_BASE, ClipVisionConfig, LLAVA_TOWER};
use super::llama_config::LlamaConfig;
use super::section::Section;
use crate::mllm::MllmError;

/// A LLaVA model: which vision tower, which decoder, and how they are joined.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LlavaConfig {
    /// The CLIP vision tower.
    pub vision: ClipVisionConfig,
    /// The LLaMA decoder.
    pub text: LlamaConfig,
    /// Token id that stands for an image patch in the prompt.
    pub image_token: u32,
    /// Hidden states of the tower that are the image features, as indices into [embeddings, layer 1, layer 2, ...];
    /// several are concatenated.
    pub feature_layers: Vec<usize>,
    /// Which rows of the hidden states are used.
    pub feature_select: FeatureSelect,
    /// Activation between the projector's two layers.
    pub projector_act: Activation,
    /// Whether the projector's layers have biases.
    pub projector_bias: bool,
    /// Whether the output layer may share the embedding's weights.
    pub tie_word_embeddings: bool,
}

/// Which rows of a hidden state become image tokens (`vision_feature_select_strategy`).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum FeatureSelect {
    /// The patches, without the class token.
    Default,
    /// All rows, class token first.
    Full,
}

/// Activation functions by their names in Hugging Face configurations.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Activation {
    /// `gelu`: with the error function.
    Gelu,
    /// `gelu_new`, `gelu_pytorch_tanh`: with tanh.
    GeluTanh,
    /// `quick_gelu`: x·σ(1.702 x).
    QuickGelu,
    /// `relu`.
    Relu,
    /// `silu`, `swish`.
    Silu,
}

impl LlavaConfig {
    /// Reads a configuration; `path` is for messages.
    ///
    /// # Errors
    /// When a key has the wrong type or range, is unsupported, or contradicts another.
    pub(crate) fn from_json(path: &Path, value: &Value) -> Result<Self, MllmError> {
        let empty = Map::new();
        let root = Section::root(path, value)?;
        let absent = Value::Object(empty);
        match root.text("model_type")? {
            None | Some("llava") => {}
            Some(other) => {
                return Err(root.error("model_type", format!("{other:?} is not supported; llava is")));
            }
        }
        let vision = match root.section("vision_config", "vision_config.")? {
            Some(section) => ClipVisionConfig::from_section(&section, &CLIP_BASE)?,
            None => ClipVisionConfig::from_section(&Section::root(path, &absent)?, &LLAVA_TOWER)?,
        };
        let text_section = match root.section("text_config", "text_config.")? {
            Some(section) => section,
            None => Section::root(path, &absent)?,
        };
        let text = LlamaConfig::from_section(&text_section)?;
        let image_token = ["image_token_id", "image_token_index"]
            .into_iter()
            .map(|key| root.token_ids(key))
            .collect::<Result<Vec<_>, _>>()?
            .concat()
            .first()
            .copied()
            .unwrap_or(32_000);
        if image_token as usize >= text.vocabulary {
            return Err(root.error(
                "image_token_index",
                format!("{image_token} lies outside the vocabulary of {} (text_config.vocab_size)", text.vocabulary),
            ));
        }
        let feature_select = match root.text("vision_feature_select_strategy")? {
            None | Some("default") => FeatureSelect::Default,
            Some("full") => FeatureSelect::Full,
            Some(other) => {
                return Err(root.error(
                    "vision_feature_select_strategy",
                    format!("{other:?} is neither \"default\" nor \"full\""),
                ));
            }
        };
        Ok(Self {
            feature_layers: feature_layers(&root, vision.layers)?,
            feature_select,
            projector_act: activation(&root, "projector_hidden_act", Activation::Gelu)?,
            projector_bias: root.flag("multimodal_projector_bias", true)?,
            tie_word_embeddings: root.flag("tie_word_embeddings", false)?
                || text_section.flag("tie_word_embeddings", false)?,
            vision,
            text,
            image_token,
        })
    }

    /// Tokens that one image becomes.
    pub(crate) fn image_tokens(&self) -> usize {
        let class_token = usize::from(self.feature_select == FeatureSelect::Full);
        self.vision.patches() + class_token
    }
}

/// Reads `vision_feature_layer`: one index or a list, negative ones counted from the last hidden state.
fn feature_layers(root: &Section<'_>, layers: usize) -> Result<Vec<usize>, MllmError> {
    const KEY: &str = "vision_feature_layer";
    let states = layers as i64 + 1;
    let resolve = |value: &Value| {
        value
            .as_i64()
            .map(|index| if index < 0 { index + states } else { index })
            .filter(|index| (0..states).contains(index))
            .map(|index| index as usize)
            .ok_or_else(|| root.error(KEY, format!("{value} is no index into the {states} hidden states of the tower")))
    };
    match root.get(KEY) {
        None => Ok(vec![resolve(&Value::from(-2))?]),
        Some(Value::Array(values)) if !values.is_empty() => values.iter().map(resolve).collect(),
        Some(value) => Ok(vec![resolve(value)?]),
    }
}

/// Reads an activation by its name.
pub(super) fn activation(section: &Section<'_>, key: &str, default: Activation) -> Result<Activation, MllmError> {
    match section.text(key)? {
        None => Ok(default),
        Some("gelu") => Ok(Activation::Gelu),
        Some("gelu_new" | "gelu_pytorch_tanh") => Ok(Activation::GeluTanh),
        Some("quick_gelu") => Ok(Activation::QuickGelu),
        Some("relu") => Ok(Activation::Relu),
        Some("silu" | "swish") => Ok(Activation::Silu),
        Some(other) => Err(section.error(key, format!("activation {other:?} is not supported"))),
    }
}
