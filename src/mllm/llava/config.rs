//! `config.json` of a `LlavaForConditionalGeneration` checkpoint, and what LLaVA-NeXT's has in common with it.
//!
//! Absent keys take the defaults of Hugging Face transformers' `LlavaConfig`, `CLIPVisionConfig`, `LlamaConfig` and
//! `MistralConfig`.

use std::path::Path;

use serde_json::{Value, json};

use crate::mllm::MllmError;
use crate::mllm::checkpoint::{Activation, CLIP_BASE, LLAVA_TOWER, LlamaConfig, ModelFiles, Section, VisionConfig};

/// A LLaVA model: which vision tower, which decoder, and how they are joined.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LlavaConfig {
    /// The CLIP vision tower.
    pub vision: VisionConfig,
    /// The decoder.
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

/// The key that says that no token of the vocabulary stands for an image: checkpoints of llama.cpp have none, and their
/// placeholder is the first id behind the vocabulary.
pub(crate) const IMAGE_TOKEN_BEYOND: &str = "image_token_beyond_vocabulary";

impl LlavaConfig {
    /// Reads the `config.json` of a model.
    ///
    /// # Errors
    /// When it is missing or broken.
    pub(crate) fn open(files: &ModelFiles) -> Result<Self, MllmError> {
        Self::from_json(&files.path("config.json"), &files.required_json("config.json")?)
    }

    /// Reads a configuration; `path` is for messages.
    ///
    /// # Errors
    /// When a key has the wrong type or range, is unsupported, or contradicts another.
    pub(crate) fn from_json(path: &Path, value: &Value) -> Result<Self, MllmError> {
        let root = Section::root(path, value)?;
        let absent = json!({});
        let vision = match root.section("vision_config", "vision_config.")? {
            Some(section) => VisionConfig::from_clip_section(&section, &CLIP_BASE)?,
            None => VisionConfig::from_clip_section(&Section::root(path, &absent)?, &LLAVA_TOWER)?,
        };
        let text_section = match root.section("text_config", "text_config.")? {
            Some(section) => section,
            None => Section::root(path, &absent)?,
        };
        let text = LlamaConfig::from_section(&text_section)?;
        let image_token = image_token(&root, text.vocabulary)?;
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
            projector_act: Activation::from_section(&root, "projector_hidden_act", Activation::Gelu)?,
            projector_bias: root.flag("multimodal_projector_bias", true)?,
            tie_word_embeddings: root.flag("tie_word_embeddings", false)?
                || text_section.flag("tie_word_embeddings", false)?,
            vision,
            text,
            image_token,
        })
    }

    /// Tokens that one image, or one tile of it, becomes.
    pub(crate) fn image_tokens(&self) -> usize {
        let class_token = usize::from(self.feature_select == FeatureSelect::Full);
        self.vision.patches() + class_token
    }
}

/// Reads the id of the image's placeholder.
fn image_token(root: &Section<'_>, vocabulary: usize) -> Result<u32, MllmError> {
    if root.flag(IMAGE_TOKEN_BEYOND, false)? {
        return Ok(vocabulary as u32);
    }
    let ids = [root.token_ids("image_token_id")?, root.token_ids("image_token_index")?].concat();
    let id = ids.first().copied().unwrap_or(32_000);
    if (id as usize) < vocabulary {
        return Ok(id);
    }
    Err(root.error(
        "image_token_index",
        format!("{id} lies outside the vocabulary of {vocabulary} (text_config.vocab_size)"),
    ))
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mllm::checkpoint::{Rope, RopeScaling};

    fn parse(value: &Value) -> Result<LlavaConfig, MllmError> {
        LlavaConfig::from_json(Path::new("config.json"), value)
    }

    #[test]
    fn an_empty_configuration_is_what_transformers_makes_of_it() {
        // LlavaConfig() has no image token below LlamaConfig()'s vocabulary, so one is named here.
        let config = parse(&json!({"image_token_index": 5})).unwrap();
        assert_eq!((config.vision.hidden, config.vision.layers, config.vision.heads), (1024, 24, 16));
        assert_eq!((config.vision.patches(), config.image_tokens()), (576, 576));
        assert_eq!((config.text.hidden, config.text.layers, config.text.kv_heads), (4096, 32, 32));
        assert_eq!((config.text.head_dim, config.text.context, config.text.vocabulary), (128, 2048, 32_000));
        assert_eq!(config.feature_layers, [23]);
        assert_eq!(config.text.rope, Rope { theta: 10_000.0, scaling: RopeScaling::None });
        assert!(matches!(parse(&json!({})), Err(MllmError::Config { key, .. }) if key == "image_token_index"));
    }

    #[test]
    fn the_configuration_of_llava_1_5_is_read() {
        let config = parse(&json!({
            "architectures": ["LlavaForConditionalGeneration"], "ignore_index": -100, "image_token_index": 32000,
            "model_type": "llava", "pad_token_id": 32001, "projector_hidden_act": "gelu",
            "text_config": {"_name_or_path": "lmsys/vicuna-7b-v1.5", "max_position_embeddings": 4096,
                "model_type": "llama", "rms_norm_eps": 1e-05, "torch_dtype": "float16", "vocab_size": 32064},
            "torch_dtype": "float16",
            "vision_config": {"hidden_size": 1024, "image_size": 336, "intermediate_size": 4096,
                "model_type": "clip_vision_model", "num_attention_heads": 16, "num_hidden_layers": 24, "patch_size": 14,
                "projection_dim": 768, "vocab_size": 32000},
            "vision_feature_layer": -2, "vision_feature_select_strategy": "default", "vocab_size": 32064,
        }))
        .unwrap();
        assert_eq!((config.text.context, config.text.vocabulary, config.image_tokens()), (4096, 32_064, 576));
        assert!((config.text.rms_norm_eps - 1e-5).abs() < 1e-12);
    }

    #[test]
    fn scaled_rotary_embeddings_are_read_in_old_and_new_form() {
        let rope =
            |text: Value| parse(&json!({"image_token_index": 5, "text_config": text})).map(|config| config.text.rope);
        let linear = Rope { theta: 500.0, scaling: RopeScaling::Linear { factor: 2.0 } };
        let old = json!({"rope_theta": 500, "rope_scaling": {"type": "linear", "factor": 2.0}});
        assert_eq!(rope(old).unwrap(), linear);
        let new = json!({"rope_parameters": {"rope_type": "linear", "factor": 2, "rope_theta": 500}});
        assert_eq!(rope(new).unwrap(), linear);
        let incomplete = json!({"rope_parameters": {"rope_type": "llama3", "factor": 8}});
        assert!(matches!(rope(incomplete), Err(MllmError::Config { key, .. }) if key.ends_with("low_freq_factor")));
    }
}
