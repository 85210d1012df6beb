//! A Gemma 4 with its tower.

use super::NAME;
use super::chat::image_text;
use super::config::{Gemma4Config, TowerConfig};
use super::processor::PictureProcessor;
use super::tower::ImageEncoder;
use crate::MllmError;
use crate::checkpoint::{ModelFiles, Weights};
use crate::decoder::{Decoder, LanguageModel, LlamaLayer};
use crate::family::{
    ChatFormat, ImageFeatures, ImageInfo, ImageLayout, ImageSettings, ModelInfo, PlacedImage,
    Positions, Tiles, VisionLanguageModel,
};
use crate::template_format::{ImageText, TemplateFormat};
use crate::text::ChatTokenizer;
use image::RgbImage;
use std::ops::Range;

/// A Gemma 4 that sees a picture in one view of its own shape.
#[derive(Debug)]
pub(super) struct Gemma4 {
    pub(super) encoder: ImageEncoder,
    decoder: Decoder<LlamaLayer>,
    processor: PictureProcessor,
    /// Whether the tokens of an image see one another.
    image_at_once: bool,
    info: ModelInfo,
}

impl Gemma4 {
    pub(super) fn take(
        weights: &mut Weights,
        config: &Gemma4Config,
        tower: &TowerConfig,
        processor: PictureProcessor,
    ) -> Result<Self, MllmError> {
        let before = weights.elements();
        let encoder = ImageEncoder::take(weights, config, tower)?;
        let decoder = Decoder::take(weights, &config.text, "language_model.")?;
        let image = ImageInfo {
            token: config.image_token,
            side: processor.drawn_side(),
            max_tokens: processor.max_tokens(),
        };
        let gemma = config.text.gemma.as_ref();
        Ok(Self {
            encoder,
            decoder,
            processor,
            image_at_once: matches!(gemma, Some(gemma) if gemma.sees_image_at_once()),
            info: ModelInfo::new(NAME, &config.text, Some(image), weights, before),
        })
    }
}

impl VisionLanguageModel for Gemma4 {
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
        let pixels = self.processor.process(image)?;
        Ok(Tiles::one_view(image, pixels))
    }

    fn encode(&self, tiles: &Tiles) -> candle_core::Result<ImageFeatures> {
        self.encoder.encode(tiles.view()?)
    }

    fn chat_format(
        &self,
        files: &ModelFiles,
        tokenizer: &ChatTokenizer,
    ) -> Result<Box<dyn ChatFormat>, MllmError> {
        Ok(Box::new(TemplateFormat::open(
            files,
            tokenizer,
            self.info.image_token,
            ImageText::Written(image_text),
        )?))
    }

    fn positions(&self, tokens: Range<usize>, images: &[PlacedImage]) -> Positions {
        Positions::with_images(tokens, images)
    }

    fn image_at_once(&self) -> bool {
        self.image_at_once
    }

    fn decoder(&self) -> &dyn LanguageModel {
        &self.decoder
    }
}
