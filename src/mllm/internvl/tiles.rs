//! `GotOcr2ImageProcessor` and `dynamic_preprocess` of the authors: a grid of tiles that is nearest
//! to the image's shape, then the whole image.

use crate::MllmError;
use crate::checkpoint::{ConfigObject, ModelFiles, Neutral};
use crate::tiled::{Grid, Tiler};
use crate::vision::{Filter, PixelScale, Side, Sides, check_picture, read_processor, resize};
use candle_core::Tensor;
use image::RgbImage;
use serde::Deserialize;
use serde_json::json;

/// Maximum number of tiles of a configuration: a larger number means a broken one.
const MAX_TILES: u32 = 64;

/// Cuts images into tiles of the tower's size.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct TileProcessor {
    /// Side of a tile, pixels.
    tile: u32,
    pub(super) min: u32,
    pub(super) max: u32,
    /// Whether the whole image follows its tiles.
    pub(super) whole: bool,
    filter: Filter,
    pub(super) scale: PixelScale,
}

/// The keys of both layouts: of the `-hf` image processor, and of the authors' `config.json`.
#[derive(Deserialize)]
#[serde(default)]
struct Keys {
    image_processor_type: Option<String>,
    #[serde(alias = "min_dynamic_patch")]
    min_patches: u32,
    #[serde(alias = "max_dynamic_patch")]
    max_patches: u32,
    use_thumbnail: bool,
    dynamic_image_size: bool,
    size: Sides,
    resample: Filter,
}

/// The defaults of `GotOcr2ImageProcessor`.
impl Default for Keys {
    fn default() -> Self {
        Self {
            image_processor_type: None,
            min_patches: 1,
            max_patches: 12,
            use_thumbnail: true,
            dynamic_image_size: true,
            size: Sides::One(Side(384)),
            resample: Filter::Bicubic,
        }
    }
}

impl TileProcessor {
    /// Reads the image processor of a model whose tower takes squares of `side` pixels. In the
    /// authors' layout, `config.json` says how images are cut. In that of transformers,
    /// `crop_to_patches` means nothing: the processor sets it.
    pub(super) fn open(files: &ModelFiles, side: u32) -> Result<Self, MllmError> {
        let config = files.required_json("config.json")?;
        let path = files.path("config.json");
        let config = ConfigObject::root(&path, &config)?;
        if config.contains("llm_config") {
            let scale = match read_processor(files, |_, object| authors_scale(object)) {
                Err(MllmError::MissingFile { .. }) => {
                    authors_scale(&ConfigObject::root(&path, &json!({}))?)?
                }
                scale => scale?,
            };
            // The defaults of `InternVLChatConfig`; its tiles have the tower's size.
            let config = config.with_defaults(json!({
                "dynamic_image_size": false, "use_thumbnail": false, "max_dynamic_patch": 6, "size": side,
            }));
            return Self::read(&config, side, scale);
        }
        read_processor(files, |_, object| {
            object.only_neutral(&[("do_resize", Neutral::Flag(true))])?;
            Self::read(object, side, PixelScale::read(object)?)
        })
    }

    fn read(object: &ConfigObject<'_>, tile: u32, scale: PixelScale) -> Result<Self, MllmError> {
        let keys: Keys = object.read()?;
        if let Some(kind) = keys
            .image_processor_type
            .filter(|kind| !kind.starts_with("GotOcr2ImageProcessor"))
        {
            let problem = format!("'{kind}' is not supported; GotOcr2ImageProcessor is");
            return Err(object.error("image_processor_type", problem));
        }
        let (height, width) = keys.size.height_width();
        if (height, width) != (tile, tile) {
            let problem = format!(
                "tiles of {width} x {height} pixels; the vision tower takes {tile} x {tile}"
            );
            return Err(object.error("size", problem));
        }
        let (min, max) = if keys.dynamic_image_size {
            (keys.min_patches, keys.max_patches)
        } else {
            (1, 1)
        };
        if min == 0 || min > max || max > MAX_TILES {
            let key = if object.contains("max_dynamic_patch") {
                "max_dynamic_patch"
            } else {
                "max_patches"
            };
            return Err(object.error(
                key,
                format!("{min} to {max} tiles; expected 1 to {MAX_TILES}"),
            ));
        }
        // The largest grid is a row of all tiles.
        check_picture(tile, tile * max).map_err(|problem| object.error("max_patches", problem))?;
        Ok(Self {
            tile,
            min,
            max,
            whole: keys.use_thumbnail,
            filter: keys.resample,
            scale,
        })
    }

