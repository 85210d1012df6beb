//! `SmolVLMImageProcessor` and `Idefics3ImageProcessor`: the image enlarged and cut into tiles, then the whole of it.

use candle_core::Tensor;
use image::{RgbImage, imageops};
use serde::Deserialize;

use crate::mllm::MllmError;
use crate::mllm::checkpoint::{ConfigObject, ModelFiles};
use crate::mllm::vision::{Filter, PixelScale, Side, check_not_empty, read_processor, resize};

/// Longest side of an image before it is cut, pixels (`MAX_IMAGE_SIZE` in transformers).
const MAX_SIDE: u32 = 4096;

/// Cuts images into tiles of the tower's size.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct TileProcessor {
    /// Longest side before the image is cut, pixels.
    longest: u32,
    /// Side of a tile, pixels.
    tile: u32,
    splitting: bool,
    filter: Filter,
    scale: PixelScale,
}

/// How an image is cut. Sizes are width and height, pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Tiling {
    pub first: (u32, u32),
    pub second: (u32, u32),
    /// 1 by 1 for an image that is not cut.
    pub rows: u32,
    pub columns: u32,
}

impl Tiling {
    /// Number of tiles and whole views.
    pub(super) fn views(&self) -> usize {
        let tiles = (self.rows * self.columns) as usize;
        if tiles > 1 { tiles + 1 } else { 1 }
    }
}

#[derive(Deserialize)]
struct LongestEdge {
    longest_edge: Side,
}

#[derive(Deserialize)]
#[serde(default)]
struct Keys {
    image_processor_type: Option<String>,
    size: LongestEdge,
    max_image_size: LongestEdge,
    do_image_splitting: bool,
    resample: Filter,
}

/// The defaults of `SmolVLMImageProcessor`.
impl Default for Keys {
    fn default() -> Self {
        let edge = |side| LongestEdge { longest_edge: Side(side) };
        Self {
            image_processor_type: None,
            size: edge(4 * 364),
            max_image_size: edge(364),
            do_image_splitting: true,
            resample: Filter::Lanczos,
        }
    }
}

impl TileProcessor {
    /// Reads the image processor of a model whose tower takes squares of `side` pixels.
    pub(super) fn open(files: &ModelFiles, side: u32) -> Result<Self, MllmError> {
        read_processor(files, |_, object| Self::read(object, side))
    }

    pub(super) fn read(object: &ConfigObject<'_>, side: u32) -> Result<Self, MllmError> {
        let keys: Keys = object.read()?;
        if let Some(kind) = keys.image_processor_type
            && !["SmolVLM", "Idefics3"].iter().any(|known| kind.starts_with(known))
        {
            let problem = format!("'{kind}' is not supported; SmolVLMImageProcessor and Idefics3ImageProcessor are");
            return Err(object.error("image_processor_type", problem));
        }
        let tile = keys.max_image_size.longest_edge.0;
        if tile != side {
            let problem = format!("tiles of {tile} pixels; the vision tower takes {side}");
            return Err(object.error("max_image_size.longest_edge", problem));
        }
        let longest = keys.size.longest_edge.0;
        if longest > MAX_SIDE {
            return Err(object.error("size.longest_edge", format!("at most {MAX_SIDE} pixels are supported")));
        }
        // Published files leave the mean and deviation of all channels at one half.
        let scale = PixelScale::read(&object.clone().with_defaults(serde_json::json!({
            "image_mean": [0.5, 0.5, 0.5], "image_std": [0.5, 0.5, 0.5],
        })))?;
        Ok(Self { longest, tile, splitting: keys.do_image_splitting, filter: keys.resample, scale })
    }

    /// Takes one view of an image in the place of tiles.
    pub(super) fn set_tiles(&mut self, tiles: Option<usize>) -> Result<(), MllmError> {
        match tiles {
            None => Ok(()),
            Some(1) => {
                self.splitting = false;
                Ok(())
            }
            Some(tiles) => Err(MllmError::Image {
                problem: format!("image.tiles = {tiles}: this family takes 1, or its own number where none is set"),
            }),
        }
    }

    /// Most views of an image.
    pub(super) fn max_views(&self) -> usize {
        let side = self.longest.div_ceil(self.tile) as usize;
        if self.splitting && side > 1 { side * side + 1 } else { 1 }
    }

    /// How an image of this size is cut.
    pub(super) fn tiling(&self, width: u32, height: u32) -> Result<Tiling, MllmError> {
        if width == 0 || height == 0 {
            return Err(MllmError::Image { problem: "the image has no pixels".into() });
        }
        let first = enlarged(width, height, self.longest);
        if !self.splitting {
            return Ok(Tiling { first, second: (self.tile, self.tile), rows: 1, columns: 1 });
        }
        let second = whole_tiles(first, self.tile);
        Ok(Tiling { first, second, rows: second.1 / self.tile, columns: second.0 / self.tile })
    }

    /// Pixel values, (3, side, side) each: of the tiles row by row, then of the whole image.
    pub(super) fn process(&self, image: &RgbImage) -> Result<Vec<Tensor>, MllmError> {
        check_not_empty(image)?;
        let tiling = self.tiling(image.width(), image.height())?;
        let side = self.tile;
        let size = |image: &RgbImage, (width, height)| resize(image, width, height, self.filter);
        let second = size(&size(image, tiling.first), tiling.second);
        let mut values = Vec::with_capacity(tiling.views());
        if tiling.views() > 1 {
            for row in 0..tiling.rows {
                for column in 0..tiling.columns {
                    let tile = imageops::crop_imm(&second, column * side, row * side, side, side).to_image();
                    values.push(self.scale.values(&tile)?);
                }
            }
        }
        values.push(self.scale.values(&size(&second, (side, side)))?);
        Ok(values)
    }
}

/// The size whose longer side is `longest` (`get_resize_output_image_size` in transformers).
fn enlarged(width: u32, height: u32, longest: u32) -> (u32, u32) {
    let ratio = f64::from(width) / f64::from(height);
    let shorter = |length: f64| (length as u32).next_multiple_of(2).max(1);
    if width >= height {
        (longest, shorter(f64::from(longest) / ratio))
    } else {
        (shorter(f64::from(longest) * ratio), longest)
    }
}

/// The size in whole tiles (`resize_for_vision_encoder` in transformers).
fn whole_tiles((width, height): (u32, u32), tile: u32) -> (u32, u32) {
    let ratio = f64::from(width) / f64::from(height);
    let whole = |length: u32| length.next_multiple_of(tile);
    if width >= height {
        let width = whole(width);
        (width, whole((f64::from(width) / ratio) as u32))
    } else {
        let height = whole(height);
        (whole((f64::from(height) * ratio) as u32), height)
    }
}
