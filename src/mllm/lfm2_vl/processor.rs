//! `Lfm2VlImageProcessor`: a picture becomes one view of its own shape, or tiles and a thumbnail.

use crate::MllmError;
use crate::checkpoint::{ConfigObject, ModelFiles, Neutral};
use crate::family::{ImageLayout, ImageSettings, ModelInfo};
use crate::tiled::Grid;
use crate::vision::{Filter, PixelScale, check_not_empty, check_picture, resize};
use candle_core::Tensor;
use image::RgbImage;
use serde::Deserialize;
use serde_json::{Value, json};

/// Most tiles of a configuration: a larger number means a broken one.
const MAX_TILES: u32 = 64;
/// Most tokens of a view of a configuration.
const MAX_TOKENS: u32 = 1 << 14;

/// Makes views of whole tokens.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ViewProcessor {
    /// Side of a patch, pixels.
    patch: u32,
    /// Side of a token, pixels.
    token: u32,
    /// Side of a tile, pixels.
    tile: u32,
    /// Least and most pixels of a picture in one view.
    pixels: [f64; 2],
    /// Times the most pixels that a picture may have without being cut.
    tolerance: f64,
    /// Least and most tiles; none where pictures are not cut.
    tiles: Option<[u32; 2]>,
    thumbnail: bool,
    /// Whether marks stand around an image and before its tiles.
    pub(super) marks: bool,
    filter: Filter,
    scale: PixelScale,
}

/// The keys and defaults of `Lfm2VlImageProcessor`.
#[derive(Deserialize)]
#[serde(default)]
struct Keys {
    image_processor_type: Option<String>,
    tile_size: u32,
    encoder_patch_size: u32,
    downsample_factor: u32,
    min_image_tokens: u32,
    max_image_tokens: u32,
    min_tiles: u32,
    max_tiles: u32,
    max_pixels_tolerance: f64,
    use_thumbnail: bool,
    do_image_splitting: bool,
    use_image_special_tokens: bool,
    resample: Filter,
}

impl Default for Keys {
    fn default() -> Self {
        Self {
            image_processor_type: None,
            tile_size: 512,
            encoder_patch_size: 16,
            downsample_factor: 2,
            min_image_tokens: 64,
            max_image_tokens: 256,
            min_tiles: 2,
            max_tiles: 10,
            max_pixels_tolerance: 2.0,
            use_thumbnail: true,
            do_image_splitting: true,
            use_image_special_tokens: true,
            resample: Filter::Bilinear,
        }
    }
}

/// The processor of the first files, whose own code did the resizing.
const FIRST: &str = "Siglip2ImageProcessor";
/// Keys that the first files have in `config.json`.
const SHARED: [&str; 11] = [
    "tile_size",
    "encoder_patch_size",
    "downsample_factor",
    "min_image_tokens",
    "max_image_tokens",
    "min_tiles",
    "max_tiles",
    "max_pixels_tolerance",
    "use_thumbnail",
    "do_image_splitting",
    "use_image_special_tokens",
];

/// The keys of all files that may have them. A processor's own come first, those of
/// `config.json` last.
fn merged(files: &ModelFiles) -> Result<(String, Value), MllmError> {
    const OWN: &str = "preprocessor_config.json";
    const PROCESSOR: &str = "processor_config.json";
    let (own, processor) = (files.json(OWN)?, files.json(PROCESSOR)?);
    let place = if own.is_some() { OWN } else { PROCESSOR };
    let nested = processor
        .as_ref()
        .and_then(|value| value.get("image_processor"))
        .cloned();
    let config = files.required_json("config.json")?;
    let shared = |value: &Value| {
        let mut kept = value.clone();
        if let Some(keys) = kept.as_object_mut() {
            keys.retain(|key, _| SHARED.contains(&key.as_str()));
        }
        kept
    };
    // The first file that has a key decides.
    let parts = [
        own,
        nested,
        processor.as_ref().map(shared),
        Some(shared(&config)),
    ];
    let mut found = false;
    let mut merged = json!({});
    for (index, part) in parts.into_iter().flatten().enumerate() {
        let part = match part {
            Value::Object(part) => part,
            other => {
                ConfigObject::root(&files.path(place), &other)?;
                return Err(files.missing(place));
            }
        };
        found |= index > 0 || !part.is_empty();
        for (key, value) in part {
            if merged.get(&key).is_none_or(Value::is_null) {
                merged[key] = value;
            }
        }
    }
    if found {
        Ok((place.to_owned(), merged))
    } else {
        Err(files.missing(OWN))
    }
}

