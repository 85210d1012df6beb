//! A Gemma 3n with its vision tower.

use super::NAME;
use super::config::SeenConfig;
use super::cost;
use super::embedder::Embedder;
use super::language::SeeingDecoder;
use super::tower::Tower;
use crate::MllmError;
use crate::checkpoint::{LlamaConfig, ModelFiles, Weights};
use crate::decoder::{Decoder, LanguageModel};
use crate::family::{
    ChatFormat, ImageFeatures, ImageInfo, ImageLayout, ModelInfo, Tiles, TowerCost,
    VisionLanguageModel,
};
use crate::gemma3::image_text;
use crate::template_format::{ImageText, TemplateFormat};
use crate::text::ChatTokenizer;
use crate::vision::ClipImageProcessor;
use image::RgbImage;

/// A Gemma 3n that sees an image in one view.
#[derive(Debug)]
pub(super) struct Gemma3n {
    pub(super) tower: Tower,
    pub(super) decoder: SeeingDecoder,
    processor: ClipImageProcessor,
    /// Side of the view, pixels.
    side: usize,
    cost: TowerCost,
    info: ModelInfo,
}

impl Gemma3n {
    pub(super) fn take(
        weights: &mut Weights,
        text: &LlamaConfig,
        config: &SeenConfig,
        processor: ClipImageProcessor,
    ) -> Result<Self, MllmError> {
        let side = processor.fixed_side()?;
        config
            .tower
            .check_side(side)
            .map_err(|problem| processor.wrong_side(problem))?;
        let before = weights.elements();
        let tower = Tower::take(weights, &config.tower)?;
        let embedder = Embedder::take(weights, config, text.hidden)?;
        let decoder = Decoder::take(weights, text, "language_model.")?;
        let image = ImageInfo {
            token: config.image_token,
            side,
            max_tokens: config.tower.tokens(),
        };
        Ok(Self {
            tower,
            decoder: SeeingDecoder { decoder, embedder },
            processor,
            side,
            cost: cost::of_picture(&config.tower, side),
            info: ModelInfo::new(NAME, text, Some(image), weights, before),
        })
    }
}

impl VisionLanguageModel for Gemma3n {
    fn info(&self) -> &ModelInfo {
        &self.info
    }

    fn image_layout(&self, _width: u32, _height: u32) -> Result<ImageLayout, MllmError> {
        Ok(ImageLayout::whole(self.info.max_image_tokens))
    }

    fn tower_cost(&self, _width: u32, _height: u32) -> Option<TowerCost> {
        Some(self.cost)
    }

    fn preprocess(&self, image: &RgbImage) -> Result<Tiles, MllmError> {
        let pixels = self.processor.process(image, self.side)?;
        Ok(Tiles::one_view(image, pixels))
    }

    fn encode(&self, tiles: &Tiles) -> candle_core::Result<ImageFeatures> {
        let outputs = self.tower.forward(tiles.view()?)?;
        ImageFeatures::whole(self.decoder.embedder.seen(&outputs)?)
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

    fn decoder(&self) -> &dyn LanguageModel {
        &self.decoder
    }
}
