//! LLaVA 1.5 (Liu et al., "Improved Baselines with Visual Instruction Tuning"): the patches of one image through a CLIP
//! tower and a two-layer projector into a Llama decoder.

mod chat;
mod config;
mod connector;
mod vision;

#[cfg(test)]
mod reference_tests;

use candle_core::Tensor;
use image::RgbImage;

pub(crate) use chat::TemplateFormat;
pub(crate) use config::{FeatureSelect, IMAGE_TOKEN_BEYOND, LlavaConfig};
pub(crate) use vision::ImageEncoder;

use super::MllmError;
use super::checkpoint::{Checkpoint, ModelFiles, Weights};
use super::decoder::{Decoder, DecoderInput, KvCache, LlamaLayer, Logits};
use super::local::{Architecture, ChatFormat, InputEmbeddings, ModelInfo, VisionLanguageModel};
use super::text::ChatTokenizer;
use super::vision::ClipImageProcessor;

/// A LLaVA model.
#[derive(Debug)]
pub(crate) struct Llava {
    core: LlavaCore,
    processor: ClipImageProcessor,
    info: ModelInfo,
}

/// What LLaVA and LLaVA-NeXT have in common: tower, projector, decoder.
#[derive(Debug)]
pub(crate) struct LlavaCore {
    /// The configuration.
    pub config: LlavaConfig,
    /// Vision tower and projector.
    pub encoder: ImageEncoder,
    /// The decoder.
    pub decoder: Decoder<LlamaLayer>,
}

impl LlavaCore {
    /// Takes the weights of a configuration.
    ///
    /// # Errors
    /// When a tensor is missing or misshapen.
    pub(crate) fn take(weights: &mut Weights, config: LlavaConfig) -> Result<Self, MllmError> {
        let encoder = ImageEncoder::take(weights, &config)?;
        let decoder = Decoder::take(weights, &config.text, "language_model.", config.tie_word_embeddings)?;
        Ok(Self { config, encoder, decoder })
    }

    /// An empty cache.
    pub(crate) fn new_cache(&self) -> KvCache {
        self.decoder.new_cache(self.config.text.context)
    }

    /// Runs rows through the decoder; every token has its own position.
    pub(crate) fn forward(
        &self,
        rows: &InputEmbeddings,
        cache: &mut KvCache,
        wanted: Logits,
    ) -> candle_core::Result<Option<Tensor>> {
        let end = rows.start + rows.rows.dim(0)?;
        if end > self.config.text.context {
            candle_core::bail!("{end} positions do not fit into a context of {}", self.config.text.context);
        }
        let positions = (rows.start as u32..end as u32).collect();
        self.decoder.forward(&DecoderInput { rows: rows.rows.clone(), positions, vision: 0..0 }, cache, wanted)
    }
}

impl Llava {
    /// Opens the configuration, the preprocessor and the weights of a checkpoint.
    ///
    /// # Errors
    /// When one of them is missing or broken.
    pub(crate) fn open(checkpoint: &mut Checkpoint) -> Result<Self, MllmError> {
        let files = &checkpoint.files;
        let config = LlavaConfig::open(files)?;
        let processor = ClipImageProcessor::open(files)?;
        processor.check_side(config.vision.image_size)?;
        Self::take(&mut checkpoint.weights, config, processor)
    }

    /// Takes the weights of a configuration.
    ///
    /// # Errors
    /// When a tensor is missing or misshapen.
    pub(crate) fn take(
        weights: &mut Weights,
        config: LlavaConfig,
        processor: ClipImageProcessor,
    ) -> Result<Self, MllmError> {
        let before = weights.elements();
        let core = LlavaCore::take(weights, config)?;
        let config = &core.config;
        let info = ModelInfo {
            architecture: Architecture::Llava.name(),
            image_token: config.image_token,
            image_size: config.vision.image_size,
            max_image_tokens: config.image_tokens(),
            vocabulary: config.text.vocabulary,
            positions: config.text.context,
            parameters: (before - weights.elements()) as u64,
            blake3: weights.blake3().to_string(),
        };
        Ok(Self { core, processor, info })
    }

    /// Encodes pixel values (3, side, side) to image features (image tokens, decoder width).
    fn encode_pixels(&self, pixels: &Tensor) -> Result<Tensor, MllmError> {
        Ok(self.core.encoder.encode(std::slice::from_ref(pixels))?)
    }
}

#[cfg(test)]
impl Llava {
    /// A model of this configuration with random weights.
    pub(crate) fn random(config: &serde_json::Value) -> Self {
        let config = LlavaConfig::from_json(std::path::Path::new("config.json"), config).unwrap();
        let processor = ClipImageProcessor::square(config.vision.image_size as u32);
        Self::take(&mut Weights::random(7), config, processor).unwrap()
    }
}

impl VisionLanguageModel for Llava {
    fn info(&self) -> &ModelInfo {
        &self.info
    }

    fn context(&self, _image_tokens: usize) -> usize {
        self.info.positions
    }

    fn image_tokens(&self, _width: u32, _height: u32) -> Result<usize, MllmError> {
        Ok(self.info.max_image_tokens)
    }

    fn encode_image(&self, image: &RgbImage) -> Result<Tensor, MllmError> {
        self.encode_pixels(&self.processor.process(image, self.info.image_size)?)
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