impl ViewProcessor {
    /// Reads the processor of a model with patches of `patch` pixels, of which `downsample` by
    /// `downsample` become a token.
    pub(super) fn open(
        files: &ModelFiles,
        patch: usize,
        downsample: usize,
    ) -> Result<Self, MllmError> {
        let (place, keys) = merged(files)?;
        let path = files.path(&place);
        Self::read(
            &ConfigObject::root(&path, &keys)?,
            [patch as u32, downsample as u32],
        )
    }

    pub(super) fn read(
        object: &ConfigObject<'_>,
        [patch, downsample]: [u32; 2],
    ) -> Result<Self, MllmError> {
        let keys: Keys = object.read()?;
        let kind = keys.image_processor_type.as_deref();
        if !kind.is_some_and(|kind| kind.starts_with(FIRST)) {
            object.only_neutral(&[("do_resize", Neutral::Flag(true))])?;
            if let Some(kind) = kind.filter(|kind| !kind.starts_with("Lfm2VlImageProcessor")) {
                let problem = format!("'{kind}' is not supported; Lfm2VlImageProcessor is");
                return Err(object.error("image_processor_type", problem));
            }
        }
        for (key, found, expected) in [
            ("encoder_patch_size", keys.encoder_patch_size, patch),
            ("downsample_factor", keys.downsample_factor, downsample),
        ] {
            if object.contains(key) && found != expected {
                let problem = format!("is {found}; the model has {expected}");
                return Err(object.error(key, problem));
            }
        }
        let token = patch * downsample;
        let (least, most) = (keys.min_image_tokens, keys.max_image_tokens);
        if least == 0 || least > most || most > MAX_TOKENS {
            let problem = format!("{least} to {most} tokens; expected 1 to {MAX_TOKENS}");
            return Err(object.error("max_image_tokens", problem));
        }
        if keys.tile_size == 0 || !keys.tile_size.is_multiple_of(token) {
            let problem = format!(
                "{} is no multiple of the {token} pixels of a token",
                keys.tile_size
            );
            return Err(object.error("tile_size", problem));
        }
        if keys.min_tiles == 0 || keys.min_tiles > keys.max_tiles || keys.max_tiles > MAX_TILES {
            let problem = format!(
                "{} to {} tiles; expected 1 to {MAX_TILES}",
                keys.min_tiles, keys.max_tiles
            );
            return Err(object.error("max_tiles", problem));
        }
        // A line of tiles is the longest picture.
        keys.tile_size
            .checked_mul(keys.max_tiles)
            .ok_or_else(|| "too many pixels".to_owned())
            .and_then(|side| check_picture(keys.tile_size, side))
            .map_err(|problem| object.error("tile_size", problem))?;
        let tolerance = keys.max_pixels_tolerance;
        if !(tolerance.is_finite() && tolerance > 0.0) {
            let problem = format!("expected a positive number, found {tolerance}");
            return Err(object.error("max_pixels_tolerance", problem));
        }
        let area = f64::from(token) * f64::from(token);
        let processor = object.clone().with_defaults(json!({
            "image_mean": [0.5, 0.5, 0.5], "image_std": [0.5, 0.5, 0.5],
        }));
        Ok(Self {
            patch,
            token,
            tile: keys.tile_size,
            pixels: [least, most].map(|tokens| f64::from(tokens) * area),
            tolerance,
            tiles: keys
                .do_image_splitting
                .then_some([keys.min_tiles, keys.max_tiles]),
            thumbnail: keys.use_thumbnail,
            marks: keys.use_image_special_tokens,
            filter: keys.resample,
            scale: PixelScale::read(&processor)?,
        })
    }