    #[cfg(test)]
    pub(super) fn new(tile: u32, min: u32, max: u32) -> Self {
        let object = json!({"min_patches": min, "max_patches": max, "size": tile});
        let object = ConfigObject::root("preprocessor_config.json".as_ref(), &object).unwrap();
        Self::read(&object, tile, authors_scale(&object).unwrap()).unwrap()
    }
}

impl Tiler for TileProcessor {
    fn set_tiles(&mut self, tiles: usize) -> Result<(), MllmError> {
        match u32::try_from(tiles) {
            Ok(tiles @ 1..=MAX_TILES) => {
                check_picture(self.tile, self.tile * tiles).map_err(|problem| {
                    MllmError::Image {
                        problem: format!("image.tiles = {tiles}: {problem}"),
                    }
                })?;
                (self.min, self.max) = (self.min.min(tiles), tiles);
                Ok(())
            }
            _ => Err(MllmError::Image {
                problem: format!("image.tiles = {tiles}: expected 1 to {MAX_TILES}"),
            }),
        }
    }

    fn max_views(&self) -> usize {
        Grid {
            rows: self.max,
            columns: 1,
            whole: self.whole,
        }
        .views()
    }

    /// The grid that is nearest to the image's shape (`get_optimal_tiled_canvas` in transformers).
    fn grid(&self, width: u32, height: u32) -> Grid {
        let all =
            (1..=self.max).flat_map(|columns| (1..=self.max).map(move |rows| (columns, rows)));
        let mut grids: Vec<(u32, u32)> = all
            .filter(|(columns, rows)| (self.min..=self.max).contains(&(columns * rows)))
            .collect();
        // Stable: of grids with equally many tiles, those with fewer columns come first.
        grids.sort_by_key(|(columns, rows)| columns * rows);
        let ratio = f64::from(width) / f64::from(height);
        let area = f64::from(width) * f64::from(height);
        let (mut best, mut least) = ((1, 1), f64::INFINITY);
        for (columns, rows) in grids {
            let apart = (ratio - f64::from(columns) / f64::from(rows)).abs();
            let large = area > 0.5 * f64::from(self.tile).powi(2) * f64::from(columns * rows);
            if apart < least || apart <= least && large {
                (best, least) = ((columns, rows), apart);
            }
        }
        Grid {
            columns: best.0,
            rows: best.1,
            whole: self.whole,
        }
    }

    fn views(&self, image: &RgbImage) -> Result<Vec<Tensor>, MllmError> {
        let grid = self.grid(image.width(), image.height());
        let side = self.tile;
        let stretched = resize(image, side * grid.columns, side * grid.rows, self.filter);
        let mut views: Vec<RgbImage> = grid.cut(&stretched).collect();
        if views.len() < grid.views() {
            views.push(resize(image, side, side, self.filter));
        }
        views
            .iter()
            .map(|view| Ok(self.scale.values(view)?))
            .collect()
    }
}

/// Mean and deviation of the pixels in the authors' layout: by default those of `ImageNet`, which
/// stand in their code.
fn authors_scale(object: &ConfigObject<'_>) -> Result<PixelScale, MllmError> {
    PixelScale::read(&object.clone().with_defaults(json!({
        "image_mean": [0.485, 0.456, 0.406], "image_std": [0.229, 0.224, 0.225],
    })))
}
