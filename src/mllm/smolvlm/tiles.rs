//! `SmolVLMImageProcessor` and `Idefics3ImageProcessor`: the image enlarged and cut into tiles,
//! then the whole of it.

use crate::MllmError;
use crate::checkpoint::{ConfigObject, ModelFiles, Neutral};
use crate::tiled::{Grid, Tiler};
use crate::vision::{Filter, PixelScale, Side, check_tiles, read_processor, resize};
use candle_core::Tensor;
use image::RgbImage;
use serde::Deserialize;

/// Longest side of an image before it is cut, pixels (`MAX_IMAGE_SIZE` in transformers).
const MAX_SIDE: u32 = 4096;

/// Cuts images into tiles of the tower's size.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct TileProcessor {
    /// Longest side before the image is cut, pixels.
    pub(super) longest: u32,
    /// Side of a tile, pixels.
    tile: u32,
    pub(super) splitting: bool,
    filter: Filter,
    pub(super) scale: PixelScale,
}

/// How an image is cut. Sizes are width and height, pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Tiling {
    pub first: (u32, u32),
    pub second: (u32, u32),
    /// 1 by 1 for an image that is not cut.
    pub grid: Grid,
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
        let edge = |side| LongestEdge {
            longest_edge: Side(side),
        };
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
        object.only_neutral(&[("do_resize", Neutral::Flag(true))])?;
        let keys: Keys = object.read()?;
        if let Some(kind) = keys.image_processor_type
            && !["SmolVLM", "Idefics3"]
                .iter()
                .any(|known| kind.starts_with(known))
        {
            let problem = format!(
                "'{kind}' is not supported; SmolVLMImageProcessor and Idefics3ImageProcessor are"
            );
            return Err(object.error("image_processor_type", problem));
        }
        let tile = keys.max_image_size.longest_edge.0;
        if tile != side {
            let problem = format!("tiles of {tile} pixels; the vision tower takes {side}");
            return Err(object.error("max_image_size.longest_edge", problem));
        }
        let longest = keys.size.longest_edge.0;
        if longest > MAX_SIDE {
            return Err(object.error(
                "size.longest_edge",
                format!("at most {MAX_SIDE} pixels are supported"),
            ));
        }
        let most = longest.next_multiple_of(tile);
        check_tiles(most, most, tile)
            .map_err(|problem| object.error("size.longest_edge", problem))?;
        // Published files leave the mean and deviation of all channels at one half.
        let scale = PixelScale::read(&object.clone().with_defaults(serde_json::json!({
            "image_mean": [0.5, 0.5, 0.5], "image_std": [0.5, 0.5, 0.5],
        })))?;
        Ok(Self {
            longest,
            tile,
            splitting: keys.do_image_splitting,
            filter: keys.resample,
            scale,
        })
    }

    /// How an image of this size is cut.
    pub(super) fn tiling(&self, width: u32, height: u32) -> Tiling {
        let first = enlarged(width, height, self.longest);
        let second = if self.splitting {
            whole_tiles(first, self.tile)
        } else {
            (self.tile, self.tile)
        };
        let grid = Grid {
            rows: second.1 / self.tile,
            columns: second.0 / self.tile,
            whole: true,
        };
        Tiling {
            first,
            second,
            grid,
        }
    }
}

impl Tiler for TileProcessor {
    fn grid(&self, width: u32, height: u32) -> Grid {
        self.tiling(width, height).grid
    }

    fn views(&self, image: &RgbImage) -> Result<Vec<Tensor>, MllmError> {
        let Tiling {
            first,
            second,
            grid,
        } = self.tiling(image.width(), image.height());
        let size = |image: &RgbImage, (width, height)| resize(image, width, height, self.filter);
        let second = size(&size(image, first), second);
        let tiles = if grid.views() > 1 {
            grid.cut(&second).collect()
        } else {
            Vec::new()
        };
        let whole = size(&second, (self.tile, self.tile));
        tiles
            .iter()
            .chain([&whole])
            .map(|view| Ok(self.scale.values(view)?))
            .collect()
    }

    fn max_views(&self) -> usize {
        let side = if self.splitting {
            self.longest.div_ceil(self.tile)
        } else {
            1
        };
        Grid {
            rows: side,
            columns: side,
            whole: true,
        }
        .views()
    }

    /// Takes one view of an image in the place of tiles.
    fn set_tiles(&mut self, tiles: usize) -> Result<(), MllmError> {
        if tiles == 1 {
            self.splitting = false;
            return Ok(());
        }
        let problem = format!(
            "image.tiles = {tiles}: this family takes 1, or its own number where none is set"
        );
        Err(MllmError::Image { problem })
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
