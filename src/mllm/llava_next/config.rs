//! `config.json` of a `LlavaNextForConditionalGeneration` checkpoint.

use std::path::Path;

use serde_json::Value;

use super::grid::{Resolution, TileGrids};
use crate::mllm::MllmError;
use crate::mllm::checkpoint::{ModelFiles, Section};
use crate::mllm::llava::{FeatureSelect, LlavaConfig};

/// A LLaVA-NeXT model: a LLaVA with the resolutions that its images are brought to.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LlavaNextConfig {
    /// What it has in common with a LLaVA.
    pub llava: LlavaConfig,
    /// The resolutions that an image may be brought to.
    pub grids: TileGrids,
}

/// `image_grid_pinpoints` of `LlavaNextConfig` and `LlavaNextImageProcessor` where a configuration has none; height and
/// width, pixels.
const DEFAULT_PINPOINTS: [(u32, u32); 5] = [(336, 672), (672, 336), (672, 672), (1008, 336), (336, 1008)];
/// Most resolutions that a configuration may name.
const MAX_PINPOINTS: usize = 64;
/// Longest side of a resolution, pixels: beyond it a configuration is taken for broken.
const MAX_SIDE: u64 = 1 << 14;

impl LlavaNextConfig {
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
        let llava = LlavaConfig::from_json(path, value)?;
        let root = Section::root(path, value)?;
        if llava.feature_select == FeatureSelect::Full {
            return Err(root.error(
                "vision_feature_select_strategy",
                "\"full\" has class tokens, which have no place in a grid of tiles; \"default\" is supported".into(),
            ));
        }
        let side = llava.vision.image_size as u32;
        let patches = (llava.vision.image_size / llava.vision.patch_size) as u32;
        let grids = TileGrids::new(pinpoints(&root)?, side, patches).map_err(|resolution| {
            root.error(
                PINPOINTS,
                format!(
                    "{} x {} pixels cannot be cut into tiles of {side} x {side}",
                    resolution.width, resolution.height
                ),
            )
        })?;
        Ok(Self { llava, grids })
    }
}

/// The key of the resolutions, in both configurations.
pub(super) const PINPOINTS: &str = "image_grid_pinpoints";

/// Reads the resolutions, each a list of height and width.
///
/// # Errors
/// When they are none.
pub(super) fn pinpoints(section: &Section<'_>) -> Result<Vec<Resolution>, MllmError> {
    let Some(value) = section.get(PINPOINTS) else {
        return Ok(DEFAULT_PINPOINTS.map(|(height, width)| Resolution { height, width }).to_vec());
    };
    let side = |value: &Value| {
        value.as_u64().filter(|side| (1..=MAX_SIDE).contains(side)).and_then(|side| u32::try_from(side).ok())
    };
    let resolution = |value: &Value| match value.as_array()?.as_slice() {
        [height, width] => Some(Resolution { height: side(height)?, width: side(width)? }),
        _ => None,
    };
    value
        .as_array()
        .filter(|list| (1..=MAX_PINPOINTS).contains(&list.len()))
        .and_then(|list| list.iter().map(resolution).collect())
        .ok_or_else(|| {
            section.error(PINPOINTS, format!("expected 1 to {MAX_PINPOINTS} pairs of height and width, found {value}"))
        })
}
