//! `Gemma4ImageProcessor`: a picture is resized to whole tokens, as many as a number of tokens holds.

use super::config::TowerConfig;
use crate::MllmError;
use crate::checkpoint::{ConfigObject, ModelFiles, Neutral};
use crate::family::{ImageLayout, ImageSettings, ModelInfo};
use crate::vision::{Filter, PixelScale, check_not_empty, check_picture, read_processor, resize};
use candle_core::Tensor;
use image::RgbImage;
use serde::Deserialize;
use serde_json::json;

/// Numbers of tokens that published models are made for (`_SUPPORTED_SOFT_TOKENS`).
const BUDGETS: [u32; 5] = [70, 140, 280, 560, 1120];
/// Most tokens of a configuration.
const MAX_TOKENS: u32 = 1 << 14;

/// Resizes pictures to whole tokens.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct PictureProcessor {
    /// Side of a token, pixels.
    token: u32,
    /// Most tokens of a picture, which any picture nearly becomes.
    tokens: u32,
    /// Tokens along a side that the tower has positions for.
    side: u32,
    filter: Filter,
    scale: PixelScale,
}

/// The keys and defaults of `Gemma4ImageProcessor`.
#[derive(Deserialize)]
#[serde(default)]
struct Keys {
    image_processor_type: Option<String>,
    patch_size: Option<usize>,
    pooling_kernel_size: Option<usize>,
    max_soft_tokens: u32,
    resample: Filter,
}

impl Default for Keys {
    fn default() -> Self {
        Self {
            image_processor_type: None,
            patch_size: None,
            pooling_kernel_size: None,
            max_soft_tokens: 280,
            resample: Filter::Bicubic,
        }
    }
}

impl PictureProcessor {
    pub(super) fn open(files: &ModelFiles, tower: &TowerConfig) -> Result<Self, MllmError> {
        read_processor(files, |_, object| Self::read(object, tower))
    }

    pub(super) fn read(object: &ConfigObject<'_>, tower: &TowerConfig) -> Result<Self, MllmError> {
        object.only_neutral(&[("do_resize", Neutral::Flag(true))])?;
        let keys: Keys = object.read()?;
        if let Some(kind) = keys
            .image_processor_type
            .filter(|kind| !kind.starts_with("Gemma4ImageProcessor"))
        {
            let problem = format!("'{kind}' is not supported; Gemma4ImageProcessor is");
            return Err(object.error("image_processor_type", problem));
        }
        // Left out, they have the class's default, which need not be the tower's.
        for (key, found, expected) in [
            ("patch_size", keys.patch_size.unwrap_or(16), tower.patch),
            (
                "pooling_kernel_size",
                keys.pooling_kernel_size.unwrap_or(3),
                tower.pool,
            ),
        ] {
            if found != expected {
                let problem = format!("is {found}; the vision tower has {expected}");
                return Err(object.error(key, problem));
            }
        }
        let defaults = json!({
            "do_normalize": false, "image_mean": [0.0, 0.0, 0.0], "image_std": [1.0, 1.0, 1.0],
        });
        let processor = Self {
            token: tower.token() as u32,
            tokens: keys.max_soft_tokens,
            side: (tower.positions / tower.pool) as u32,
            filter: keys.resample,
            scale: PixelScale::read(&object.clone().with_defaults(defaults))?,
        };
        processor
            .checked(keys.max_soft_tokens)
            .map_err(|problem| object.error("max_soft_tokens", problem))
    }

    /// The same with another number of tokens.
    fn checked(self, tokens: u32) -> Result<Self, String> {
        if !(1..=MAX_TOKENS).contains(&tokens) {
            return Err(format!("expected 1 to {MAX_TOKENS} tokens, found {tokens}"));
        }
        // The longest picture is one row of tokens.
        let length = self
            .token
            .checked_mul(tokens)
            .ok_or_else(|| format!("{tokens} tokens of {} pixels a side", self.token))?;
        check_picture(length, self.token)?;
        Ok(Self { tokens, ..self })
    }

    /// Side of a token, pixels.
    pub(super) fn token_side(&self) -> usize {
        self.token as usize
    }

    pub(super) fn max_tokens(&self) -> usize {
        self.tokens as usize
    }

    /// Side of the largest square that is not resized, pixels.
    pub(super) fn drawn_side(&self) -> usize {
        (self.tokens.isqrt() * self.token) as usize
    }

    /// Takes the side of the drawn image, and the least number of tokens that models are made for
    /// and that holds it. Images of this family have no tiles.
    pub(super) fn set_images(
        &mut self,
        settings: ImageSettings,
        info: &mut ModelInfo,
    ) -> Result<(), MllmError> {
        let refused = |problem: String| MllmError::Image { problem };
        if let Some(tiles) = settings.tiles {
            let problem = format!(
                "image.tiles = {tiles}: this family takes an image in one piece; set image.size"
            );
            return Err(refused(problem));
        }
        let Some(size) = settings.size else {
            return Ok(());
        };
        let mut budgets = vec![self.tokens];
        budgets.extend(BUDGETS);
        budgets.sort_unstable();
        let holds = |budget: &u32| size > 0 && size <= budget.isqrt() * self.token;
        let Some(budget) = budgets.iter().copied().find(holds) else {
            let most = budgets.last().map_or(0, |last| last.isqrt() * self.token);
            let problem = format!("image.size = {size}: expected 1 to {most} pixels");
            return Err(refused(problem));
        };
        *self = self.clone().checked(budget).map_err(refused)?;
        info.image_size = Some(size as usize);
        info.max_image_tokens = self.max_tokens();
        Ok(())
    }

