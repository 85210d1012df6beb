//! `LlavaNextImageProcessor`: the downscaled image, then its tiles at a higher resolution.

use candle_core::Tensor;
use image::{RgbImage, imageops};

use super::config::{PINPOINTS, pinpoints};
use super::grid::{TileGrids, Tiling};
use crate::mllm::MllmError;
use crate::mllm::checkpoint::{ModelFiles, Section};
use crate::mllm::vision::{
    DEFAULT_SIDE, Filter, PixelScale, Sides, check_not_empty, check_processor, read_processor, resample_filter, resize,
    sides,
};

/// Cuts images into tiles of the vision tower's size.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct AnyresImageProcessor {
    pub filter: Filter,
    pub scale: PixelScale,
}

impl AnyresImageProcessor {
    /// Reads the image processor of a model with these grids of tiles of `side` pixels.
    ///
    /// # Errors
    /// When it is missing or broken, or its tiles differ from the model's.
    pub(crate) fn open(files: &ModelFiles, grids: &TileGrids, side: u32) -> Result<Self, MllmError> {
        read_processor(files, |_, section| Self::from_section(section, grids, side))
    }

    fn from_section(section: &Section<'_>, grids: &TileGrids, side: u32) -> Result<Self, MllmError> {
        check_processor(section, "LlavaNextImageProcessor")?;
        for key in ["size", "crop_size"] {
            let (height, width) = sides(section, key)?.unwrap_or(Sides::One(DEFAULT_SIDE)).height_width();
            if (height, width) != (side, side) {
                return Err(section.error(
                    key,
                    format!("makes tiles of {width} x {height} pixels, the vision tower takes {side} x {side}"),
                ));
            }
        }
        if pinpoints(&section.config())? != grids.resolutions() {
            return Err(section.error(PINPOINTS, "these are not the resolutions of the model's config.json".into()));
        }
        Ok(Self { filter: resample_filter(section)?, scale: PixelScale::from_section(section)? })
    }

    /// Pixel values, (3, `side`, `side`) each: of the whole image, stretched to a square, then of its tiles.
    pub(crate) fn process(&self, image: &RgbImage, tiling: &Tiling, side: u32) -> Result<Vec<Tensor>, MllmError> {
        check_not_empty(image)?;
        let whole = resize(image, side, side, self.filter);
        let inner = resize(image, tiling.inner.width, tiling.inner.height, self.filter);
        let mut padded = RgbImage::new(tiling.target.width, tiling.target.height);
        let left = (tiling.target.width - tiling.inner.width) / 2;
        let top = (tiling.target.height - tiling.inner.height) / 2;
        imageops::replace(&mut padded, &inner, left.into(), top.into());
        let mut values = vec![self.scale.values(&whole)?];
        for row in 0..tiling.tiles.0 {
            for column in 0..tiling.tiles.1 {
                let tile = imageops::crop_imm(&padded, column * side, row * side, side, side).to_image();
                values.push(self.scale.values(&tile)?);
            }
        }
        Ok(values)
    }
}
