//! Models that see an image in tiles of their tower's size, as `SmolVLM` and `InternVL` do.

use super::MllmError;
use super::checkpoint::{LlamaConfig, ModelFiles, Weights};
use super::decoder::{Decoder, LanguageModel, LlamaLayer};
use super::family::{
    ChatFormat, ImageFeatures, ImageInfo, ImageLayout, ImageSettings, ModelInfo, Tiles,
    VisionLanguageModel,
};
use super::template_format::{ImageText, TemplateFormat};
use super::text::ChatTokenizer;
use super::vision::check_not_empty;
use candle_core::Tensor;
use image::{RgbImage, imageops};
use std::fmt::Debug;

/// How an image is cut: tiles row by row, and perhaps the whole image behind them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Grid {
    pub rows: u32,
    pub columns: u32,
    /// Whether the whole image follows its tiles, if there are several.
    pub whole: bool,
}

impl Grid {
    fn tiles(self) -> usize {
        self.rows as usize * self.columns as usize
    }

    /// Number of tiles and whole views.
    pub(crate) fn views(self) -> usize {
        self.tiles() + usize::from(self.whole && self.tiles() > 1)
    }

    /// The tiles of an image that was resized to this grid, row by row.
    pub(crate) fn cut(self, image: &RgbImage) -> impl Iterator<Item = RgbImage> {
        let (width, height) = (
            image.width() / self.columns.max(1),
            image.height() / self.rows.max(1),
        );
        let places =
            (0..self.rows).flat_map(move |row| (0..self.columns).map(move |column| (column, row)));
        places.map(move |(column, row)| {
            imageops::crop_imm(image, column * width, row * height, width, height).to_image()
        })
    }
}

/// Cuts images into tiles as an image processor does.
pub(crate) trait Tiler: Debug + Send + Sync {
    /// The grid of an image of this width and height, pixels. Neither is 0.
    fn grid(&self, width: u32, height: u32) -> Grid;

    /// Pixel values, (3, side, side) each, of the tiles row by row, then of the whole image.
    fn views(&self, image: &RgbImage) -> Result<Vec<Tensor>, MllmError>;

    /// Most views of an image.
    fn max_views(&self) -> usize;

    /// Bounds the number of tiles.
    fn set_tiles(&mut self, tiles: usize) -> Result<(), MllmError>;
}

/// Vision tower and projector.
pub(crate) trait TileEncoder: Debug + Send + Sync {
    /// Encodes pixel values (3, height, width) to (tokens of a view, decoder width).
    fn encode(&self, pixels: &Tensor) -> candle_core::Result<Tensor>;

    /// Encodes the views of an image to (tokens of all views, decoder width).
    fn encode_views(&self, views: &[Tensor]) -> candle_core::Result<Tensor> {
        let rows = views.iter().map(|pixels| self.encode(pixels));
        Tensor::cat(&rows.collect::<candle_core::Result<Vec<_>>>()?, 0)
    }

    /// The features of an image, whose layout was asked for.
    fn features(
        &self,
        tiles: &Tiles,
        layout: Result<ImageLayout, MllmError>,
    ) -> candle_core::Result<ImageFeatures> {
        let layout = layout.map_err(candle_core::Error::wrap)?;
        Ok(ImageFeatures {
            rows: self.encode_views(&tiles.pixels)?,
            deep: Vec::new(),
            layouts: vec![layout],
        })
    }
}

/// What a family decides beside tiler and encoder.
#[derive(Debug, Clone, Copy)]
pub(crate) struct TiledFamily<'a> {
    /// Its name.
    pub name: &'static str,
    pub text: &'a LlamaConfig,
    /// Token id that stands for a token of the image in the prompt.
    pub image_token: u32,
    /// Side of a tile, pixels.
    pub side: usize,
    /// Tokens of a tile.
    pub tile_tokens: usize,
    /// The text of an image in a chat, made from the placeholder of a token.
    pub image_text: fn(placeholder: &str, layout: ImageLayout) -> String,
}

/// A model that sees an image in tiles.
#[derive(Debug)]
pub(crate) struct TiledModel<T, E> {
    tiler: T,
    pub(crate) encoder: E,
    decoder: Decoder<LlamaLayer>,
    tile_tokens: usize,
    /// Side of a tile, pixels.
    side: usize,
    image_text: fn(placeholder: &str, layout: ImageLayout) -> String,
    info: ModelInfo,
}

impl<T: Tiler, E: TileEncoder> TiledModel<T, E> {
    /// Takes the weights: those of the encoder by `encoder`, then those of the decoder.
    pub(crate) fn take(
        weights: &mut Weights,
        family: TiledFamily<'_>,
        tiler: T,
        encoder: impl FnOnce(&mut Weights) -> Result<E, MllmError>,
    ) -> Result<Self, MllmError> {
        let TiledFamily {
            name,
            text,
            image_token,
            side,
            tile_tokens,
            image_text,
        } = family;
        // Before the takes, which tell the number of parameters by what they add.
        let before = weights.elements();
        let encoder = encoder(weights)?;
        let decoder = Decoder::take(weights, text, "language_model.")?;
        let image = ImageInfo {
            token: image_token,
            side,
            max_tokens: tiler.max_views() * tile_tokens,
        };
        let info = ModelInfo::new(name, text, Some(image), weights, before);
        Ok(Self {
            tiler,
            encoder,
            decoder,
            tile_tokens,
            side,
            image_text,
            info,
        })
    }
}

impl<T: Tiler, E: TileEncoder> VisionLanguageModel for TiledModel<T, E> {
    fn info(&self) -> &ModelInfo {
        &self.info
    }

    fn set_images(&mut self, settings: ImageSettings) -> Result<(), MllmError> {
        if let Some(tiles) = settings.tiles {
            self.tiler.set_tiles(tiles)?;
        }
        self.info.max_image_tokens = self.tiler.max_views() * self.tile_tokens;
        settings.check_size(self.side)
    }

    fn image_layout(&self, width: u32, height: u32) -> Result<ImageLayout, MllmError> {
        if width == 0 || height == 0 {
            return Err(MllmError::Image {
                problem: "it has no pixels".into(),
            });
        }
        let grid = self.tiler.grid(width, height);
        let tokens = grid.views() * self.tile_tokens;
        Ok(ImageLayout {
            tokens,
            rows: grid.rows as usize,
            columns: grid.columns as usize,
        })
    }

    fn preprocess(&self, image: &RgbImage) -> Result<Tiles, MllmError> {
        check_not_empty(image)?;
        Ok(Tiles {
            pixels: self.tiler.views(image)?,
            width: image.width(),
            height: image.height(),
        })
    }

    fn encode(&self, tiles: &Tiles) -> candle_core::Result<ImageFeatures> {
        let layout = self.image_layout(tiles.width, tiles.height);
        self.encoder.features(tiles, layout)
    }

    fn chat_format(
        &self,
        files: &ModelFiles,
        tokenizer: &ChatTokenizer,
    ) -> Result<Box<dyn ChatFormat>, MllmError> {
        let image = ImageText::Written(self.image_text);
        Ok(Box::new(TemplateFormat::open(
            files,
            tokenizer,
            self.info.image_token,
            image,
        )?))
    }

    fn decoder(&self) -> &dyn LanguageModel {
        &self.decoder
    }
}
