//! A model that sees a picture in one view of its own shape, or in tiles and a thumbnail.

use super::NAME;
use super::chat::{bare, marked};
use super::config::Lfm2VlConfig;
use super::processor::ViewProcessor;
use super::tower::ViewEncoder;
use crate::MllmError;
use crate::checkpoint::{ModelFiles, Weights};
use crate::decoder::{Decoder, LanguageModel, LlamaLayer};
use crate::family::{
    ChatFormat, ImageFeatures, ImageInfo, ImageLayout, ImageSettings, ModelInfo, Tiles,
    VisionLanguageModel,
};
use crate::template_format::{ImageText, TemplateFormat};
use crate::text::ChatTokenizer;
use crate::tiled::TileEncoder;
use image::RgbImage;

/// An LFM2-VL.
#[derive(Debug)]
pub(super) struct Lfm2Vl {
    processor: ViewProcessor,
    encoder: ViewEncoder,
    decoder: Decoder<LlamaLayer>,
    info: ModelInfo,
}

impl Lfm2Vl {
    pub(super) fn take(
        weights: &mut Weights,
        config: &Lfm2VlConfig,
        processor: ViewProcessor,
    ) -> Result<Self, MllmError> {
        let before = weights.elements();
        let encoder = ViewEncoder::take(weights, config)?;
        let decoder = Decoder::take(weights, &config.text, "language_model.")?;
        let image = ImageInfo {
            token: config.image_token,
            side: processor.drawn_side(),
            max_tokens: processor.max_tokens(),
        };
        let info = ModelInfo::new(NAME, &config.text, Some(image), weights, before);
        Ok(Self {
            processor,
            encoder,
            decoder,
            info,
        })
    }
}

impl VisionLanguageModel for Lfm2Vl {
    fn info(&self) -> &ModelInfo {
        &self.info
    }

    fn set_images(&mut self, settings: ImageSettings) -> Result<(), MllmError> {
        self.processor.set_images(settings, &mut self.info)
    }

    fn image_layout(&self, width: u32, height: u32) -> Result<ImageLayout, MllmError> {
        self.processor.layout(width, height)
    }

    fn tower_pixels(&self, width: u32, height: u32) -> Result<usize, MllmError> {
        let tokens = self.image_layout(width, height)?.tokens;
        Ok(tokens.saturating_mul(self.processor.token_side().pow(2)))
    }

    fn preprocess(&self, image: &RgbImage) -> Result<Tiles, MllmError> {
        Ok(Tiles {
            pixels: self.processor.views(image)?,
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
        let write = if self.processor.marks { marked } else { bare };
        let image = ImageText::Tiled {
            write,
            tile: self.processor.tile_tokens(),
        };
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
