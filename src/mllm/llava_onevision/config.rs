//! `config.json` of a `LlavaOnevisionForConditionalGeneration` checkpoint.

use crate::MllmError;
use crate::checkpoint::{ConfigObject, DecoderType, ModelFiles, TowerType};
use crate::llava::{FeatureSelect, LlavaConfig};
use crate::llava_next::{PINPOINTS, TileGrids, tile_grids};
use serde_json::{Value, json};
use std::path::Path;

/// A LLaVA-OneVision: a LLaVA, the resolutions of its grids, and the bound of its tokens.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct OnevisionConfig {
    pub llava: LlavaConfig,
    pub grids: TileGrids,
    /// Tiles whose patches all become tokens; a larger map is made smaller (the number in
    /// `vision_aspect_ratio`).
    pub max_tiles: usize,
}

/// Tiles along a side in the default resolutions of `LlavaOnevisionConfig`, and their side, pixels.
const DEFAULT_TILES: u32 = 6;
const DEFAULT_SIDE: u32 = 384;
const ASPECT: &str = "vision_aspect_ratio";
/// Most tiles whose patches all become tokens; more mean a broken configuration.
const MAX_TILES: usize = 1 << 10;

/// The default `image_grid_pinpoints` of `LlavaOnevisionConfig` and `LlavaOnevisionImageProcessor`:
/// height and width, pixels.
pub(super) fn default_pinpoints() -> Value {
    let tiles = 1..=DEFAULT_TILES;
    let pairs = tiles.clone().flat_map(|down| {
        tiles
            .clone()
            .map(move |across| [down * DEFAULT_SIDE, across * DEFAULT_SIDE])
    });
    json!(pairs.collect::<Vec<_>>())
}

impl OnevisionConfig {
    pub(crate) fn open(files: &ModelFiles) -> Result<Self, MllmError> {
        Self::from_json(
            &files.path("config.json"),
            &files.required_json("config.json")?,
        )
    }

    /// Reads a configuration; `path` is for messages.
    pub(crate) fn from_json(path: &Path, value: &Value) -> Result<Self, MllmError> {
        let mut value = value.clone();
        // A tower without a class has that of the default one, and that class's defaults.
        if let Some(tower) = value
            .get_mut("vision_config")
            .and_then(Value::as_object_mut)
        {
            let class = tower.entry("model_type").or_insert(Value::Null);
            if class.is_null() {
                *class = json!("siglip_vision_model");
            }
        }
        let root = ConfigObject::root(path, &value)?.with_defaults(json!({
            "image_token_index": 151_646,
            "vision_feature_select_strategy": "full",
            "vision_feature_layer": -1,
            PINPOINTS: default_pinpoints(),
            ASPECT: "anyres_max_9",
            "vision_config": {
                "model_type": "siglip_vision_model", "hidden_size": 1152, "intermediate_size": 4304, "patch_size": 14,
                "image_size": 384, "num_hidden_layers": 26, "num_attention_heads": 16,
            },
        }));
        let llava = LlavaConfig::read(&root, DecoderType::Qwen2)?;
        if llava.feature_select == FeatureSelect::Default {
            return Err(root.error(
                "vision_feature_select_strategy",
                "'default' leaves out a patch, which has a place in the grid; 'full' is supported",
            ));
        }
        if llava.tower == TowerType::Clip {
            let problem = "clip_vision_model has a class token, which has no place in a grid; siglip_vision_model is supported";
            return Err(root.error("vision_config.model_type", problem));
        }
        Ok(Self {
            grids: tile_grids(&root, &llava.vision)?,
            max_tiles: max_tiles(&root)?,
            llava,
        })
    }
}

/// The number behind `anyres_max_`.
fn max_tiles(root: &ConfigObject<'_>) -> Result<usize, MllmError> {
    let text: String = root.value(ASPECT)?.unwrap_or_default();
    let number = text.strip_prefix("anyres_max_").map(str::parse);
    match number {
        Some(Ok(number)) if (1..=MAX_TILES).contains(&number) => Ok(number),
        _ => Err(root.error(
            ASPECT,
            format!("'{text}' is not supported; anyres_max_N with N from 1 to {MAX_TILES} is"),
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::llava_next::Resolution;
    use planagent_kernels::Activation;

    fn parse(value: &Value) -> Result<OnevisionConfig, MllmError> {
        OnevisionConfig::from_json(Path::new("config.json"), value)
    }

    #[test]
    fn an_empty_configuration_is_what_transformers_makes_of_it() {
        let config = parse(&json!({})).unwrap();
        let vision = &config.llava.vision;
        assert_eq!((vision.hidden, vision.layers, vision.heads), (1152, 26, 16));
        assert_eq!(vision.act, Activation::GeluTanh);
        assert_eq!((vision.patches(), config.max_tiles), (729, 9));
        assert_eq!(config.llava.feature_layers, [26]);
        assert!(config.llava.text.attention_bias);
        assert_eq!(config.grids.resolutions().len(), 36);
        assert_eq!(
            config.grids.resolutions()[7],
            Resolution {
                height: 768,
                width: 768
            }
        );
        // A tower that names some keys has the defaults of its class for the others.
        let named = parse(
            &json!({"vision_config": {"hidden_size": 768}, "image_grid_pinpoints": [[224, 224]]}),
        );
        let vision = named.unwrap().llava.vision;
        assert_eq!(
            (vision.hidden, vision.layers, vision.patch_size),
            (768, 12, 16)
        );
    }

    #[test]
    fn what_has_no_place_in_a_grid_is_refused() {
        for (config, named) in [
            (json!({"vision_aspect_ratio": "anyres"}), ASPECT),
            (json!({"vision_aspect_ratio": "anyres_max_0"}), ASPECT),
            (json!({"vision_aspect_ratio": "anyres_max_-1"}), ASPECT),
            (
                json!({"vision_feature_select_strategy": "default"}),
                "vision_feature_select_strategy",
            ),
            (
                json!({"vision_config": {"model_type": "clip_vision_model"}}),
                "vision_config.model_type",
            ),
            (json!({"image_grid_pinpoints": [[384, 500]]}), PINPOINTS),
        ] {
            let error = parse(&config).unwrap_err().to_string();
            assert!(error.contains(named), "{config}: {error}");
        }
    }
}
