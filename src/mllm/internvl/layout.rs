//! The two layouts of an `InternVL`'s configuration: the classes of transformers, and those of the
//! authors' repositories.

use crate::MllmError;
use crate::checkpoint::{ConfigObject, DecoderType, LlamaConfig, Neutral, VisionConfig};
use serde_json::json;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Layout {
    /// `InternVLConfig` and `InternVLVisionConfig` (transformers 5.24.0).
    Hf,
    /// `InternVLChatConfig` and `InternVisionConfig`, whose defaults are a tower of 6 billion
    /// weights.
    Original,
}

/// The authors' key of the decoder.
const ORIGINAL_TEXT: &str = "llm_config";

impl Layout {
    pub(super) fn from_config(root: &ConfigObject<'_>) -> Self {
        if root.contains(ORIGINAL_TEXT) {
            Self::Original
        } else {
            Self::Hf
        }
    }

    /// Keys of the root that no code reads.
    pub(super) fn neutral(self) -> &'static [(&'static str, Neutral)] {
        match self {
            Self::Hf => &[
                ("projector_hidden_act", Neutral::Text(&["gelu"])),
                ("vision_feature_layer", Neutral::Number(-1.0)),
                (
                    "vision_feature_select_strategy",
                    Neutral::Text(&["default"]),
                ),
            ],
            Self::Original => &[
                ("select_layer", Neutral::Number(-1.0)),
                ("pad2square", Neutral::Flag(false)),
                ("use_backbone_lora", Neutral::Number(0.0)),
                ("use_llm_lora", Neutral::Number(0.0)),
            ],
        }
    }

    /// Reads the decoder.
    pub(super) fn text(self, root: &ConfigObject<'_>) -> Result<LlamaConfig, MllmError> {
        if self == Self::Hf {
            return LlamaConfig::read(root.child_or_empty("text_config")?, DecoderType::Qwen2);
        }
        let text = root.child_or_empty(ORIGINAL_TEXT)?;
        if text.contains("model_type") {
            return LlamaConfig::read(text, DecoderType::Qwen2);
        }
        // The authors' class goes by the first of these.
        let names: Vec<String> = text.list("architectures")?;
        match names
            .first()
            .and_then(|name| DecoderType::of_architecture(name))
        {
            Some(kind) => LlamaConfig::read_as(text, kind),
            None => Err(text.error(
                "model_type",
                "is missing, and architectures names no known decoder either",
            )),
        }
    }

    /// Reads the tower.
    pub(super) fn vision(self, root: &ConfigObject<'_>) -> Result<VisionConfig, MllmError> {
        let vision = root.child_or_empty("vision_config")?;
        match self {
            Self::Hf => hf_vision(vision),
            Self::Original => original_vision(root, vision),
        }
    }
}

const LARGE: &str = "the tower of 6 billion weights is not supported; that of 300 million is";
const NO_BIAS: &str = "a tower without biases is not supported; left out, this key is false";

fn hf_vision(vision: ConfigObject<'_>) -> Result<VisionConfig, MllmError> {
    let vision = vision.with_defaults(json!({
        "hidden_size": 1024, "intermediate_size": 4096, "num_hidden_layers": 24, "num_attention_heads": 16,
        "image_size": 448, "patch_size": 14, "hidden_act": "gelu", "layer_norm_eps": 1e-6,
    }));
    if vision.value("use_qk_norm")?.unwrap_or(false) {
        return Err(vision.error("use_qk_norm", LARGE));
    }
    if !vision.value("attention_bias")?.unwrap_or(false) {
        return Err(vision.error("attention_bias", NO_BIAS));
    }
    vision.only_neutral(&[
        ("norm_type", Neutral::Text(&["layer_norm"])),
        // Without it, a norm follows the last layer.
        ("use_mean_pooling", Neutral::Flag(true)),
        ("use_absolute_position_embeddings", Neutral::Flag(true)),
    ])?;
    VisionConfig::read(&vision)
}

fn original_vision(
    root: &ConfigObject<'_>,
    vision: ConfigObject<'_>,
) -> Result<VisionConfig, MllmError> {
    let vision = vision.with_defaults(json!({
        "hidden_size": 3200, "intermediate_size": 12_800, "num_hidden_layers": 48, "num_attention_heads": 25,
        "image_size": 224, "patch_size": 14, "hidden_act": "gelu", "layer_norm_eps": 1e-6, "norm_type": "rms_norm",
    }));
    if vision.value("qk_normalization")?.unwrap_or(true) {
        return Err(vision.error("qk_normalization", LARGE));
    }
    if !vision.value("qkv_bias")?.unwrap_or(false) {
        return Err(vision.error("qkv_bias", NO_BIAS));
    }
    vision.only_neutral(&[("norm_type", Neutral::Text(&["layer_norm"]))])?;
    // The order of the channels of merged patches; the first version is the default of the class.
    let version = root.value("ps_version")?.unwrap_or_else(|| "v1".to_owned());
    if version != "v2" {
        return Err(root.error(
            "ps_version",
            format!("{version} is not supported; v2 is, and v1 is the default"),
        ));
    }
    let config = VisionConfig::read(&vision)?;
    if let Some(side) = root
        .value::<usize>("force_image_size")?
        .filter(|side| *side != config.image_size)
    {
        let problem = format!(
            "{side} is not the tower's image_size of {}; scaled positions are not supported",
            config.image_size
        );
        return Err(root.error("force_image_size", problem));
    }
    Ok(config)
}
