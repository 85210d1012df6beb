//! `config.json` of a `LlavaForConditionalGeneration` checkpoint, and the keys that LLaVA-NeXT's
//! shares with it.
//!
//! Absent keys take the defaults of transformers' `LlavaConfig`, `CLIPVisionConfig`, `LlamaConfig`
//! and `MistralConfig`.

use crate::MllmError;
use crate::checkpoint::{
    ConfigObject, DecoderType, LlamaConfig, ModelFiles, OneOrMany, TowerType, VisionConfig,
    check_width,
};
use planagent_kernels::Activation;
use serde::Deserialize;
use serde_json::Value;
use std::path::Path;

/// A LLaVA model: its vision tower, its decoder, and how they are joined.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LlavaConfig {
    pub vision: VisionConfig,
    pub tower: TowerType,
    pub text: LlamaConfig,
    /// Token id that stands for an image patch in the prompt.
    pub image_token: u32,
    /// Hidden states of the tower that are the image features, as indices into [embeddings, layer
    /// 1, layer 2, ...]; several are concatenated.
    pub feature_layers: Vec<usize>,
    /// Which rows of the hidden states are used.
    pub feature_select: FeatureSelect,
    pub projector_act: Activation,
    /// Whether the projector's layers have biases.
    pub projector_bias: bool,
}

/// Which rows of a hidden state become image tokens (`vision_feature_select_strategy`).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum FeatureSelect {
    /// All but the first row: the patches without the class token.
    Default,
    /// All rows, the class token first where there is one.
    Full,
}

/// The key for models without an image token in the vocabulary, such as those of llama.cpp. Their
/// placeholder is the first id after the vocabulary.
pub(crate) const IMAGE_TOKEN_BEYOND: &str = "image_token_beyond_vocabulary";

impl LlavaConfig {
    pub(crate) fn open(files: &ModelFiles) -> Result<Self, MllmError> {
        Self::from_json(
            &files.path("config.json"),
            &files.required_json("config.json")?,
        )
    }

    /// Reads a configuration; `path` is for messages.
    pub(crate) fn from_json(path: &Path, value: &Value) -> Result<Self, MllmError> {
        Self::read(&ConfigObject::root(path, value)?, DecoderType::Llama)
    }

    /// Reads the keys at the root of a configuration whose decoder is of the class `unnamed` where
    /// it names none.
    pub(crate) fn read(root: &ConfigObject<'_>, unnamed: DecoderType) -> Result<Self, MllmError> {
        let (vision, tower) = VisionConfig::read_tower(root)?;
        let mut text = LlamaConfig::read(root.child_or_empty("text_config")?, unnamed)?;
        text.tie_word_embeddings |= root.value("tie_word_embeddings")?.unwrap_or(false);
        let feature_layers = feature_layers(root, vision.layers)?;
        check_width(root, FEATURE_LAYER, feature_layers.len(), vision.hidden)?;
        Ok(Self {
            image_token: image_token(root, text.vocabulary)?,
            feature_layers,
            feature_select: root
                .value("vision_feature_select_strategy")?
                .unwrap_or(FeatureSelect::Default),
            projector_act: root
                .value("projector_hidden_act")?
                .unwrap_or(Activation::Gelu),
            projector_bias: root.value("multimodal_projector_bias")?.unwrap_or(true),
            vision,
            tower,
            text,
        })
    }

    /// Tokens that one image, or one tile of it, becomes.
    pub(crate) fn image_tokens(&self) -> usize {
        let class_token = usize::from(self.tower == TowerType::Clip);
        let left_out = usize::from(self.feature_select == FeatureSelect::Default);
        self.vision.patches() + class_token - left_out
    }
}

const FEATURE_LAYER: &str = "vision_feature_layer";

