//! `LlavaOnevisionImageProcessor`: tiles as LLaVA-NeXT's, or one view.

use super::config::default_pinpoints;
use crate::MllmError;
use crate::checkpoint::{ConfigObject, ModelFiles, Neutral};
use crate::llava_next::{AnyresImageProcessor, PINPOINTS, TileGrids, pinpoints};
use crate::vision::{PixelScale, ProcessorKeys, Sides, check_picture, read_processor, resize};
use candle_core::Tensor;
use image::{RgbImage, imageops};
use serde_json::json;

const KIND: &str = "LlavaOnevisionImageProcessor";

#[derive(Debug, Clone, PartialEq)]
pub(super) struct OnevisionProcessor {
    pub(super) tiles: AnyresImageProcessor,
    /// The color beside an image in one view.
    background: [u8; 3],
}

impl OnevisionProcessor {
    /// Reads the image processor of a model with these grids of tiles of `side` pixels.
    pub(super) fn open(
        files: &ModelFiles,
        grids: &TileGrids,
        side: u32,
    ) -> Result<Self, MllmError> {
        read_processor(files, |_, object| Self::read(object, grids, side))
    }

    pub(super) fn read(
        object: &ConfigObject<'_>,
        grids: &TileGrids,
        side: u32,
    ) -> Result<Self, MllmError> {
        object.only_neutral(&[
            ("do_resize", Neutral::Flag(true)),
            ("do_center_crop", Neutral::Flag(false)),
        ])?;
        let object = object.clone().with_defaults(json!({
            "size": {"height": 384, "width": 384}, PINPOINTS: default_pinpoints(),
        }));
        let keys = ProcessorKeys::read(&object, KIND)?;
        // A size of crops decides the side of the tiles.
        let crop = object.contains("crop_size").then_some(keys.crop_size);
        for (key, size) in [("size", Some(keys.size)), ("crop_size", crop)] {
            let Some((height, width)) = size.map(Sides::height_width) else {
                continue;
            };
            if (height, width) != (side, side) {
                let problem =
                    format!("is {width} x {height} pixels; the vision tower takes {side} x {side}");
                return Err(object.error(key, problem));
            }
        }
        if pinpoints(&object)? != grids.resolutions() {
            return Err(object.error(
                PINPOINTS,
                "these are not the resolutions of the model's config.json",
            ));
        }
        let mean: Option<[f32; 3]> = object.value("image_mean")?;
        let mean = mean.or(PixelScale::CLIP.mean_and_deviation().map(|[mean, _]| mean));
        Ok(Self {
            tiles: AnyresImageProcessor {
                filter: keys.resample,
                scale: PixelScale::read(&object)?,
            },
            background: mean
                .expect("CLIP has a mean and a deviation")
                .map(|channel| (f64::from(channel) * 255.0) as u8),
        })
    }

    /// Pixel values, (3, `side`, `side`), of an image in the middle of a square.
    pub(super) fn one_view(&self, image: &RgbImage, side: u32) -> Result<Tensor, MllmError> {
        let (width, height) = image.dimensions();
        let longest = width.max(height);
        check_picture(longest, longest).map_err(|problem| MllmError::Image { problem })?;
        let mut square = RgbImage::from_pixel(longest, longest, image::Rgb(self.background));
        let [left, top] = [width, height].map(|have| i64::from((longest - have) / 2));
        imageops::replace(&mut square, image, left, top);
        let view = resize(&square, side, side, self.tiles.filter);
        Ok(self.tiles.scale.values(&view)?)
    }
}
