//! `config.json` of a `Qwen3VLForConditionalGeneration` checkpoint.

use crate::MllmError;
use crate::checkpoint::{
    ConfigObject, DecoderType, LlamaConfig, ModelFiles, Neutral, VisionConfig, check_width,
};
use serde_json::{Value, json};
use std::path::Path;

/// A Qwen3-VL: its vision tower, its decoder, and how they are joined.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Qwen3VlConfig {
    /// The tower; its image size is that of the learned positions.
    pub vision: VisionConfig,
    /// Learned positions along a side.
    pub positions: usize,
    /// Side of the blocks of patches that become one token (`spatial_merge_size`).
    pub merge: usize,
    /// Frames that a patch holds (`temporal_patch_size`).
    pub frames: usize,
    /// Layers of the tower, from 0, whose output goes to a layer of the decoder.
    pub deep: Vec<usize>,
    pub text: LlamaConfig,
    /// Token id that stands for a token of the image in the prompt.
    pub image_token: u32,
}

/// The id of an image's token in the tokenizers of Qwen 2 and 3.
const IMAGE_TOKEN: u32 = 151_655;

/// What differs between the families with this tower.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Kind {
    pub decoder: DecoderType,
    /// The id of an image's token in the published tokenizers.
    pub image_token: u32,
    /// Whether layers of the tower go to layers of the decoder (`deepstack_visual_indexes`).
    pub deepstack: bool,
}

/// Qwen3-VL.
pub(super) const QWEN3_VL: Kind = Kind {
    decoder: DecoderType::Qwen3Vl,
    image_token: IMAGE_TOKEN,
    deepstack: true,
};

impl Qwen3VlConfig {
    pub(super) fn open(files: &ModelFiles) -> Result<Self, MllmError> {
        Self::open_as(QWEN3_VL, files)
    }

    /// Reads the configuration of a family with this tower.
    pub(crate) fn open_as(kind: Kind, files: &ModelFiles) -> Result<Self, MllmError> {
        Self::from_json(
            kind,
            &files.path("config.json"),
            &files.required_json("config.json")?,
        )
    }

    /// Reads a configuration; `path` is for messages.
    pub(crate) fn from_json(kind: Kind, path: &Path, value: &Value) -> Result<Self, MllmError> {
        let root = ConfigObject::root(path, value)?;
        // The defaults of `Qwen3VLVisionConfig` and `Qwen3_5VisionConfig`.
        let vision = root.child_or_empty("vision_config")?.with_defaults(json!({
            "depth": 27, "hidden_size": 1152, "intermediate_size": 4304, "num_heads": 16, "patch_size": 16,
            "hidden_act": "gelu_pytorch_tanh", "layer_norm_eps": 1e-6, "spatial_merge_size": 2,
            "temporal_patch_size": 2, "num_position_embeddings": 2304, "deepstack_visual_indexes": [8, 16, 24],
        }));
        let count = |key: &str, most: usize| -> Result<usize, MllmError> {
            let count = vision.value(key)?.unwrap_or(0);
            if (1..=most).contains(&count) {
                return Ok(count);
            }
            Err(vision.error(
                key,
                format!("expected a whole number from 1 to {most}, found {count}"),
            ))
        };
        check_tower_rope(&vision)?;
        let learned = count("num_position_embeddings", 1 << 16)?;
        let positions = learned.isqrt();
        if positions * positions != learned {
            return Err(vision.error(
                "num_position_embeddings",
                format!("{learned} is no square number"),
            ));
        }
        let patch = count("patch_size", 256)?;
        let sized = vision
            .clone()
            .with_defaults(json!({"image_size": positions * patch}));
        let tower = VisionConfig::read(&sized)?;
        if !(tower.hidden / tower.heads).is_multiple_of(4) {
            return Err(vision.error("num_heads", "the width of a head must be a multiple of 4"));
        }
        let deep: Vec<usize> = if kind.deepstack {
            vision.list("deepstack_visual_indexes")?
        } else {
            Vec::new()
        };
        let text = text_config(&root, kind.decoder)?;
        if !deep.is_sorted()
            || deep.last().is_some_and(|last| *last >= tower.layers)
            || deep.len() > text.layers
        {
            let problem = format!(
                "{deep:?} are no rising layers of a tower of {}",
                tower.layers
            );
            return Err(vision.error("deepstack_visual_indexes", problem));
        }
        if vision
            .value("out_hidden_size")?
            .is_some_and(|width: usize| width != text.hidden)
        {
            return Err(vision.error(
                "out_hidden_size",
                format!("the decoder takes {}", text.hidden),
            ));
        }
        let merge = count("spatial_merge_size", 16)?;
        check_width(&vision, "spatial_merge_size", merge * merge, tower.hidden)?;
        Ok(Self {
            positions,
            merge,
            frames: count("temporal_patch_size", 16)?,
            deep,
            image_token: image_token_or(kind.image_token, &root, text.vocabulary)?,
            vision: tower,
            text,
        })
    }
}