/// The id of the image's placeholder.
fn image_token(root: &ConfigObject<'_>, vocabulary: usize) -> Result<u32, MllmError> {
    if root.value(IMAGE_TOKEN_BEYOND)?.unwrap_or(false) {
        return Ok(vocabulary as u32);
    }
    let id = match root.first_id("image_token_id")? {
        Some(id) => id,
        None => root.first_id("image_token_index")?.unwrap_or(32_000),
    };
    if (id as usize) < vocabulary {
        return Ok(id);
    }
    let problem =
        format!("{id} lies outside the vocabulary of {vocabulary} (text_config.vocab_size)");
    Err(root.error("image_token_index", problem))
}

/// The feature layers as indices from 0; negative ones in the file count from the last hidden
/// state.
fn feature_layers(root: &ConfigObject<'_>, layers: usize) -> Result<Vec<usize>, MllmError> {
    let states = layers as i64 + 1;
    let resolve = |index: &i64| {
        let resolved = if *index < 0 {
            index.saturating_add(states)
        } else {
            *index
        };
        (0..states)
            .contains(&resolved)
            .then_some(resolved as usize)
            .ok_or_else(|| {
                root.error(
                    FEATURE_LAYER,
                    format!("{index} is no index into the {states} hidden states of the tower"),
                )
            })
    };
    match root
        .value(FEATURE_LAYER)?
        .unwrap_or(OneOrMany::One(-2))
        .as_slice()
    {
        [] => Err(root.error(FEATURE_LAYER, "expected at least one index")),
        indices => indices.iter().map(resolve).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use planagent_kernels::attention::{Rope, RopeScaling};
    use serde_json::json;

    fn parse(value: &Value) -> Result<LlavaConfig, MllmError> {
        LlavaConfig::from_json(Path::new("config.json"), value)
    }

    #[test]
    fn an_empty_configuration_is_what_transformers_makes_of_it() {
        // LlavaConfig() has no image token below LlamaConfig()'s vocabulary, so one is named here.
        let config = parse(&json!({"image_token_index": 5})).unwrap();
        assert_eq!(
            (
                config.vision.hidden,
                config.vision.layers,
                config.vision.heads
            ),
            (1024, 24, 16)
        );
        assert_eq!((config.vision.patches(), config.image_tokens()), (576, 576));
        assert_eq!(
            (config.text.hidden, config.text.layers, config.text.kv_heads),
            (4096, 32, 32)
        );
        assert_eq!(
            (
                config.text.head_dim,
                config.text.context,
                config.text.vocabulary
            ),
            (128, 2048, 32_000)
        );
        assert_eq!(config.feature_layers, [23]);
        assert_eq!(
            config.text.rope,
            Rope {
                theta: 10_000.0,
                scaling: RopeScaling::None,
                sections: None
            }
        );
        assert!(
            matches!(parse(&json!({})), Err(MllmError::Config { key, .. }) if key == "image_token_index")
        );
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
        assert_eq!(
            (
                config.text.context,
                config.text.vocabulary,
                config.image_tokens()
            ),
            (4096, 32_064, 576)
        );
        assert!((config.text.rms_norm_eps - 1e-5).abs() < 1e-12);
    }

    #[test]
    fn scaled_rotary_embeddings_are_read_in_old_and_new_form() {
        let rope = |text: Value| {
            parse(&json!({"image_token_index": 5, "text_config": text}))
                .map(|config| config.text.rope)
        };
        let linear = Rope {
            theta: 500.0,
            scaling: RopeScaling::Linear { factor: 2.0 },
            sections: None,
        };
        let old = json!({"rope_theta": 500, "rope_scaling": {"type": "linear", "factor": 2.0}});
        assert_eq!(rope(old).unwrap(), linear);
        let new =
            json!({"rope_parameters": {"rope_type": "linear", "factor": 2, "rope_theta": 500}});
        assert_eq!(rope(new).unwrap(), linear);
        let incomplete = json!({"rope_parameters": {"rope_type": "llama3", "factor": 8}});
        assert!(
            matches!(rope(incomplete), Err(MllmError::Config { key, .. }) if key.ends_with("low_freq_factor"))
        );
    }
}
