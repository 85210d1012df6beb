//! LLaVA 1.6, LLaVA-NeXT (Liu et al., "LLaVA-NeXT: Improved reasoning, OCR, and world knowledge"): a LLaVA that sees the
//! image small and once more in tiles of a higher resolution.

mod config;
mod connector;
mod grid;
mod preprocess;

#[cfg(test)]
mod reference_tests;

use candle_core::Tensor;
use image::RgbImage;

pub(crate) use config::LlavaNextConfig;
use connector::TilePacker;
use grid::{Resolution, TileGrids, Tiling};
use preprocess::AnyresImageProcessor;

use super::MllmError;
use super::checkpoint::{Checkpoint, ModelFiles, Weights};
use super::decoder::{KvCache, Logits};
use super::llava::{LlavaCore, TemplateFormat};
use super::local::{Architecture, ChatFormat, InputEmbeddings, ModelInfo, VisionLanguageModel};
use super::text::ChatTokenizer;

/// A LLaVA-NeXT model.
#[derive(Debug)]
pub(crate) struct LlavaNext {
    core: LlavaCore,
    packer: TilePacker,
    grids: TileGrids,
    processor: AnyresImageProcessor,
    info: ModelInfo,
}

impl LlavaNext {
    /// Opens the configuration, the preprocessor and the weights of a checkpoint.
    ///
    /// # Errors
    /// When one of them is missing or broken.
    pub(crate) fn open(checkpoint: &mut Checkpoint) -> Result<Self, MllmError> {
        let files = &checkpoint.files;
        let config = LlavaNextConfig::open(files)?;
        let processor = AnyresImageProcessor::open(files, &config.grids, config.llava.vision.image_size as u32)?;
        Self::take(&mut checkpoint.weights, config, processor)
    }

    /// Takes the weights of a configuration.
    ///
    /// # Errors
    /// When a tensor is missing or misshapen.
    fn take(
        weights: &mut Weights,
        config: LlavaNextConfig,
        processor: AnyresImageProcessor,
    ) -> Result<Self, MllmError> {
        let before = weights.elements();
        let core = LlavaCore::take(weights, config.llava)?;
        let packer = TilePacker::take(weights, core.config.text.hidden)?;
        let info = ModelInfo {
            architecture: Architecture::LlavaNext.name(),
            image_token: core.config.image_token,
            image_size: core.config.vision.image_size,
            max_image_tokens: config.grids.max_tokens(),
            vocabulary: core.config.text.vocabulary,
            positions: core.config.text.context,
            parameters: (before - weights.elements()) as u64,
            blake3: weights.blake3().to_string(),
        };
        Ok(Self { core, packer, grids: config.grids, processor, info })
    }

    /// Encodes pixel values (3, side, side) of the whole image and of each tile to (image tokens, decoder width).
    fn encode_tiles(&self, pixels: &[Tensor], tiling: &Tiling) -> candle_core::Result<Tensor> {
        self.packer.pack(&self.core.encoder.encode(pixels)?, &self.grids, tiling)
    }
}

#[cfg(test)]
impl LlavaNext {
    /// A model of this configuration with random weights.
    pub(crate) fn random(config: &serde_json::Value) -> Self {
        use super::vision::{Filter, PixelScale};
        let config = LlavaNextConfig::from_json(std::path::Path::new("config.json"), config).unwrap();
        let processor = AnyresImageProcessor { filter: Filter::Bicubic, scale: PixelScale::CLIP };
        Self::take(&mut Weights::random(7), config, processor).unwrap()
    }
}

impl VisionLanguageModel for LlavaNext {
    fn info(&self) -> &ModelInfo {
        &self.info
    }

    fn context(&self, _image_tokens: usize) -> usize {
        self.info.positions
    }

    fn image_tokens(&self, width: u32, height: u32) -> Result<usize, MllmError> {
        if width == 0 || height == 0 {
            return Err(MllmError::Image { problem: "it has no pixels".into() });
        }
        Ok(self.grids.tokens(&self.grids.tiling(Resolution { height, width })))
    }

    fn encode_image(&self, image: &RgbImage) -> Result<Tensor, MllmError> {
        let tiling = self.grids.tiling(Resolution { height: image.height(), width: image.width() });
        let pixels = self.processor.process(image, &tiling, self.info.image_size as u32)?;
        Ok(self.encode_tiles(&pixels, &tiling)?)
    }

    fn embed(&self, ids: &[u32]) -> candle_core::Result<Tensor> {
        self.core.decoder.embed(ids)
    }

    fn new_cache(&self) -> KvCache {
        self.core.new_cache()
    }

    fn forward(
        &self,
        rows: &InputEmbeddings,
        cache: &mut KvCache,
        wanted: Logits,
    ) -> candle_core::Result<Option<Tensor>> {
        self.core.forward(rows, cache, wanted)
    }

    fn chat_format(&self, files: &ModelFiles, tokenizer: &ChatTokenizer) -> Result<Box<dyn ChatFormat>, MllmError> {
        Ok(Box::new(TemplateFormat::open(files, tokenizer, self.info.image_token)?))
    }
}
