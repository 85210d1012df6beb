//! `LlavaNextImageProcessor`: the downscaled image, then its tiles at a higher resolution.

use super::config::{PINPOINTS, pinpoints};
use super::grid::{TileGrids, Tiling};
use crate::MllmError;
use crate::checkpoint::{ConfigObject, ModelFiles};
use crate::vision::{Filter, PixelScale, ProcessorKeys, check_not_empty, read_processor, resize};
use candle_core::Tensor;
use image::{RgbImage, imageops};

/// Cuts images into tiles of the vision tower's size.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct AnyresImageProcessor {
    pub filter: Filter,
    pub scale: PixelScale,
}

impl AnyresImageProcessor {
    /// Reads the image processor of a model with these grids of tiles of `side` pixels.
    pub(crate) fn open(
        files: &ModelFiles,
        grids: &TileGrids,
        side: u32,
    ) -> Result<Self, MllmError> {
        read_processor(files, |_, object| Self::read(object, grids, side))
    }

    fn read(object: &ConfigObject<'_>, grids: &TileGrids, side: u32) -> Result<Self, MllmError> {
        let keys = ProcessorKeys::read(object, "LlavaNextImageProcessor")?;
        for (key, size) in [("size", keys.size), ("crop_size", keys.crop_size)] {
            let (height, width) = size.height_width();
            if (height, width) != (side, side) {
                let problem =
                    format!("is {width} x {height} pixels; the vision tower takes {side} x {side}");
                return Err(object.error(key, problem));
            }
        }
        if pinpoints(object)? != grids.resolutions() {
            return Err(object.error(
                PINPOINTS,
                "these are not the resolutions of the model's config.json",
            ));
        }
        Ok(Self {
            filter: keys.resample,
            scale: PixelScale::read(object)?,
        })
    }

    /// Pixel values, (3, `side`, `side`) each: of the whole image, stretched to a square, then of
    /// its tiles.
    pub(crate) fn process(
        &self,
        image: &RgbImage,
        tiling: &Tiling,
        side: u32,
    ) -> Result<Vec<Tensor>, MllmError> {
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
                let tile =
                    imageops::crop_imm(&padded, column * side, row * side, side, side).to_image();
                values.push(self.scale.values(&tile)?);
            }
        }
        Ok(values)
    }
}