    /// Side of a token, pixels.
    pub(super) fn token_side(&self) -> usize {
        self.token as usize
    }

    /// Side of the image that is drawn for the model: that of a tile, pixels.
    pub(super) fn drawn_side(&self) -> usize {
        self.tile as usize
    }

    /// Tokens of a tile.
    pub(super) fn tile_tokens(&self) -> usize {
        let side = (self.tile / self.token) as usize;
        side * side
    }

    /// Most pixels of one view. The sides of a small picture are rounded up, which may exceed the
    /// limit where that is near the least.
    fn most_pixels(&self) -> f64 {
        let [least, most] = self.pixels;
        most.max(2.0 * least)
    }

    /// Tokens of the image that becomes the most.
    pub(super) fn max_tokens(&self) -> usize {
        let one = (self.most_pixels() / f64::from(self.token).powi(2)) as usize;
        let tiles = self
            .tiles
            .map_or(0, |[_, most]| most as usize * self.tile_tokens() + one);
        one.max(tiles)
    }

    /// Changes the side of the drawn image, and the most tiles.
    pub(super) fn set_images(
        &mut self,
        settings: ImageSettings,
        info: &mut ModelInfo,
    ) -> Result<(), MllmError> {
        if let Some(tiles) = settings.tiles {
            let refused = |problem: String| MllmError::Image {
                problem: format!("image.tiles = {tiles}: {problem}"),
            };
            let tiles = u32::try_from(tiles).unwrap_or(u32::MAX);
            if !(1..=MAX_TILES).contains(&tiles) {
                return Err(refused(format!("expected 1 to {MAX_TILES}")));
            }
            check_picture(self.tile, self.tile.saturating_mul(tiles)).map_err(refused)?;
            let least = self.tiles.map_or(2, |[least, _]| least);
            self.tiles = (tiles >= least.max(2)).then_some([least, tiles]);
            info.max_image_tokens = self.max_tokens();
        }
        if let Some(side) = settings.size {
            let layout = self.layout(side, side)?;
            (info.image_size, info.max_image_tokens) = (Some(side as usize), layout.tokens);
        }
        Ok(())
    }

    /// How a picture of this size becomes views.
    pub(super) fn plan(&self, width: u32, height: u32) -> Result<ViewPlan, MllmError> {
        if width == 0 || height == 0 {
            return Err(MllmError::Image {
                problem: "it has no pixels".into(),
            });
        }
        let whole = self.resized(width, height);
        check_picture(whole.0, whole.1).map_err(|problem| MllmError::Image { problem })?;
        let grid = match self.tiles {
            Some(tiles) if self.is_large(width, height) => Some(self.grid(width, height, tiles)),
            _ => None,
        };
        let plan = ViewPlan {
            whole,
            grid: grid.filter(|grid| grid.rows * grid.columns > 1),
            thumbnail: self.thumbnail,
        };
        // A side has one token at least, so that a line may be too long.
        if plan.has_whole() && f64::from(whole.0) * f64::from(whole.1) > self.most_pixels() {
            let problem = format!("{width} x {height} pixels are too narrow for one view");
            return Err(MllmError::Image { problem });
        }
        Ok(plan)
    }

    /// A side in whole tokens, at least `least`; halves are rounded to even.
    fn rounded(&self, side: u32, least: u32) -> f64 {
        let token = f64::from(self.token);
        ((f64::from(side) / token).round_ties_even() * token).max(f64::from(least))
    }

    /// Width and height of a picture in one view (`smart_resize`).
    fn resized(&self, width: u32, height: u32) -> (u32, u32) {
        let token = f64::from(self.token);
        let [least, most] = self.pixels;
        let area = f64::from(width) * f64::from(height);
        let both = |side: &dyn Fn(u32) -> f64| (side(width), side(height));
        let mut sides = both(&|side| self.rounded(side, self.token));
        if sides.0 * sides.1 > most {
            let shrink = (area / most).sqrt();
            sides = both(&|side| ((f64::from(side) / shrink / token).floor() * token).max(token));
        } else if sides.0 * sides.1 < least {
            let grow = (least / area).sqrt();
            sides = both(&|side| (f64::from(side) * grow / token).ceil() * token);
        }
        (sides.0 as u32, sides.1 as u32)
    }

