//! `CogVLM`, first version (Wang et al., "CogVLM: Visual Expert for Pretrained Language Models", arXiv:2311.03079): an
//! EVA2-CLIP tower and a Llama decoder whose layers have matrices of their own for the image.

mod chat;
mod config;
mod connector;
mod language;
mod preprocess;
mod vision;

#[cfg(test)]
mod reference_tests;

use candle_core::Tensor;
use image::RgbImage;

use chat::QuestionFormat;
pub(crate) use config::CogVlmConfig;
use connector::GluAdapter;
use language::{ExpertLayer, IMAGE_POSITIONS, positions, vision_rows};
use vision::EvaVisionTower;

use super::MllmError;
use super::checkpoint::{Checkpoint, ModelFiles, Weights};
use super::decoder::{Decoder, DecoderInput, KvCache, Logits};
use super::local::{Architecture, ChatFormat, InputEmbeddings, ModelInfo, VisionLanguageModel};
use super::text::ChatTokenizer;

/// A `CogVLM` model. It takes one image, and nothing but the beginning-of-sequence token stands before it.
#[derive(Debug)]
pub(crate) struct CogVlm {
    config: CogVlmConfig,
    tower: EvaVisionTower,
    adapter: GluAdapter,
    decoder: Decoder<ExpertLayer>,
    info: ModelInfo,
}

impl CogVlm {
    /// Opens the configuration and the weights of a checkpoint.
    ///
    /// # Errors
    /// When one of them is missing or broken.
    pub(crate) fn open(checkpoint: &mut Checkpoint) -> Result<Self, MllmError> {
        let config = CogVlmConfig::open(&checkpoint.files)?;
        Self::take(&mut checkpoint.weights, config)
    }

    /// Takes the weights of a configuration.
    ///
    /// # Errors
    /// When a tensor is missing or misshapen.
    fn take(weights: &mut Weights, config: CogVlmConfig) -> Result<Self, MllmError> {
        let before = weights.elements();
        let tower = EvaVisionTower::take(weights, &config.vision)?;
        let adapter = GluAdapter::take(weights, &config)?;
        let decoder = Decoder::take(weights, &config.text, "", config.tie_word_embeddings)?;
        let info = ModelInfo {
            architecture: Architecture::CogVlm.name(),
            // No token of the vocabulary stands for an image, so the first number behind it does.
            image_token: config.text.vocabulary as u32,
            image_size: config.vision.image_size,
            max_image_tokens: config.image_tokens(),
            vocabulary: config.text.vocabulary,
            positions: config.text.context,
            parameters: (before - weights.elements()) as u64,
            blake3: weights.blake3().to_string(),
        };
        Ok(Self { config, tower, adapter, decoder, info })
    }

    /// Encodes pixel values (3, side, side) to (image tokens, decoder width).
    fn encode_pixels(&self, pixels: &Tensor) -> candle_core::Result<Tensor> {
        self.adapter.forward(&self.tower.forward(pixels)?)
    }
}

#[cfg(test)]
impl CogVlm {
    /// A model of this configuration with random weights.
    pub(crate) fn random(config: &serde_json::Value) -> Self {
        let config = CogVlmConfig::from_json(std::path::Path::new("config.json"), config).unwrap();
        Self::take(&mut Weights::random(7), config).unwrap()
    }
}

impl VisionLanguageModel for CogVlm {
    fn info(&self) -> &ModelInfo {
        &self.info
    }

    fn context(&self, image_tokens: usize) -> usize {
        self.info.positions + image_tokens.saturating_sub(IMAGE_POSITIONS)
    }

    fn image_tokens(&self, _width: u32, _height: u32) -> Result<usize, MllmError> {
        Ok(self.info.max_image_tokens)
    }

    fn encode_image(&self, image: &RgbImage) -> Result<Tensor, MllmError> {
        Ok(self.encode_pixels(&preprocess::pixel_values(image, self.info.image_size as u32)?)?)
    }

    fn embed(&self, ids: &[u32]) -> candle_core::Result<Tensor> {
        self.decoder.embed(ids)
    }

    fn new_cache(&self) -> KvCache {
        self.decoder.new_cache(self.context(self.info.max_image_tokens))
    }

    fn forward(
        &self,
        rows: &InputEmbeddings,
        cache: &mut KvCache,
        wanted: Logits,
    ) -> candle_core::Result<Option<Tensor>> {
        let tokens = rows.start..rows.start + rows.rows.dim(0)?;
        let positions = positions(tokens.clone(), &rows.image);
        if let Some(position) = positions.last().filter(|position| **position as usize >= self.info.positions) {
            candle_core::bail!("position {position} lies outside the context of {}", self.info.positions);
        }
        let vision = vision_rows(&tokens, &rows.image);
        self.decoder.forward(&DecoderInput { rows: rows.rows.clone(), positions, vision }, cache, wanted)
    }

    fn chat_format(&self, _files: &ModelFiles, _tokenizer: &ChatTokenizer) -> Result<Box<dyn ChatFormat>, MllmError> {
        let format =
            QuestionFormat { bos: self.config.bos, image_token: self.info.image_token, style: self.config.style };
        Ok(Box::new(format))
    }
}