    /// Width and height of the resized picture (`get_aspect_ratio_preserving_size` in
    /// transformers).
    pub(super) fn resized(&self, width: u32, height: u32) -> Result<(u32, u32), MllmError> {
        let refused = |problem: String| MllmError::Image { problem };
        if width == 0 || height == 0 {
            return Err(refused("the image has no pixels".into()));
        }
        let token = f64::from(self.token);
        let most = f64::from(self.tokens) * token * token;
        let factor = (most / (f64::from(width) * f64::from(height))).sqrt();
        // In tokens.
        let fitted = |side: u32| (factor * f64::from(side) / token).floor() as u32;
        let (columns, rows) = match (fitted(width), fitted(height)) {
            (0, 0) => {
                let problem = format!("{width} x {height} pixels become no token");
                return Err(refused(problem));
            }
            (_, 0) => ((width / height).min(self.tokens), 1),
            (0, _) => (1, (height / width).min(self.tokens)),
            fitted => fitted,
        };
        if u64::from(columns) * u64::from(rows) > u64::from(self.tokens) {
            let problem = format!(
                "{width} x {height} pixels become {columns} x {rows} tokens; {} are the most",
                self.tokens
            );
            return Err(refused(problem));
        }
        if columns.max(rows) > self.side {
            let problem = format!(
                "{width} x {height} pixels become {columns} x {rows} tokens; the vision tower has positions of {} along a \
                 side",
                self.side
            );
            return Err(refused(problem));
        }
        Ok((columns * self.token, rows * self.token))
    }

    /// How an image of this size lies in a chat.
    pub(super) fn layout(&self, width: u32, height: u32) -> Result<ImageLayout, MllmError> {
        let (width, height) = self.resized(width, height)?;
        let [rows, columns] = [height, width].map(|side| (side / self.token) as usize);
        Ok(ImageLayout {
            tokens: rows * columns,
            rows,
            columns,
        })
    }

    /// Pixel values, (3, height, width), of whole tokens.
    pub(super) fn process(&self, image: &RgbImage) -> Result<Tensor, MllmError> {
        check_not_empty(image)?;
        let (width, height) = self.resized(image.width(), image.height())?;
        Ok(self
            .scale
            .values(&resize(image, width, height, self.filter))?)
    }
}

#[cfg(test)]
mod tests {
    use super::super::config::Gemma4Config;
    use super::*;
    use serde_json::Value;
    use std::path::Path;

    fn read(keys: &Value) -> Result<PictureProcessor, MllmError> {
        let config = json!({"vision_config": {}});
        let config = Gemma4Config::from_json(Path::new("config.json"), &config).unwrap();
        let path = Path::new("preprocessor_config.json");
        PictureProcessor::read(&ConfigObject::root(path, keys)?, &config.tower.unwrap())
    }

    /// Sizes and tokens of the fact sheet.
    #[test]
    fn pictures_become_the_sizes_of_the_published_processor() {
        for (tokens, size, becomes, expected) in [
            (280, (512, 512), (768, 768), 256),
            (280, (1920, 1080), (1056, 576), 264),
            (280, (768, 768), (768, 768), 256),
            (70, (512, 512), (384, 384), 64),
            (140, (512, 512), (528, 528), 121),
            (560, (512, 512), (1104, 1104), 529),
            (1120, (512, 512), (1584, 1584), 1089),
            // One row of tokens, of whatever length, and no more than there may be.
            (70, (1000, 2), (3360, 48), 70),
            (70, (2, 1000), (48, 3360), 70),
            (70, (600, 10), (3072, 48), 64),
        ] {
            let processor = read(&json!({"max_soft_tokens": tokens})).unwrap();
            assert_eq!(
                processor.resized(size.0, size.1).unwrap(),
                becomes,
                "{size:?}"
            );
            let layout = processor.layout(size.0, size.1).unwrap();
            assert_eq!(layout.tokens, expected, "{size:?}");
            assert!(layout.tokens <= processor.max_tokens());
        }
        assert!(read(&json!({})).unwrap().resized(0, 5).is_err());
        assert_eq!(read(&json!({})).unwrap().drawn_side(), 768);
    }

    #[test]
    fn what_contradicts_is_named() {
        for (keys, key) in [
            (
                json!({"image_processor_type": "CLIPImageProcessor"}),
                "image_processor_type",
            ),
            (json!({"do_resize": false}), "do_resize"),
            (json!({"patch_size": 14}), "patch_size"),
            (json!({"pooling_kernel_size": 2}), "pooling_kernel_size"),
            (json!({"max_soft_tokens": 0}), "max_soft_tokens"),
            (json!({"max_soft_tokens": 1 << 20}), "max_soft_tokens"),
            (json!({"max_soft_tokens": 16_000}), "max_soft_tokens"),
            (json!({"resample": 7}), "resample"),
            (json!({"image_std": [0, 1, 1]}), "image_std"),
        ] {
            let error = read(&keys).unwrap_err().to_string();
            assert!(
                error.starts_with(&format!("preprocessor_config.json: {key}: ")),
                "{error}"
            );
        }
    }
}