    /// Whether a picture has too many pixels for one view (`_is_image_too_large`).
    fn is_large(&self, width: u32, height: u32) -> bool {
        let side = |side| self.rounded(side, self.patch);
        side(width) * side(height) > self.pixels[1] * self.tolerance
    }

    /// The grid whose shape is nearest to the picture's; of two as near, the larger one where it is
    /// less than twice as large (`find_closest_aspect_ratio`).
    fn grid(&self, width: u32, height: u32, [least, most]: [u32; 2]) -> Grid {
        let ratio = f64::from(width) / f64::from(height);
        let area = f64::from(width) * f64::from(height);
        let tile = f64::from(self.tile) * f64::from(self.tile);
        let mut grids: Vec<(u32, u32)> = (1..=most)
            .flat_map(|columns| (1..=most).map(move |rows| (columns, rows)))
            .filter(|(columns, rows)| (least..=most).contains(&(columns * rows)))
            .collect();
        grids.sort_by_key(|(columns, rows)| columns * rows);
        let (mut nearest, mut found) = (f64::INFINITY, (1, 1));
        for (columns, rows) in grids {
            let apart = (ratio - f64::from(columns) / f64::from(rows)).abs();
            let larger = area > 0.5 * tile * f64::from(columns * rows);
            // The numbers of the rule are compared as they are.
            if apart < nearest || apart.total_cmp(&nearest).is_eq() && larger {
                (nearest, found) = (apart, (columns, rows));
            }
        }
        Grid {
            rows: found.1,
            columns: found.0,
            whole: self.thumbnail,
        }
    }

    /// How an image of this size lies in a chat.
    pub(super) fn layout(&self, width: u32, height: u32) -> Result<ImageLayout, MllmError> {
        let plan = self.plan(width, height)?;
        let tokens = plan.pixels(self.tile) / self.token_side().pow(2);
        let (rows, columns) = plan.grid.map_or((1, 1), |grid| (grid.rows, grid.columns));
        Ok(ImageLayout {
            tokens,
            rows: rows as usize,
            columns: columns as usize,
        })
    }

    /// Pixel values of each view, (3, height, width): tiles row by row, then the thumbnail.
    pub(super) fn views(&self, image: &RgbImage) -> Result<Vec<Tensor>, MllmError> {
        check_not_empty(image)?;
        let plan = self.plan(image.width(), image.height())?;
        let mut views = Vec::new();
        if let Some(grid) = plan.grid {
            let (width, height) = (grid.columns * self.tile, grid.rows * self.tile);
            views.extend(grid.cut(&resize(image, width, height, self.filter)));
        }
        if plan.has_whole() {
            views.push(resize(image, plan.whole.0, plan.whole.1, self.filter));
        }
        views
            .iter()
            .map(|view| Ok(self.scale.values(view)?))
            .collect()
    }
}

/// The views of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct ViewPlan {
    /// Width and height in one view, pixels.
    pub(super) whole: (u32, u32),
    /// The tiles; none for one view.
    pub(super) grid: Option<Grid>,
    thumbnail: bool,
}

impl ViewPlan {
    fn has_whole(&self) -> bool {
        self.grid.is_none() || self.thumbnail
    }

