//! `config.json` of a `LlavaNextForConditionalGeneration` checkpoint.

use super::grid::{Resolution, TileGrids};
use crate::MllmError;
use crate::checkpoint::{ConfigObject, ModelFiles, TowerType, VisionConfig};
use crate::llava::{FeatureSelect, LlavaConfig};
use crate::vision::check_tiles;
use serde_json::Value;
use std::path::Path;

/// A LLaVA-NeXT model: a LLaVA and the resolutions of its grids.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LlavaNextConfig {
    pub llava: LlavaConfig,
    pub grids: TileGrids,
}

/// The default `image_grid_pinpoints` of `LlavaNextConfig` and `LlavaNextImageProcessor`: height
/// and width, pixels.
const DEFAULT_PINPOINTS: [[u32; 2]; 5] =
    [[336, 672], [672, 336], [672, 672], [1008, 336], [336, 1008]];
/// Maximum number of resolutions: the list comes from a stranger's file.
const MAX_PINPOINTS: usize = 64;
/// Longest side of a resolution, pixels; a longer one means a broken configuration.
const MAX_SIDE: u32 = 1 << 14;

impl LlavaNextConfig {
    pub(crate) fn open(files: &ModelFiles) -> Result<Self, MllmError> {
        Self::from_json(
            &files.path("config.json"),
            &files.required_json("config.json")?,
        )
    }

    /// Reads a configuration; `path` is for messages.
    pub(crate) fn from_json(path: &Path, value: &Value) -> Result<Self, MllmError> {
        let llava = LlavaConfig::from_json(path, value)?;
        let root = ConfigObject::root(path, value)?;
        if llava.feature_select == FeatureSelect::Full {
            return Err(root.error(
                "vision_feature_select_strategy",
                "'full' has class tokens, which have no place in a grid of tiles; 'default' is supported",
            ));
        }
        if llava.tower == TowerType::Siglip {
            let problem =
                "siglip_vision_model has no class token; a grid of tiles needs clip_vision_model";
            return Err(root.error("vision_config.model_type", problem));
        }
        let grids = tile_grids(&root, &llava.vision)?;
        Ok(Self { llava, grids })
    }
}

/// The grids of a configuration whose tower takes one tile.
pub(crate) fn tile_grids(
    root: &ConfigObject<'_>,
    vision: &VisionConfig,
) -> Result<TileGrids, MllmError> {
    let side = vision.image_size as u32;
    let resolutions = pinpoints(root)?;
    for Resolution { height, width } in &resolutions {
        // A stranger's file lists these resolutions; each decides how large a picture becomes.
        check_tiles(*width, *height, side).map_err(|problem| root.error(PINPOINTS, problem))?;
    }
    let patches = (vision.image_size / vision.patch_size) as u32;
    let uncut = |Resolution { height, width }| {
        let problem =
            format!("{width} x {height} pixels cannot be cut into tiles of {side} x {side}");
        root.error(PINPOINTS, problem)
    };
    TileGrids::new(resolutions, side, patches).map_err(uncut)
}

/// The key of the resolutions, in both configurations.
pub(crate) const PINPOINTS: &str = "image_grid_pinpoints";

/// Reads the resolutions, each a list of height and width.
pub(crate) fn pinpoints(object: &ConfigObject<'_>) -> Result<Vec<Resolution>, MllmError> {
    let pairs = object
        .value::<Vec<[u32; 2]>>(PINPOINTS)?
        .unwrap_or_else(|| DEFAULT_PINPOINTS.to_vec());
    if !(1..=MAX_PINPOINTS).contains(&pairs.len())
        || pairs
            .iter()
            .flatten()
            .any(|side| !(1..=MAX_SIDE).contains(side))
    {
        let problem = format!(
            "expected 1 to {MAX_PINPOINTS} pairs of height and width, each from 1 to {MAX_SIDE}"
        );
        return Err(object.error(PINPOINTS, problem));
    }
    Ok(pairs
        .into_iter()
        .map(|[height, width]| Resolution { height, width })
        .collect())
}