/// The decoder of a Qwen-VL, of the class `kind`, from `text_config` or, in older files, the root.
pub(crate) fn text_config(
    root: &ConfigObject<'_>,
    kind: DecoderType,
) -> Result<LlamaConfig, MllmError> {
    let text = root.child("text_config")?.unwrap_or_else(|| root.clone());
    let mut config = LlamaConfig::read_as(text, kind)?;
    config.tie_word_embeddings |= root.value("tie_word_embeddings")?.unwrap_or(false);
    Ok(config)
}

/// Checks that the patches' rotary embedding is the one that is computed (`rope_parameters` of a
/// tower).
pub(crate) fn check_tower_rope(vision: &ConfigObject<'_>) -> Result<(), MllmError> {
    vision.child_or_empty("rope_parameters")?.only_neutral(&[
        ("rope_theta", Neutral::Number(10_000.0)),
        ("rope_type", Neutral::Text(&["axial", "default"])),
        ("partial_rotary_factor", Neutral::Number(1.0)),
    ])
}

/// The id of an image's token.
pub(crate) fn image_token(root: &ConfigObject<'_>, vocabulary: usize) -> Result<u32, MllmError> {
    image_token_or(IMAGE_TOKEN, root, vocabulary)
}

/// The id of an image's token, `default` where a configuration has none.
fn image_token_or(
    default: u32,
    root: &ConfigObject<'_>,
    vocabulary: usize,
) -> Result<u32, MllmError> {
    let id = root.first_id("image_token_id")?.unwrap_or(default);
    if (id as usize) < vocabulary {
        return Ok(id);
    }
    Err(root.error(
        "image_token_id",
        format!("{id} lies outside the vocabulary of {vocabulary}"),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn old_and_new_files_are_read() {
        let text = json!({"hidden_size": 2560, "num_attention_heads": 32, "num_key_value_heads": 8, "head_dim": 128,
            "num_hidden_layers": 36, "intermediate_size": 9728, "vocab_size": 151_936});
        let mut old = json!({"text_config": text, "vision_config": {"depth": 24, "hidden_size": 1024,
            "intermediate_size": 4096, "deepstack_visual_indexes": [5, 11, 17], "out_hidden_size": 2560}});
        let mut new = old.clone();
        old["text_config"]["rope_theta"] = json!(5e6);
        old["text_config"]["rope_scaling"] =
            json!({"rope_type": "default", "mrope_section": [24, 20, 20]});
        new["text_config"]["rope_parameters"] = json!({"rope_type": "default", "rope_theta": 5e6, "mrope_interleaved": true, "mrope_section": [24, 20, 20]});
        let read =
            |config: &Value| Qwen3VlConfig::from_json(QWEN3_VL, Path::new("config.json"), config);
        let config = read(&old).unwrap();
        assert_eq!(config, read(&new).unwrap());
        assert_eq!(
            (config.positions, config.merge, config.text.head_dim),
            (48, 2, 128)
        );
        assert!(config.text.head_norms && !config.text.attention_bias);
        for (key, pointer, value) in [
            (
                "mrope_section",
                "/text_config/rope_scaling/mrope_section",
                json!([24, 20, 10]),
            ),
            (
                "deepstack_visual_indexes",
                "/vision_config/deepstack_visual_indexes",
                json!([5, 40]),
            ),
            (
                "out_hidden_size",
                "/vision_config/out_hidden_size",
                json!(7),
            ),
        ] {
            let mut changed = old.clone();
            *changed.pointer_mut(pointer).unwrap() = value;
            let error = read(&changed).unwrap_err().to_string();
            assert!(error.contains(key), "{error}");
        }
    }
}
