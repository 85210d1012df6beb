//! Qwen3-VL (Bai et al., arXiv:2511.21631): a tower for images of any size, whose early layers add to the first layers of a
//! Qwen 3 decoder (`DeepStack`); image tokens have positions on three axes.

mod config;
mod gguf;
mod merger;
mod names;
mod patches;
mod positions;
mod vision;

#[cfg(test)]
mod reference_tests;

use std::ops::Range;

use image::RgbImage;

use config::Qwen3VlConfig;
pub(crate) use config::{image_token, text_config};
use gguf::Qwen3VlGguf;
pub(crate) use gguf::{IMAGE, QWEN_NAMES, limits};
pub(crate) use merger::PatchMerger;
pub(crate) use names::canonical_name;
pub(crate) use patches::{PatchProcessor, take_patch_embedding};
pub(crate) use positions::positions;
use vision::ImageEncoder;

use super::MllmError;
use super::checkpoint::{ModelFiles, Weights};
use super::decoder::{Decoder, LanguageModel, LlamaLayer};
use super::family::{
    ChatFormat, Family, ImageFeatures, ImageLayout, ImageSettings, ModelInfo, PlacedImage, Positions, Tiles,
    VisionLanguageModel,
};
use super::template_format::{ImageText, TemplateFormat};
use super::text::ChatTokenizer;

const NAME: &str = "qwen3-vl";

/// Side of the image that is drawn for a tower that takes any size, pixels.
pub(crate) const DRAWN_SIDE: usize = 448;

/// Qwen3-VL.
pub(crate) const FAMILY: Family = Family {
    name: NAME,
    config_names: &["qwen3_vl", "Qwen3VLForConditionalGeneration"],
    canonical_name: |stored| Some(canonical_name(stored)),
    gguf: Ok(&Qwen3VlGguf),
    missing_tokenizer: "tokenizer.json",
    decoder_config: |files| Ok(Qwen3VlConfig::open(files)?.text),
    open: |files, weights| Ok(Box::new(Qwen3Vl::open(files, weights)?)),
};

/// A Qwen3-VL.
#[derive(Debug)]
pub(crate) struct Qwen3Vl {
    processor: PatchProcessor,
    encoder: ImageEncoder,
    decoder: Decoder<LlamaLayer>,
    info: ModelInfo,
}

impl Qwen3Vl {
    fn open(files: &ModelFiles, weights: &mut Weights) -> Result<Self, MllmError> {
        let config = Qwen3VlConfig::open(files)?;
        let processor = PatchProcessor::open(files, config.vision.patch_size as u32, config.merge as u32)?;
        Self::take(weights, &config, processor)
    }

    fn take(weights: &mut Weights, config: &Qwen3VlConfig, processor: PatchProcessor) -> Result<Self, MllmError> {
        let before = weights.elements();
        let encoder = ImageEncoder::take(weights, config)?;
        // Without an output layer in the files, the embedding is it, whatever the configuration says.
        let tied = config.text.tie_word_embeddings || weights.lacks("lm_head.weight");
        let decoder = Decoder::take(weights, &config.text, "language_model.", tied)?;
        let info = ModelInfo {
            architecture: NAME,
            image_token: config.image_token,
            image_first: false,
            image_size: DRAWN_SIDE,
            max_image_tokens: processor.max_tokens(),
            vocabulary: config.text.vocabulary,
            positions: config.text.context,
            parameters: (before - weights.elements()) as u64,
            blake3: weights.blake3().to_string(),
        };
        Ok(Self { processor, encoder, decoder, info })
    }
}

impl VisionLanguageModel for Qwen3Vl {
    fn info(&self) -> &ModelInfo {
        &self.info
    }

    fn set_images(&mut self, settings: ImageSettings) -> Result<(), MllmError> {
        self.processor.set_images(settings, &mut self.info)
    }

    fn image_layout(&self, width: u32, height: u32) -> Result<ImageLayout, MllmError> {
        self.processor.layout(width, height)
    }

    fn preprocess(&self, image: &RgbImage) -> Result<Tiles, MllmError> {
        Ok(Tiles { pixels: vec![self.processor.process(image)?], width: image.width(), height: image.height() })
    }

    fn encode(&self, tiles: &Tiles) -> candle_core::Result<ImageFeatures> {
        let Some(pixels) = tiles.pixels.first() else { candle_core::bail!("there is no image") };
        self.encoder.encode(pixels)
    }

    fn chat_format(&self, files: &ModelFiles, tokenizer: &ChatTokenizer) -> Result<Box<dyn ChatFormat>, MllmError> {
        Ok(Box::new(TemplateFormat::open(files, tokenizer, self.info.image_token, ImageText::Repeated)?))
    }

    fn positions(&self, tokens: Range<usize>, image: Option<PlacedImage>) -> Positions {
        positions(tokens, image)
    }

    fn decoder(&self) -> &dyn LanguageModel {
        &self.decoder
    }
}
