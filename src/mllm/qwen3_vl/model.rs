//! Models whose tower takes images of any size and whose image tokens have positions on three axes,
//! as Qwen's.

use super::patches::PatchProcessor;
use super::positions::positions;
use crate::MllmError;
use crate::checkpoint::{LlamaConfig, ModelFiles, Weights};
use crate::decoder::{Decoder, LanguageModel, LlamaLayer};
use crate::family::{
    ChatFormat, ImageFeatures, ImageInfo, ImageLayout, ImageSettings, ModelInfo, PlacedImage,
    Positions, Tiles, VisionLanguageModel,
};
use crate::template_format::{ImageText, TemplateFormat};
use crate::text::ChatTokenizer;
use candle_core::Tensor;
use image::RgbImage;
use std::fmt::Debug;
use std::ops::Range;

/// Side of the image that is drawn for a tower that takes any size, pixels.
const DRAWN_SIDE: usize = 448;

/// Vision tower and projector.
pub(crate) trait PatchEncoder: Debug + Send + Sync {
    /// Encodes pixel values (3, height, width) of whole tokens.
    fn encode(&self, pixels: &Tensor) -> candle_core::Result<ImageFeatures>;
}

/// A model that takes an image in one piece of any size.
#[derive(Debug)]
pub(crate) struct PatchModel<E> {
    processor: PatchProcessor,
    pub(crate) encoder: E,
    decoder: Decoder<LlamaLayer>,
    info: ModelInfo,
}

impl<E: PatchEncoder> PatchModel<E> {
    /// Takes the weights of the family `name`: those of the encoder by `encoder`, then those of the
    /// decoder.
    pub(crate) fn take(
        weights: &mut Weights,
        name: &'static str,
        text: &LlamaConfig,
        image_token: u32,
        processor: PatchProcessor,
        encoder: impl FnOnce(&mut Weights) -> Result<E, MllmError>,
    ) -> Result<Self, MllmError> {
        let before = weights.elements();
        let encoder = encoder(weights)?;
        let decoder = Decoder::take(weights, text, "language_model.")?;
        let image = ImageInfo {
            token: image_token,
            side: DRAWN_SIDE,
            max_tokens: processor.max_tokens(),
        };
        let info = ModelInfo {
            image_range: Some(processor.range()),
            ..ModelInfo::new(name, text, Some(image), weights, before)
        };
        Ok(Self {
            processor,
            encoder,
            decoder,
            info,
        })
    }
}

impl<E: PatchEncoder> VisionLanguageModel for PatchModel<E> {
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
        let block = self.processor.token_side();
        let tokens = self.image_layout(width, height)?.tokens;
        Ok(tokens.saturating_mul(block).saturating_mul(block))
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
            ImageText::Repeated,
        )?))
    }

    fn positions(&self, tokens: Range<usize>, images: &[PlacedImage]) -> Positions {
        positions(tokens, images)
    }

    fn decoder(&self) -> &dyn LanguageModel {
        &self.decoder
    }
}
