//! A Gemma 3 with its tower.

use super::NAME;
use super::chat::{BEGIN, image_text};
use super::config::Gemma3Config;
use super::vision::ImageEncoder;
use crate::MllmError;
use crate::checkpoint::{ModelFiles, Weights};
use crate::decoder::{Decoder, LanguageModel, LlamaLayer};
use crate::family::{
    ChatFormat, ImageFeatures, ImageInfo, ImageLayout, ModelInfo, PlacedImage, Positions, Tiles,
    VisionLanguageModel,
};
use crate::template_format::TemplateFormat;
use crate::text::ChatTokenizer;
use crate::vision::ClipImageProcessor;
use image::RgbImage;
use std::ops::Range;

/// A Gemma 3 that sees an image in one view.
#[derive(Debug)]
pub(crate) struct Gemma3 {
    pub(super) encoder: ImageEncoder,
    decoder: Decoder<LlamaLayer>,
    processor: ClipImageProcessor,
    /// Side of the view, pixels.
    side: usize,
    info: ModelInfo,
}

impl Gemma3 {
    pub(super) fn take(
        weights: &mut Weights,
        config: &Gemma3Config,
        processor: ClipImageProcessor,
    ) -> Result<Self, MllmError> {
        let before = weights.elements();
        let encoder = ImageEncoder::take(weights, config)?;
        let decoder = Decoder::take(weights, &config.text, "language_model.")?;
        let side = config.vision.image_size;
        let image = ImageInfo {
            token: config.image_token,
            side,
            max_tokens: config.tokens(),
        };
        Ok(Self {
            encoder,
            decoder,
            processor,
            side,
            info: ModelInfo::new(NAME, &config.text, Some(image), weights, before),
        })
    }
}

impl VisionLanguageModel for Gemma3 {
    fn info(&self) -> &ModelInfo {
        &self.info
    }

    fn image_layout(&self, _width: u32, _height: u32) -> Result<ImageLayout, MllmError> {
        Ok(ImageLayout::whole(self.info.max_image_tokens))
    }

    fn preprocess(&self, image: &RgbImage) -> Result<Tiles, MllmError> {
        let pixels = self.processor.process(image, self.side)?;
        Ok(Tiles::one_view(image, pixels))
    }

    fn encode(&self, tiles: &Tiles) -> candle_core::Result<ImageFeatures> {
        ImageFeatures::whole(self.encoder.encode(tiles.view()?)?)
    }

    fn chat_format(
        &self,
        files: &ModelFiles,
        tokenizer: &ChatTokenizer,
    ) -> Result<Box<dyn ChatFormat>, MllmError> {
        Ok(Box::new(TemplateFormat::open_marked(
            files,
            tokenizer,
            self.info.image_token,
            BEGIN,
            image_text,
        )?))
    }

    fn positions(&self, tokens: Range<usize>, images: &[PlacedImage]) -> Positions {
        Positions::with_images(tokens, images)
    }

    fn image_at_once(&self) -> bool {
        true
    }

    fn decoder(&self) -> &dyn LanguageModel {
        &self.decoder
    }
}