    /// Pixels of all views, with tiles of `tile` pixels a side.
    pub(super) fn pixels(&self, tile: u32) -> usize {
        let area = |width: u32, height: u32| width as usize * height as usize;
        let tiles = self
            .grid
            .map_or(0, |grid| area(grid.columns, grid.rows) * area(tile, tile));
        let whole = if self.has_whole() {
            area(self.whole.0, self.whole.1)
        } else {
            0
        };
        tiles + whole
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    fn read(keys: &Value) -> Result<ViewProcessor, MllmError> {
        let path = Path::new("preprocessor_config.json");
        ViewProcessor::read(&ConfigObject::root(path, keys)?, [16, 2])
    }

    /// Sizes, views and tokens of the fact sheet (`Lfm2VlImageProcessor` of transformers 5.24.0).
    #[test]
    fn pictures_become_the_views_of_the_published_processor() {
        let processor = read(&json!({})).unwrap();
        for (size, whole, grid, tokens) in [
            ((448, 448), (448, 448), None, 196),
            ((512, 512), (512, 512), None, 256),
            ((640, 480), (576, 416), None, 234),
            ((256, 384), (256, 384), None, 96),
            ((100, 100), (256, 256), None, 64),
            ((700, 700), (512, 512), None, 256),
            ((724, 724), (512, 512), Some((2, 2)), 1280),
            ((1024, 1024), (512, 512), Some((2, 2)), 1280),
            ((1280, 720), (672, 384), Some((2, 1)), 764),
            ((1920, 1080), (672, 384), Some((4, 2)), 2300),
        ] {
            let plan = processor.plan(size.0, size.1).unwrap();
            let found = plan.grid.map(|grid| (grid.columns, grid.rows));
            let layout = processor.layout(size.0, size.1).unwrap();
            assert_eq!(
                (plan.whole, found, layout.tokens),
                (whole, grid, tokens),
                "{size:?}"
            );
            assert!(layout.tokens <= processor.max_tokens());
        }
        let first = read(&json!({"use_thumbnail": false, "do_resize": false,
            "image_processor_type": "Siglip2ImageProcessorFast"}));
        assert_eq!(first.unwrap().layout(1024, 1024).unwrap().tokens, 1024);
        let unsplit = read(&json!({"do_image_splitting": false})).unwrap();
        assert_eq!(unsplit.layout(1024, 1024).unwrap().tokens, 256);
    }

    #[test]
    fn what_contradicts_is_named() {
        for (keys, key) in [
            (
                json!({"image_processor_type": "CLIPImageProcessor"}),
                "image_processor_type",
            ),
            (json!({"do_resize": false}), "do_resize"),
            (json!({"encoder_patch_size": 14}), "encoder_patch_size"),
            (json!({"downsample_factor": 3}), "downsample_factor"),
            (json!({"tile_size": 500}), "tile_size"),
            (json!({"tile_size": 0}), "tile_size"),
            (json!({"tile_size": 4_294_967_264_u32}), "tile_size"),
            (json!({"max_tiles": 1}), "max_tiles"),
            (json!({"max_tiles": 1000}), "max_tiles"),
            (json!({"min_image_tokens": 0}), "max_image_tokens"),
            (json!({"max_image_tokens": 4_000_000}), "max_image_tokens"),
            (json!({"max_pixels_tolerance": -1}), "max_pixels_tolerance"),
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

    #[test]
    fn keys_of_the_first_files_stand_in_three_places() {
        let files = |texts: &[(&str, Value)]| {
            let texts = texts
                .iter()
                .map(|(name, value)| ((*name).to_owned(), value.to_string()));
            ModelFiles::packed(Path::new("model"), texts.collect())
        };
        let config = (
            "config.json",
            json!({"use_thumbnail": false, "max_tiles": 4, "hidden_size": 7}),
        );
        let own = (
            "preprocessor_config.json",
            json!({"image_processor_type": FIRST, "do_resize": false}),
        );
        let outer = ("processor_config.json", json!({"max_tiles": 6}));
        let read = |texts: &[(&str, Value)]| ViewProcessor::open(&files(texts), 16, 2);
        let found = read(&[config.clone(), own.clone(), outer]).unwrap();
        assert_eq!((found.thumbnail, found.tiles), (false, Some([2, 6])));
        let nested = (
            "processor_config.json",
            json!({"image_processor": {"max_tiles": 8}}),
        );
        let found = read(&[config.clone(), nested]).unwrap();
        assert_eq!((found.thumbnail, found.tiles), (false, Some([2, 8])));
        assert!(read(&[config, own]).is_ok());
    }
}
